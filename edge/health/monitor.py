"""Watches the parts of the running daemon, and tells of its health everywhere in the same words.

What a state means is decided in `health`; here it is asked for, and told: to the journal and the log, to systemd as
STATUS=, in the heartbeat, and to the pilot as a line.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
from collections.abc import Callable, Iterator

import msgspec
from pymavlink.dialects.v20 import common as mavlink

from edge.camera import Frame
from edge.camera.frozen_picture import FrozenPictureDetector
from edge.camera.newest import CameraHealth, NewestFrame
from edge.health.health import STARTING, Health, HealthInputs, HealthState, derive
from edge.health.service import notify
from edge.journal.journal import Journal
from edge.telemetry.autopilot import AutopilotConnection

TEXT_NS = 5_000_000_000
"""At most one line about each state in this time: at the edge of a map it changes with every frame."""
JOURNAL_RETRY_NS = 5_000_000_000
SEVERITIES: dict[HealthState, int] = {"degraded": mavlink.MAV_SEVERITY_WARNING, "failed": mavlink.MAV_SEVERITY_CRITICAL}
log = logging.getLogger(__name__)


class StateChanged(msgspec.Struct, frozen=True, tag_field="event", tag="state"):
    """The daemon's state, or the reason for it, changed; see `edge.health`."""

    state: str
    why: str = ""


class JournalResumed(msgspec.Struct, frozen=True, tag_field="event", tag="journal"):
    """The journal can be written again; so many lines before this one are missing."""

    lost: int


class HealthMonitor:
    """The health of the daemon, as told last."""

    def __init__(
        self,
        autopilot: AutopilotConnection,
        journal: Journal | None,
        clock_ns: Callable[[], int],
        min_speed_mps: float,
    ) -> None:
        """min_speed_mps: above it the vehicle counts as driving."""
        self._autopilot, self._journal, self._clock_ns = autopilot, journal, clock_ns
        self._min_speed_mps = min_speed_mps
        self._picture = FrozenPictureDetector()
        self._picture_fault = ""
        self.sees = True
        """Whether the newest picture was one to go by."""
        self._reopened = 0
        self._hang = ""
        self._frame_s = 0.0
        self._frames_used = 0
        self._was_blind = False
        self._link_up_ns = clock_ns()
        self._link_was_up = False
        self._text_told = ""
        self._text_due_ns: dict[HealthState, int] = {}
        self._journal_retry_ns = 0
        self._told: Health | None = None
        self.health = STARTING
        self._tell(STARTING)

    @property
    def hangs(self) -> bool:
        """Whether the camera's thread is stuck, so that only a restart of the process helps."""
        return bool(self._hang)

    def see(self, frame: Frame, camera: NewestFrame | None) -> bool:
        """Look at a frame; False when it must not be used. `camera` is opened again where that may help."""
        speed_mps = self._autopilot.vehicle.speed_mps(self._clock_ns())
        moves = None if speed_mps is None else speed_mps >= self._min_speed_mps
        fault = self._picture.see(frame.image, frame.stamp_ns, moves)
        self._picture_fault = fault.what if fault and fault.sure else ""
        if fault and fault.reopen and camera is not None:
            camera.reopen(fault.what)
        self.sees = fault is None
        # The first frame of a camera that came back finds what was seen before, which is forgotten after this turn.
        returned = camera is not None and camera.health.reopened != self._reopened
        return self.sees and not returned

    def used(self, frame_s: float) -> None:
        """A frame has been used, and took so long."""
        self._frames_used += 1
        self._frame_s = frame_s

    def update(self, recognizer_state: str, camera: CameraHealth, hang: str = "") -> bool:
        """Find out how things are, and tell; True when what was seen so far must be forgotten.

        That is so when the daemon goes blind and when it sees again: the vehicle has moved meanwhile.
        """
        if hang and not self._hang:
            log.error("the camera hangs (%s); the watchdog is not fed any more", hang)
        self._hang = hang
        lost = camera.state == "lost" or bool(hang)
        signs = HealthInputs(
            recognizer=recognizer_state,
            frames_used=self._frames_used,
            camera="lost" if lost else camera.state,
            camera_why=f"it hangs ({hang})" if hang else camera.reason,
            picture=self._picture_fault,
            link=self._autopilot.state,
            link_why=self._autopilot.why_closed,
            link_down_s=self._link_down_s(),
            journal=self._journal_trouble(),
            frame_s=self._frame_s,
        )
        gap = bool(signs.blind) != self._was_blind or camera.reopened != self._reopened
        self._was_blind, self._reopened = bool(signs.blind), camera.reopened
        if gap:
            self._frames_used, self._frame_s = 0, 0.0
            signs = dataclasses.replace(signs, frames_used=0, frame_s=0.0)
        self._tell(derive(signs, self.health))
        return gap

    @contextlib.contextmanager
    def failures(self) -> Iterator[None]:
        """Tells of what ends the program, before it does."""
        try:
            yield
        except Exception as error:
            words = str(error) or type(error).__name__
            self._tell(Health("failed", words.splitlines()[0]))
            self._autopilot.say_now(f"Lookback {self.health}", SEVERITIES["failed"])
            raise

    def _link_down_s(self) -> float:
        now_ns, is_up = self._clock_ns(), self._autopilot.state == "up"
        if is_up and not self._link_was_up:
            self._text_told = ""  # who is there now has not heard it
        self._link_was_up = is_up
        if is_up:
            self._link_up_ns = now_ns
        return (now_ns - self._link_up_ns) / 1e9

    def _journal_trouble(self) -> str:
        """Why the journal cannot be written. Nothing may happen that is worth a line, so try one now and then."""
        journal = self._journal
        if journal is None or not journal.lost:
            return ""
        if self._clock_ns() >= self._journal_retry_ns:
            self._journal_retry_ns = self._clock_ns() + JOURNAL_RETRY_NS
            journal.write(JournalResumed(journal.lost))
        return journal.why_lost if journal.lost else ""

    def _tell(self, health: Health) -> None:
        self.health = health
        self._autopilot.system_status = health.mav_state
        now_ns = self._clock_ns()
        if self._told is None or (health.state, health.why) != (self._told.state, self._told.why):
            self._told = health
            # Failing and starting have their lines in the log already.
            log.log(logging.DEBUG if health.state in ("failed", "starting") else logging.INFO, "%s", health)
            notify(f"STATUS={health}")
            if self._journal is not None:
                self._journal.write(StateChanged(health.state, health.why))
        if str(health) != self._text_told and now_ns >= self._text_due_ns.get(health.state, 0):
            self._text_told, self._text_due_ns[health.state] = str(health), now_ns + TEXT_NS
            self._autopilot.status_text(f"Lookback {health}", SEVERITIES.get(health.state, mavlink.MAV_SEVERITY_NOTICE))
