"""What the autopilot makes of what it is sent: what an answer means, and whether a position then moves its own.

ACCEPTED  of a position: its own must then move within MOVED_NS: a filter that is not in use accepts as well
FAILED, TEMPORARILY_REJECTED, CANCELED  not now (GPS works, no origin, not dead reckoning): pause, longer each time
DENIED, UNSUPPORTED  never: no more until the autopilot reboots
no answer  the next position goes when it is due; PX4 1.15 never answers

Positions of a stream are not acknowledged: an autopilot that is far from them must come nearer within STREAM_NS.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.backoff import BackOff, Exchange
from edge.geodesy import VehiclePosition, east_north_of
from edge.journal.records import FixAnswered, FixChecked
from edge.localization import Fix, PlaceFix, offset_m
from edge.telemetry.people import Publisher
from edge.telemetry.vehicle import Vehicle

Verdict: TypeAlias = Literal["accepted", "not now", "never", "wait"]

BACK_OFF_FIRST_NS = 1_000_000_000
BACK_OFF_LAST_NS = 30_000_000_000
ANSWER_NS = 1_000_000_001  # more than a second
NO_ANSWER = "NO_ANSWER"
CANCELED = 6  # MAV_RESULT_CANCELLED, which this dialect has no name for

MOVED_NS = 1_500_000_000
"""How long after ACCEPTED the position may take to move; and how long a stream may pause, unless it is of poses."""
STREAM_NS = 10_000_000_000
"""How long an autopilot that is far from the positions of a stream may take to come nearer."""
FAR_SIGMAS = 2.0
"""Standard deviations of a position beyond which the autopilot's own should come nearer to it."""
log = logging.getLogger(__name__)

VERDICTS: dict[int, Verdict] = {
    mavlink.MAV_RESULT_ACCEPTED: "accepted",
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "not now",
    mavlink.MAV_RESULT_DENIED: "never",
    mavlink.MAV_RESULT_UNSUPPORTED: "never",
    mavlink.MAV_RESULT_FAILED: "not now",
    mavlink.MAV_RESULT_IN_PROGRESS: "wait",
    CANCELED: "not now",
    mavlink.MAV_RESULT_COMMAND_LONG_ONLY: "never",
    mavlink.MAV_RESULT_COMMAND_INT_ONLY: "never",
}


def result_name(result: int, kind: str = "MAV_RESULT", prefix: str = "MAV_RESULT_") -> str:
    """A result of that kind without the prefix; the number of one that the dialect does not know."""
    entry = mavlink.enums[kind].get(result)
    return entry.name.removeprefix(prefix) if entry else str(result)


class Command(Exchange):
    """One command at a time, since an acknowledgement does not say which one it is for; and the pause after a failure.

    It is over when an answer has come, or when none has in time: what then follows is for its sender to say.
    """

    def __init__(self, longest_pause_ns: int = BACK_OFF_LAST_NS) -> None:
        super().__init__(ANSWER_NS, BackOff(BACK_OFF_FIRST_NS, longest_pause_ns))

    def read(self, result: int, now_ns: int) -> Verdict:
        """What the answer means. Where none is awaited, it is a second answer to one, and it takes a refusal back.

        A stranger may have forged the first of two.
        """
        verdict, was_waiting = VERDICTS.get(result, "not now"), self.is_waiting
        if verdict == "wait":
            return verdict
        self.answered()
        if was_waiting or verdict != "never":
            self.refusals = int(verdict == "never")
        if was_waiting and verdict == "accepted":
            self.pause.reset()
        elif was_waiting:
            self.pause.failed(now_ns)
        return verdict


@dataclass(frozen=True)
class FixTransmission:
    """A position that was sent at `at_ns` of CLOCK_MONOTONIC.

    own: the autopilot's position then, None where it had none. recorded_ns: when one was recorded last, this or an
    earlier one.
    """

    fix: Fix
    at_ns: int
    own: VehiclePosition | None
    recorded_ns: int = 0

    @property
    def place(self) -> PlaceFix:
        """What was sent."""
        return self.fix.place

    @property
    def move_m(self) -> tuple[float, float]:
        """Meters east and north from the autopilot's position to it; by how much that should jump."""
        return (0.0, 0.0) if self.own is None else offset_m(self.own, self.place)

    @property
    def distance_m(self) -> float:
        """Meters between them."""
        return math.hypot(*self.move_m)

    @property
    def is_far(self) -> bool:
        """Whether the autopilot's own position should come nearer to it."""
        return self.distance_m > FAR_SIGMAS * self.place.sigma_m

    def remaining_m(self, after: VehiclePosition) -> float:
        """How far the autopilot's position still is from it, without what was driven since then.

        Driven by the mean of both velocities, since a vehicle turns and brakes meanwhile.
        """
        own = self.own or after
        between_s = (after.stamp_ns - own.stamp_ns) / 1e9
        east_m, north_m = east_north_of(after.lat_deg, after.lon_deg, (own.lat_deg, own.lon_deg))
        driven_m = (own.east_mps + after.east_mps) / 2 * between_s, (own.north_mps + after.north_mps) / 2 * between_s
        return math.dist((east_m - driven_m[0], north_m - driven_m[1]), self.move_m)

    def moved(self, remaining_m: float) -> bool:
        """Whether so little remains that the autopilot has come nearer: half, or one standard deviation."""
        return remaining_m <= max(self.place.sigma_m, self.distance_m / 2)


