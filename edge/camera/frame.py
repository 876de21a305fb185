"""What every camera can do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from edge.feed import Frame


@dataclass(frozen=True)
class CameraHealth:
    """State of the camera and counts since the start.

    reason: why it is lost, or the last bad frame while running; "" when there is nothing to say.
    since_ns: CLOCK_MONOTONIC of the last change of `state`.
    delivered: frames read; overwritten: of these, how many were replaced by a newer one before anybody took them.
    bad: frames that could not be read, of another size than the first, or whose stamp was not after the last one's or
    lay in the future (drivers' clocks do that).
    reopened: how often the camera came back, with a frame: one that opens and gives nothing is still lost.
    """

    state: Literal["running", "lost", "ended"]
    reason: str
    since_ns: int
    delivered: int = 0
    overwritten: int = 0
    bad: int = 0
    reopened: int = 0
    differences: tuple[str, ...] = ()


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
