"""What every camera hands on, and what every camera can do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


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
