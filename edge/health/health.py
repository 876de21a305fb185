"""The daemon's state, and why: decided by pure functions, followed and published in the same words; and stage times.

The journal, systemd's STATUS=, the heartbeat's system_status, the pilot's status text, the page and doctor show one
`Health`. Its reason says why no position comes, wherever none does:

    starting     no image has been used yet
    warming up   fewer frames than a sequence needs, or a large map is still being searched
    on the map   the newest match is accepted
    off the map  it is rejected
    degraded     something is missing that may come back
    failed       the program ends: an error that it cannot recover from

A vehicle that stands keeps the state in which it stopped.
"""

from __future__ import annotations

import contextlib
import logging
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, cast

from pymavlink.dialects.v20 import common as mavlink

from edge.camera import CameraHealth
from edge.health.service import notify
from edge.journal.journal import Journal, QueuedJournal
from edge.journal.records import JournalResumed, StateChanged

Able: TypeAlias = Literal["starting", "warming up", "on the map", "off the map"]
HealthState: TypeAlias = Literal["starting", "warming up", "on the map", "off the map", "degraded", "failed"]

MAV_STATES: dict[HealthState, int] = {
    "starting": mavlink.MAV_STATE_BOOT,
    "warming up": mavlink.MAV_STATE_CALIBRATING,
    "on the map": mavlink.MAV_STATE_ACTIVE,
    "off the map": mavlink.MAV_STATE_STANDBY,
    "degraded": mavlink.MAV_STATE_CRITICAL,
    "failed": mavlink.MAV_STATE_EMERGENCY,
}
LINK_GRACE_S = 5.0
"""Autopilots send every second; a link that has just been opened is not yet silent."""
SLOW_FRAME_S = 1.0
"""The result of a slower frame is about a place that the vehicle has left."""
OFF_STEPS_M = (20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)
"""Meters without a recognized place at which the reason changes: each change is a line for the pilot."""


@dataclass(frozen=True)
class Health:
    """The state, its reason ("" if there is none), and the state of recognition behind it."""

    state: HealthState
    why: str = ""
    able: Able = "starting"

    def __str__(self) -> str:
        return f"{self.state}: {self.why}" if self.why else self.state

    @property
    def mav_state(self) -> int:
        """MAV_STATE for the heartbeat."""
        return MAV_STATES[self.state]


@dataclass(frozen=True)
class HealthInputs:
    """States that the stages report.

    recognizer: its state, as in `edge.recognizer`. frames_used: since the start, or since the last blindness.
    camera: running | lost | ended, with the reason. picture: the image's fault, "" if none. link: closed | waiting |
    up, with the reason and for how long it has not been up. journal: why it cannot be written. frame_s: how long the
    last frame took. gps: what is wrong with it by the places, "" if nothing is. withheld: why no position is sent, ""
    while one is. driven_m: by the odometer, None if unknown. off_m: of that since a place was recognized.
    """

    recognizer: str = "warming up"
    frames_used: int = 0
    camera: str = "running"
    camera_why: str = ""
    picture: str = ""
    link: str = "up"
    link_why: str = ""
    link_down_s: float = 0.0
    journal: str = ""
    frame_s: float = 0.0
    gps: str = ""
    withheld: str = ""
    driven_m: float | None = None
    off_m: float | None = None

    @property
    def blind(self) -> str:
        """Why no place can be recognized now; "" if one can."""
        if self.camera == "lost":
            return f"camera: {self.camera_why}"
        return f"camera: {self.picture}" if self.picture else ""


NOT_YET = {
    "starting": "no picture has been used yet",
    "warming up": "more frames are needed",
    "searching": "the whole map is searched",
}
"""Why no place can be recognized yet."""
STARTING = Health("starting", NOT_YET["starting"])


def derive(signs: HealthInputs, before: Health = STARTING) -> Health:
    """The state now; `before` is the last one, which a standing vehicle keeps."""
    able = _able(signs, before)
    journal = f"journal: {signs.journal}" if signs.journal else ""
    slow = f"slow: a frame took over {SLOW_FRAME_S:g} s" if signs.frame_s > SLOW_FRAME_S else ""
    troubles = [one for one in (signs.gps, _link_trouble(signs), journal, slow) if one]
    if signs.blind:
        return Health("degraded", "; ".join([f"not recognized: {signs.blind}", *troubles]), "starting")
    why = _why_no_position(signs, able)
    if troubles:
        return Health("degraded", "; ".join([*troubles, str(Health(able, why))]), able)
    return Health(able, why, able)


def _why_no_position(signs: HealthInputs, able: Able) -> str:
    """In a sentence for people; "" while positions are sent."""
    if able == "on the map":
        return f"no position: {signs.withheld}" if signs.withheld else ""
    if able != "off the map":
        return NOT_YET["searching" if signs.recognizer == "searching" else able]
    passed = [step_m for step_m in OFF_STEPS_M if signs.off_m is not None and signs.off_m >= step_m]
    return f"not recognized for {passed[-1]} m" if passed else "not recognized"


def _able(signs: HealthInputs, before: Health) -> Able:
    if signs.frames_used == 0:
        return "starting"
    if signs.recognizer == "standing":
        return before.able if before.able != "starting" else "warming up"
    return "warming up" if signs.recognizer == "searching" else cast("Able", signs.recognizer)


