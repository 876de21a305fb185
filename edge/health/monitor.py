"""Follows the state of the running daemon, and publishes it everywhere in the same words; and how long stages take.

What a state means is decided in `health`; here it goes to the journal and the log, to systemd as STATUS=, into the
heartbeat, and to the pilot as a line.
"""

from __future__ import annotations

import contextlib
import logging
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import common as mavlink

from edge.camera import CameraHealth
from edge.health.health import STARTING, Health, HealthInputs, HealthState, derive
from edge.health.service import notify
from edge.journal.journal import Journal, QueuedJournal
from edge.journal.records import JournalResumed, StateChanged

TEXT_NS = 5_000_000_000
"""At most one line about each state in this time: at the edge of a map it changes with every frame."""
JOURNAL_RETRY_NS = 5_000_000_000
SEVERITIES: dict[HealthState, int] = {"degraded": mavlink.MAV_SEVERITY_WARNING, "failed": mavlink.MAV_SEVERITY_CRITICAL}
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Links:
    """How the state goes out on the MAVLink links.

    set_system_status: MAV_STATE of the heartbeats. send_text: queue a line of a MAV_SEVERITY for the pilot.
    send_last_words: the same at once, before the program ends.
    """

    set_system_status: Callable[[int], object]
    send_text: Callable[[str, int], object]
    send_last_words: Callable[[str, int], object]


class HealthMonitor:
    """The newest health of the daemon."""

    def __init__(self, links: Links, journal: Journal | QueuedJournal | None, clock_ns: Callable[[], int]) -> None:
        self._links, self._journal, self._clock_ns = links, journal, clock_ns
        self._hang = ""
        self._frames_before_gap = 0
        self._was_blind = False
        self._reopened = 0
        self._link_up_ns = clock_ns()
        self._link_was_up = False
        self._published: Health | None = None
        self._published_text = ""
        self._text_due_ns: dict[HealthState, int] = {}
        self._journal_retry_ns = 0
        self.health = STARTING
        self._publish(STARTING)

    @property
    def hangs(self) -> bool:
        """Whether the camera's thread is stuck, so that only a restart of the process helps."""
        return bool(self._hang)

    def is_first_after_gap(self, camera: CameraHealth) -> bool:
        """Whether a camera came back since the last update: its first frame still meets what was seen before."""
        return camera.reopened != self._reopened

    def update(
        self,
        recognizer: str,
        frames_used: int,
        frame_s: float,
        camera: CameraHealth,
        link: tuple[str, str],
        picture_fault: str = "",
        hang: str = "",
        gps: str = "",
    ) -> bool:
        """Derive and publish the state; True when what was recognized so far must be dropped.

        That is so when the daemon goes blind and when it sees again: the vehicle has moved meanwhile. recognizer: its
        state. frames_used, frame_s: frames since the start, and what the last one took. link: state, and why it is
        closed. picture_fault: what is wrong with the newest picture, for long enough to say so. hang: what the camera's
        thread is stuck in. gps: what is wrong with it by the places.
        """
        if hang and not self._hang:
            log.error("the camera hangs (%s); WATCHDOG=1 is no longer sent", hang)
        self._hang = hang
        inputs = HealthInputs(
            recognizer=recognizer,
            frames_used=frames_used - self._frames_before_gap,
            camera="lost" if hang else camera.state,
            camera_why=f"it hangs ({hang})" if hang else camera.reason,
            picture=picture_fault,
            link=link[0],
            link_why=link[1],
            link_down_s=self._link_down_s(is_up=link[0] == "up"),
            journal=self._journal_fault(),
            frame_s=frame_s if frames_used > self._frames_before_gap else 0.0,
            gps=gps,
        )
        is_gap = bool(inputs.blind) != self._was_blind or self.is_first_after_gap(camera)
        self._was_blind, self._reopened = bool(inputs.blind), camera.reopened
        if is_gap:
            self._frames_before_gap = frames_used
            inputs = replace(inputs, frames_used=0, frame_s=0.0)
        self._publish(derive(inputs, self.health))
        return is_gap

    @contextlib.contextmanager
    def failures(self) -> Iterator[None]:
        """Publish the error that ends the program, before it does."""
        try:
            yield
        except Exception as error:
            words = str(error) or type(error).__name__
            self._publish(Health("failed", words.splitlines()[0]))
            self._links.send_last_words(f"Lookback {self.health}", SEVERITIES["failed"])
            raise

    def _link_down_s(self, *, is_up: bool) -> float:
        now_ns = self._clock_ns()
        if is_up and not self._link_was_up:
            self._published_text = ""  # whoever is there now has not received it
        self._link_was_up = is_up
        if is_up:
            self._link_up_ns = now_ns
        return (now_ns - self._link_up_ns) / 1e9

    def _journal_fault(self) -> str:
        """Why the journal cannot be written. Nothing may happen that is worth a line, so try one now and then."""
        journal = self._journal
        if journal is None or not journal.lost:
            return ""
        if self._clock_ns() >= self._journal_retry_ns:
            self._journal_retry_ns = self._clock_ns() + JOURNAL_RETRY_NS
            journal.write(JournalResumed(journal.lost))
        return journal.why_lost if journal.lost else ""

    def _publish(self, health: Health) -> None:
        self.health = health
        self._links.set_system_status(health.mav_state)
        now_ns = self._clock_ns()
        before = self._published
        if before is None or (health.state, health.why) != (before.state, before.why):
            self._published = health
            # Failing and starting have their lines in the log already.
            log.log(logging.DEBUG if health.state in ("failed", "starting") else logging.INFO, "%s", health)
            notify(f"STATUS={health}")
            if self._journal is not None:
                self._journal.write(StateChanged(health.state, health.why))
        if str(health) != self._published_text and now_ns >= self._text_due_ns.get(health.state, 0):
            self._published_text, self._text_due_ns[health.state] = str(health), now_ns + TEXT_NS
            severity = SEVERITIES.get(health.state, mavlink.MAV_SEVERITY_NOTICE)
            self._links.send_text(f"Lookback {health}", severity)


RECENT_FRAMES = 1000


class StageTimes:
    """A stopwatch with named laps."""

    def __init__(self, clock_ns: Callable[[], int] = time.perf_counter_ns) -> None:
        self._clock_ns = clock_ns
        self._last_ns = clock_ns()
        self._laps_ns: dict[str, deque[int]] = {}

    def start(self) -> None:
        """Start timing a frame."""
        self._last_ns = self._clock_ns()

    def lap(self, stage: str) -> None:
        """Record the time since the last lap as the duration of a stage."""
        now_ns = self._clock_ns()
        self._laps_ns.setdefault(stage, deque(maxlen=RECENT_FRAMES)).append(now_ns - self._last_ns)
        self._last_ns = now_ns

    def medians_ms(self) -> dict[str, float]:
        """Median milliseconds of each stage, in the order in which they run."""
        return {stage: round(statistics.median(laps) / 1e6, 3) for stage, laps in self._laps_ns.items()}
