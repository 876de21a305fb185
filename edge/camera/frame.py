"""What every camera can do."""

from __future__ import annotations

from typing import Protocol

from edge.feed import Frame


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