def _link_trouble(signs: HealthInputs) -> str:
    if signs.link == "up":
        return ""
    if signs.link == "closed":
        return f"link: {signs.link_why}" if signs.link_why else ""
    return "link: no autopilot heard" if signs.link_down_s > LINK_GRACE_S else ""


TEXT_NS = 5_000_000_000
"""At most one line about each state in this time: at the edge of a map it changes with every frame. As long on the map,
a vehicle has had time for its first position."""
JOURNAL_RETRY_NS = 5_000_000_000
FED_EACH_NS = 100_000_000  # a turn without a frame takes 20 ms; systemd waits for 10 s (WatchdogSec=)
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
        self.hangs = False
        """Whether the camera's thread is stuck, so that only a restart of the process helps."""
        self._frames_before_gap = 0
        self._was_blind = False
        self._reopened = 0
        self._link_down_ns: int | None = clock_ns()  # since when; None: it is up
        self._off_map_ns = clock_ns()  # when the vehicle was last
        self._recognized_m: float | None = None  # driven then
        self._published_text = ""
        self._text_due_ns: dict[HealthState, int] = {}
        self._journal_retry_ns = 0
        self._fed_ns: int | None = None
        self.health = Health("starting")
        self._publish(STARTING)

    def is_first_after_gap(self, camera: CameraHealth) -> bool:
        """Whether a camera came back since the last update: its first frame still meets what was seen before."""
        return camera.reopened != self._reopened

    def update(self, inputs: HealthInputs, camera: CameraHealth, hang: str = "") -> bool:
        """Derive and publish the state; True when what was recognized so far must be dropped.

        That is so when the daemon goes blind and when it sees again: the vehicle has moved meanwhile. inputs: without
        what is known here, of camera, journal and silence. hang: what the camera's thread is stuck in.
        """
        if hang and not self.hangs:
            log.error("the camera hangs (%s); WATCHDOG=1 is no longer sent", hang)
        self.hangs, frames_used = bool(hang), inputs.frames_used
        inputs = replace(
            inputs,
            frames_used=frames_used - self._frames_before_gap,
            camera="lost" if hang else camera.state,
            camera_why=f"it hangs ({hang})" if hang else camera.reason,
            link_down_s=self._link_down_s(is_up=inputs.link == "up"),
            journal=self._journal_fault(),
            frame_s=inputs.frame_s if frames_used > self._frames_before_gap else 0.0,
            withheld=inputs.withheld if self._clock_ns() - self._off_map_ns >= TEXT_NS else "",
            off_m=self._off_m(inputs.driven_m),
        )
        is_gap = bool(inputs.blind) != self._was_blind or self.is_first_after_gap(camera)
        self._was_blind, self._reopened = bool(inputs.blind), camera.reopened
        if is_gap:
            self._frames_before_gap = frames_used
            inputs = replace(inputs, frames_used=0, frame_s=0.0)
        self._publish(derive(inputs, self.health))
        if self.health.able != "on the map":
            self._off_map_ns = self._clock_ns()
        return is_gap

    def feed_watchdog(self) -> None:
        """Send systemd READY=1 in the first turn of the loop, and WATCHDOG=1 unless a part of the daemon hangs.

        It is ready without its port or its camera too: it opens them when they appear, which may be never, and the
        computer must finish booting. The loop's thread moves all but the camera: had it hung, it would not come here.
        """
        now_ns = self._clock_ns()
        if self._fed_ns is None:
            notify("READY=1")
        elif self.hangs or now_ns - self._fed_ns < FED_EACH_NS:
            return
        self._fed_ns = now_ns
        if not self.hangs:
            notify("WATCHDOG=1", wait_s=0.0)

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

    def _off_m(self, driven_m: float | None) -> float | None:
        """Meters driven since a place was recognized, or since the odometer began; None where it is not known."""
        if driven_m is None:
            return None
        # An odometer that restarts begins at 0.
        if self._recognized_m is None or self.health.able == "on the map" or driven_m < self._recognized_m:
            self._recognized_m = driven_m
        return driven_m - self._recognized_m

    def _link_down_s(self, *, is_up: bool) -> float:
        now_ns = self._clock_ns()
        if is_up and self._link_down_ns is not None:
            self._published_text = ""  # whoever is there now has not received it
        if is_up or self._link_down_ns is None:
            self._link_down_ns = None if is_up else now_ns
            return 0.0
        return (now_ns - self._link_down_ns) / 1e9

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
        before, self.health = self.health, health
        self._links.set_system_status(health.mav_state)
        now_ns = self._clock_ns()
        if (health.state, health.why) != (before.state, before.why):
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

    def __init__(self) -> None:
        self._last_ns = time.perf_counter_ns()
        self._laps_ns: dict[str, deque[int]] = {}

    def start(self) -> None:
        """Start timing a frame."""
        self._last_ns = time.perf_counter_ns()

    def lap(self, stage: str) -> None:
        """Record the time since the last lap as the duration of a stage."""
        now_ns = time.perf_counter_ns()
        self._laps_ns.setdefault(stage, deque(maxlen=RECENT_FRAMES)).append(now_ns - self._last_ns)
        self._last_ns = now_ns

    def medians_ms(self) -> dict[str, float]:
        """Median milliseconds of each stage, in the order in which they run."""
        return {stage: round(statistics.median(laps) / 1e6, 3) for stage, laps in self._laps_ns.items()}
