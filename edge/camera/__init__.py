"""Cameras: recorded feed, V4L2, OAK, or an installed plug-in (the simulator); all hand on a `Frame`.

`feed` is the file format (`feed_header` and `feed_rows` its two files; other recordings come in by the entry point
`lookback.feeds`), and `recorded` plays it. `v4l2` and `oak` are devices, which say in `settings` what they did not
accept. `newest` is the one thread, which keeps only the newest frame of any of them and opens a lost camera again;
`picture` finds pictures that show nothing. A further camera is a module with a class like `Camera`, and a line in
`open_camera`; or, outside this package, an entry point `lookback.cameras`.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edge.config import CameraConfig
from edge.errors import ConfigError


@dataclass(frozen=True)
class Frame:
    """One picture.

    image: (H, W, 3) uint8, BGR as OpenCV has it; the camera's own buffer, not to be written to.
    stamp_ns: exposure on CLOCK_MONOTONIC for live cameras, the feed's own time for feeds read as files.
    index: the camera's frame counter, or the row of the feed; gaps are frames that were never seen.
    """

    image: NDArray[np.uint8]
    stamp_ns: int
    index: int


class Camera(Protocol):
    """What every camera can do; used by one thread, the one that opens it.

    Opening takes effect in the constructor, which raises SetupError or CameraLost. The stamps and indices of its frames
    strictly increase.
    """

    differences: tuple[str, ...]
    """What the device did not accept, read back after opening: "fps: asked for 30, device gives 25"."""
    read_timeout_s: float
    """read() comes back within this time, with a frame or an error, unless the driver hangs."""

    def read(self) -> Frame | None:
        """Block until the next frame, at most `stall_timeout_s` for a device; None at the end of a feed.

        Raises FrameError for one unreadable frame (call again) and CameraLost when the camera is gone.
        """

    def close(self) -> None:
        """Release the device; more than once is harmless."""


def open_camera(config: CameraConfig) -> Camera:
    """Open the camera that `config.kind` names; modules are imported only when they are asked for."""
    # Imported here, so that a vehicle without an OAK never loads DepthAI.
    if config.kind == "v4l2":
        from edge.camera.v4l2 import V4l2Camera

        return V4l2Camera(config)
    if config.kind == "oak":
        from edge.camera.oak import OakCamera

        return OakCamera(config)
    if config.kind == "feed":
        from edge.camera.recorded import RecordedCamera

        return RecordedCamera.in_real_time(config)
    found = entry_points(group="lookback.cameras", name=config.kind)
    if not found:
        plugins = sorted(point.name for point in entry_points(group="lookback.cameras"))
        raise ConfigError(
            f"[camera] kind: no camera is called {config.kind!r}; "
            f"use one of {', '.join(['v4l2', 'oak', 'feed', *plugins])}"
        )
    camera: Camera = next(iter(found)).load()(config)
    return camera
