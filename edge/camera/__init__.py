"""Cameras: recorded feed, V4L2, OAK, or an installed plug-in (the simulator); all hand on a `Frame`.

`recorded` plays a feed. `v4l2` and `oak` are devices; `settings` lists what a device did not accept. `newest` is the
one thread, which keeps only the newest frame of any of them and opens a lost camera again; `frozen_picture` finds
pictures that show nothing. A further camera is a module with a class like `Camera`, and a line in `open_camera`; or,
outside this package, an entry point `lookback.cameras`.
"""

from __future__ import annotations

from importlib.metadata import entry_points

from edge.camera.frame import Camera, CameraHealth
from edge.config import CameraConfig
from edge.errors import ConfigError
from edge.feed import Frame

__all__ = ["Camera", "CameraHealth", "Frame", "open_camera"]


def open_camera(config: CameraConfig) -> Camera:
    """Open the camera that `config.kind` names; only its module is imported."""
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
            f"[camera] kind: unknown camera {config.kind!r}; use one of {', '.join(['v4l2', 'oak', 'feed', *plugins])}"
        )
    camera: Camera = next(iter(found)).load()(config)
    return camera