class PositionUse:
    """What is expected of the autopilot after a position, and whether it happens."""

    def __init__(self, vehicle: Vehicle, publisher: Publisher) -> None:
        self._vehicle, self._publisher = vehicle, publisher
        self.new_session()

    def new_session(self) -> None:
        """The autopilot may be another one, and has lost all that was sent before."""
        self.newest: FixTransmission | None = None
        """The newest that was sent, None before the first."""
        self.command = Command()
        """That which carries one that is acknowledged."""
        self._followed: FixTransmission | None = None  # to which the autopilot's own position must come nearer
        self._accepted_ns = 0  # when that was accepted; 0: not yet, or it is one of a stream
        self._unused = ""  # why a stream is not used, as it was published

    def expect(self, sent: FixTransmission, *, is_reset: bool, unused: str = "") -> None:
        """A position is sent now: keep what it should be answered, and how far it should move the autopilot's own.

        is_reset: it is acknowledged; else it is one of a stream. unused: why the autopilot will not use that.
        """
        before, self.newest = self.newest, sent
        if is_reset:
            self.command.ask(sent.at_ns)
            if not self._accepted_ns:  # one that was accepted is followed to its end: the next comes before that
                self._followed = sent if sent.own is not None else None
        elif sent.own is not None:
            pauses_ns = MOVED_NS if sent.fix.pose_sigma_m is None else STREAM_NS
            self._follow_stream(sent, unused, is_new=before is None or sent.at_ns - before.at_ns > pauses_ns)

    def _follow_stream(self, sent: FixTransmission, unused: str, *, is_new: bool) -> None:
        if unused and unused != self._unused:
            log.error("the autopilot uses no positions: %s; see firmware_config", unused)
            self._publisher.warn(f"Lookback: positions unused: {unused}")
        self._unused, self._accepted_ns = unused, 0
        began = self._followed = sent if is_new else self._followed
        if began is not None and sent.at_ns - began.at_ns >= STREAM_NS:
            self._followed = None if began.is_far else sent
            if began.is_far:
                self._publish_check(sent.place, sent.distance_m, "fixes sent", moved=began.moved(sent.distance_m))

    def read_acknowledgement(self, result: int, now_ns: int) -> None:
        """The autopilot has answered the newest position."""
        fix = self.newest.place if self.newest is not None and self.command.is_waiting else None
        verdict = self.command.read(result, now_ns)
        if verdict == "wait" or fix is None:
            return
        self._publisher.record(FixAnswered(fix.place, result_name(result), fix.map))
        if verdict != "accepted":
            self._followed = self._followed if self._accepted_ns else None
        elif self._followed is not None and not self._accepted_ns:  # its own position must move
            self._accepted_ns = now_ns
        if verdict == "never":
            log.error("the autopilot answered %s: positions are off until it reboots", result_name(result))
            self._publisher.warn(f"Lookback: positions {result_name(result)}, off")

    def check(self, now_ns: int) -> None:
        """Answers must have come in time, and the autopilot's position have moved to one that was accepted."""
        if self.newest is not None and self.command.is_overdue(now_ns):
            self.command.answered()
            self._followed = self._followed if self._accepted_ns else None
            self._publisher.record(FixAnswered(self.newest.place.place, NO_ANSWER, self.newest.place.map))
        sent, own = self._followed, self._vehicle.position(now_ns)
        if sent is None or not self._accepted_ns or own is None or own.stamp_ns <= self._accepted_ns:
            return
        remaining_m = sent.remaining_m(own)
        moved = sent.moved(remaining_m)
        if not moved and now_ns - self._accepted_ns < MOVED_NS:
            return
        self._followed, self._accepted_ns = None, 0
        self._publish_check(sent.place, remaining_m, "fix accepted", moved=moved)
        if not moved:
            self.command.pause.failed(now_ns)

    def _publish_check(self, fix: PlaceFix, off_m: float, what: str, *, moved: bool) -> None:
        self._publisher.record(FixChecked(fix.place, moved, off_m, fix.map))
        if not moved:
            self._publisher.warn(f"Lookback: {what}, position {off_m:.0f} m off")
