"""The daemon's health, followed and published in the same words everywhere; and how long the stages of a frame took."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.camera import CameraHealth
from edge.health.health import STARTING, Health, HealthInputs, HealthState, derive
from edge.journal.journal import Journal, QueuedJournal
from edge.journal.records import JournalResumed, StateChanged

MANAGER_S = 1.0
"""A service manager that does not read fills its socket: do not wait for it any longer."""
STATE_TEXT_NS = 5_000_000_000
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


class _Publisher:
    """The newest health, in the journal, to systemd and to the pilot."""

    def __init__(self, links: Links, journal: Journal | QueuedJournal | None, clock_ns: Callable[[], int]) -> None:
        self._links, self._journal, self._clock_ns = links, journal, clock_ns
        self._published_text = ""
        self._text_due_ns: dict[HealthState, int] = {}
        self._journal_retry_ns = 0
        self.health = Health("starting")
        self.publish(STARTING)

    def repeat(self) -> None:
        """Whoever is on the link now has not received the last text."""
        self._published_text = ""

    def publish_last(self, health: Health) -> None:
        """The program ends."""
        self.publish(health)
        self._links.send_last_words(f"Lookback {health}", SEVERITIES["failed"])

    def journal_fault(self) -> str:
        """Why the journal cannot be written. Nothing may happen that is worth a line, so try one now and then."""
        journal = self._journal
        if journal is None or not journal.lost:
            return ""
        if self._clock_ns() >= self._journal_retry_ns:
            self._journal_retry_ns = self._clock_ns() + JOURNAL_RETRY_NS
            journal.write(JournalResumed(journal.lost))
        return journal.why_lost if journal.lost else ""

    def publish(self, health: Health) -> None:
        """Wherever it differs from the last one; to the pilot at most once in STATE_TEXT_NS for each state."""
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
            self._published_text, self._text_due_ns[health.state] = str(health), now_ns + STATE_TEXT_NS
            severity = SEVERITIES.get(health.state, mavlink.MAV_SEVERITY_NOTICE)
            self._links.send_text(f"Lookback {health}", severity)


class HealthMonitor:
    """The newest health of the daemon."""

    def __init__(self, links: Links, journal: Journal | QueuedJournal | None, clock_ns: Callable[[], int]) -> None:
        self._clock_ns = clock_ns
        self._publisher = _Publisher(links, journal, clock_ns)
        self.hangs = False
        """Whether the camera's thread is stuck, so that only a restart of the process helps."""
        self._frames_before_gap = 0
        self._was_blind = False
        self._reopened = 0
        self._link_down_ns: int | None = clock_ns()  # since when; None: it is up
        self._off_map_ns = clock_ns()  # when the vehicle was last
        self._recognized_m: float | None = None  # driven then
        self._fed_ns: int | None = None

    @property
    def health(self) -> Health:
        """As it was published last."""
        return self._publisher.health

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
            journal=self._publisher.journal_fault(),
            frame_s=inputs.frame_s if frames_used > self._frames_before_gap else 0.0,
            withheld=inputs.withheld if self._clock_ns() - self._off_map_ns >= STATE_TEXT_NS else "",
            off_m=self._off_m(inputs.driven_m),
        )
        is_gap = bool(inputs.blind) != self._was_blind or self.is_first_after_gap(camera)
        self._was_blind, self._reopened = bool(inputs.blind), camera.reopened
        if is_gap:
            self._frames_before_gap = frames_used
            inputs = replace(inputs, frames_used=0, frame_s=0.0)
        self._publisher.publish(replace(derive(inputs, self.health), no_pose_m=inputs.no_pose_m))
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
            self._publisher.publish_last(Health("failed", words.splitlines()[0]))
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
            self._publisher.repeat()
        if is_up or self._link_down_ns is None:
            self._link_down_ns = None if is_up else now_ns
            return 0.0
        return (now_ns - self._link_down_ns) / 1e9


def notify(state: str, *, wait_s: float = MANAGER_S) -> None:
    """Send systemd one message, such as "READY=1", on the socket that it named (sd_notify); silent where there is none.

    A message that is not read within `wait_s` seconds is dropped.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    # A leading @ means the abstract namespace.
    name = "\0" + address[1:] if address.startswith("@") else address
    datagrams = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC
    # The service manager being away is no reason to stop recognizing places.
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, datagrams) as sock:
        sock.settimeout(wait_s)
        sock.connect(name)
        sock.sendall(state.encode())


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
