"""What every camera can do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from edge.feed import Frame


@dataclass(frozen=True)
class CameraHealth:
    """State of the camera and counts since the start.

    reason: why it is lost, or the last bad frame while running; "" if neither.
    since_ns: CLOCK_MONOTONIC of the last change of `state`.
    delivered: frames read; overwritten: of these, how many a newer one replaced before `take` returned them.
    bad: frames that could not be read, that differ in size from the first, or whose timestamp was not after the last
    one's or was in the future (drivers' clocks do that).
    reopened: how often the camera came back and gave a frame.
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
    """Methods of every camera; used by one thread, the one that opens it.

    The constructor opens the camera, and raises SetupError or CameraLost. The timestamps and indices of the frames
    strictly increase.
    """

    differences: tuple[str, ...]
    """Settings that the device did not accept, read back after opening: "fps: asked for 30, device gives 25"."""
    read_timeout_s: float
    """read() returns or raises within this time, unless the driver hangs."""

    def read(self) -> Frame | None:
        """Block until the next frame, at most `stall_timeout_s` for a device; None at the end of a feed.

        Raises FrameError for one unreadable frame (call again) and CameraLost if the camera is gone.
        """

    def close(self) -> None:
        """Release the device; more than once is harmless."""


class Frames(Protocol):
    """Where the frames come from: `NewestFrame`, or the trial's, whose time is simulated."""

    @property
    def health(self) -> CameraHealth:
        """State and counts."""

    @property
    def ended(self) -> bool:
        """Whether there is no frame any more."""

    def take(self, timeout_s: float) -> Frame | None:
        """The newest frame that was not taken yet; waits for one up to `timeout_s`."""

    def close(self) -> None:
        """Release the camera."""
