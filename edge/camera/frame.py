"""What every camera can do, and which of the requested settings its device did not accept."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from edge.feed import Frame


@dataclass(frozen=True)
class CameraHealth:
    """State of the camera and counts since the start.

    state: "opening" until it was opened once, or could not be. reason: why it is lost, or the last bad frame while
    running; "" if neither.
    since_ns: CLOCK_MONOTONIC of the last change of `state`.
    delivered: frames read; overwritten: of these, how many a newer one replaced before `take` returned them.
    bad: frames that could not be read, that differ in size from the first, or whose timestamp was not after the last
    one's or was in the future (drivers' clocks do that).
    reopened: how often the camera came back and gave a frame.
    """

    state: Literal["opening", "running", "lost", "ended"]
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


Setting: TypeAlias = str | int | float
FPS_TOLERANCE = 0.01  # 29.97 is what many drivers call 30


def differences(asked: Mapping[str, Setting], given: Mapping[str, Setting]) -> tuple[str, ...]:
    """One line for each setting in `given` that differs from the request: "fps: asked for 30, device gives 25"."""
    return tuple(
        f"{key}: asked for {_text(asked[key])}, device gives {_text(value)}"
        for key, value in given.items()
        if not _same(asked[key], value)
    )


def _same(asked: Setting, given: Setting) -> bool:
    if isinstance(asked, float) and isinstance(given, float):
        return math.isclose(asked, given, rel_tol=FPS_TOLERANCE)
    return asked == given


def _text(value: Setting) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
