"""The camera's thread: reads a camera as fast as it delivers, and keeps only the newest frame.

A recognizer that is slower than the camera must process the current frame, not a growing queue of old ones, and a
camera that was unplugged must come back without a restart.
"""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from edge.backoff import BackOff
from edge.camera import open_camera, process_groups
from edge.camera.frame import Camera, CameraHealth
from edge.config import CameraConfig
from edge.errors import FrameError, LookbackError, LostError, SetupError
from edge.feed import Frame

FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S = 0.5, 5.0
BAD_FRAMES_S = 2.0
"""A camera that gives only bad frames for this long is opened again."""
OPENING_S = 30.0
"""Opening an OAK includes its boot."""
START_S = 2.0  # the start goes on without a camera that takes longer to open: a signal must be able to end the program
CLOSING_S = 10.0
CLOSE_S = 1.5  # a camera that cannot be closed must not keep the program from ending: systemd kills after 5 s
GRACE_S = 1.0
FUTURE_NS = 100_000_000
"""Tolerance: cameras estimate the offset of their clocks to ours."""
AGREEING = 5
"""So many timestamps in a row that are equally far in the future mean that the camera's clock is ahead of ours."""
log = logging.getLogger(__name__)


class NewestFrame:
    """Owns a camera and its thread: the camera is opened, read and closed in that thread and in no other."""

    def __init__(
        self,
        open: Callable[[], Camera],
        *,
        first_back_off_s: float = FIRST_BACK_OFF_S,
        longest_back_off_s: float = LONGEST_BACK_OFF_S,
        start_s: float = START_S,
        reopens: bool = True,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Start the thread and wait up to `start_s` for the first opening.

        SetupError of the first opening is raised here, or by `take` if the opening takes longer.
        A missing camera (CameraLost) is reported by `health` and opened again with back-off.
        reopens: whether a camera that gives only bad or frozen images is opened again; a recording would start over.
        """
        self._open = open
        self._reopens = reopens
        self._clock_ns = clock_ns
        self._back_off = BackOff(round(first_back_off_s * 1e9), round(longest_back_off_s * 1e9))
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._opened = threading.Event()
        self._failure: Exception | None = None
        self._newest: Frame | None = None
        self._health = CameraHealth("opening", "", clock_ns())
        self._last_stamp_ns = -1
        self._ahead_ns = 0  # of the camera's clock, as far as it is known
        self._early_ns: deque[int] = deque(maxlen=AGREEING)  # how far the last timestamps were in the future
        self._shape: tuple[int, ...] | None = None  # of the first image: a map fits one shape
        self._good_ns = 0
        self._bad_why = ""
        self._reopen_why = ""
        self._expected: tuple[str, int] = ("", 0)
        self._expect("opening", OPENING_S)
        self._next_index = 0  # of the first frame after the next opening, so that indices never go back
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        try:
            self._opened.wait(start_s)
        except BaseException:  # the program is to end, and does not wait for a camera that is still being opened
            self._stop.set()
            process_groups.send(signal.SIGKILL, self._thread.ident)
            raise
        if isinstance(self._failure, SetupError):
            raise self._failure

    @classmethod
    def configured(cls, config: CameraConfig, clock_ns: Callable[[], int] = time.monotonic_ns) -> NewestFrame:
        """The camera that [camera] names. A feed is never opened again, since it would start over."""
        return cls(lambda: open_camera(config), reopens=config.kind != "feed", clock_ns=clock_ns)

    @property
    def health(self) -> CameraHealth:
        """State and counts as of now."""
        with self._changed:
            return self._health

    @property
    def ended(self) -> bool:
        """True once the feed has ended and `take` has returned its last frame; `take` then returns None at once."""
        with self._changed:
            return self._health.state == "ended" and self._newest is None

    def take(self, timeout_s: float) -> Frame | None:
        """Return the newest frame, once; wait for one up to `timeout_s`.

        None if there is none in that time (see `health`) or the feed has ended. Raises SetupError of a first opening
        that took long, and an unexpected exception of the camera's thread (a defect).
        """
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._finished(), timeout_s)
            if self._newest is None and self._failure is not None:
                raise self._failure
            frame, self._newest = self._newest, None
            return frame

    def _finished(self) -> bool:
        return self._failure is not None or self._health.state == "ended" or self._stop.is_set()

    def reopen(self, why: str) -> None:
        """Close and open the camera again, in its thread, because its images are unusable."""
        with self._changed:
            self._reopen_why = why if self._reopens else ""

    def hang(self, now_ns: int) -> str:
        """What the thread has been doing for longer than allowed; "" if it is not overdue.

        Retrying a lost camera with back-off is not a hang. A call that hangs in a driver can only be ended by
        a watchdog outside the process.
        """
        with self._changed:
            doing, due_ns = self._expected
            over = now_ns > due_ns and self._health.state != "ended" and not self._stop.is_set()
            return doing if over else ""

    def _expect(self, doing: str, within_s: float) -> None:
        with self._changed:
            self._expected = doing, self._clock_ns() + round((within_s + GRACE_S) * 1e9)

    def close(self) -> None:
        """Stop the thread, which closes the camera; more than once is harmless.

        Waits at most CLOSE_S for a read that hangs in a driver; the thread ends with the process. A command that the
        thread reads is ended from here, for the thread may not come to it.
        """
        with self._changed:
            self._stop.set()
            self._changed.notify_all()
        process_groups.send(signal.SIGTERM, self._thread.ident)
        self._thread.join(CLOSE_S)
        process_groups.send(signal.SIGKILL, self._thread.ident)

    def _run(self) -> None:
        # A signal in this thread would interrupt a wait for a frame, which OpenCV reports as a lost camera.
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            while not self._stop.is_set():
                delivered = self.health.delivered
                if self._open_and_read():
                    return
                if self.health.delivered > delivered:  # it worked for a while: start over
                    self._back_off.reset()
                pause_s = self._back_off.failed(self._clock_ns()) / 1e9
                self._expect("waiting", pause_s)
                self._stop.wait(pause_s)
        except Exception as error:
            with self._changed:
                self._failure = error
                self._changed.notify_all()
        finally:
            self._opened.set()

    def _open_and_read(self) -> bool:
        """Open the camera and read it until it is lost; True if no more frames will come (feed ended, or close())."""
        first = not self._opened.is_set()
        self._expect("opening", OPENING_S)
        try:
            camera = self._open()
        except LookbackError as error:
            # After the start, a device that is just coming back can look like an invalid one for a moment.
            if first and isinstance(error, SetupError):
                raise
            self._set_state("lost", str(error))
            self._opened.set()
            return False
        with self._changed:
            self._health = replace(self._health, differences=camera.differences)
        if first:
            self._set_state("running", "")
        self._opened.set()
        try:
            return self._read_until_lost(camera)
        finally:
            self._expect("closing", CLOSING_S)
            camera.close()

    def _read_until_lost(self, camera: Camera) -> bool:
        first_index = self._next_index
        self._good_ns = self._clock_ns()
        self._ahead_ns = 0
        while not self._stop.is_set():
            self._expect("reading", camera.read_timeout_s)
            try:
                frame = camera.read()
                if frame is None:
                    self._set_state("ended", "")
                    return True
                self._next_index = first_index + frame.index + 1
                self._take_in(replace(frame, index=first_index + frame.index) if first_index else frame)
            except FrameError as error:
                self._count_bad(str(error))
            except LostError as error:
                self._set_state("lost", str(error))
                return False
            if why := self._reopen_why or self._nothing_good():
                self._reopen_why, self._last_stamp_ns = "", -1  # its clock may start over
                self._set_state("lost", f"{why}; opened again")
                return False
        return True

    def _take_in(self, frame: Frame) -> None:
        """Check a frame and keep it as the newest; FrameError if it is invalid."""
        now_ns = self._clock_ns()
        frame = replace(frame, stamp_ns=self._on_our_clock(frame.stamp_ns, now_ns))
        if frame.stamp_ns <= self._last_stamp_ns:
            raise FrameError("timestamp not after the last frame's")
        shape, self._shape = frame.image.shape, self._shape or frame.image.shape
        if shape != self._shape:
            raise FrameError(f"an image {_size(shape)}, but the first was {_size(self._shape)}")
        self._last_stamp_ns, self._good_ns = frame.stamp_ns, now_ns
        self._put(frame)

    def _on_our_clock(self, stamp_ns: int, now_ns: int) -> int:
        """The timestamp, corrected by how far the camera's clock is known to be ahead; FrameError if it is not known.

        No image is exposed after it was read. One timestamp in the future is damage; several that agree are a clock.
        """
        if stamp_ns - self._ahead_ns <= now_ns + FUTURE_NS:
            self._early_ns.clear()
            return stamp_ns - self._ahead_ns
        self._early_ns.append(stamp_ns - now_ns)
        early_ns = self._early_ns
        if len(early_ns) < AGREEING or max(early_ns) - min(early_ns) > FUTURE_NS:
            raise FrameError(f"timestamp {(stamp_ns - now_ns) / 1e9:.1f} s in the future")
        self._ahead_ns = max(early_ns)
        words = f"timestamps: {self._ahead_ns / 1e6:.0f} ms ahead of this computer's clock, corrected"
        log.warning("camera: %s", words)
        with self._changed:
            self._health = replace(self._health, differences=(*self._health.differences, words))
        return stamp_ns - self._ahead_ns

    def _nothing_good(self) -> str:
        """Why the camera must be opened again: only bad frames for too long; "" otherwise."""
        if not self._reopens or self._clock_ns() - self._good_ns <= BAD_FRAMES_S * 1e9:
            return ""
        return f"nothing but bad frames for {BAD_FRAMES_S:g} s ({self._bad_why})"

    def _put(self, frame: Frame) -> None:
        with self._changed:
            health = self._health
            if health.state == "lost":
                now_ns, reopened = self._clock_ns(), health.reopened + 1
                health = replace(health, state="running", reason="", since_ns=now_ns, reopened=reopened)
            overwritten = health.overwritten + (self._newest is not None)
            self._health = replace(health, delivered=health.delivered + 1, overwritten=overwritten)
            self._newest = frame
            self._changed.notify_all()

    def _count_bad(self, reason: str) -> None:
        with self._changed:
            health, self._bad_why = self._health, reason
            why = health.reason if health.state == "lost" else reason  # the bad frame is a symptom of it
            self._health = replace(health, bad=health.bad + 1, reason=why)

    def _set_state(self, state: Literal["running", "lost", "ended"], reason: str) -> None:
        with self._changed:
            since_ns = self._health.since_ns if state == self._health.state else self._clock_ns()
            self._health = replace(self._health, state=state, reason=reason, since_ns=since_ns)
            self._changed.notify_all()


def _size(shape: tuple[int, ...]) -> str:
    return f"of {shape[1]} x {shape[0]} pixels" if len(shape) == 3 and shape[2] == 3 else f"of shape {shape}"
