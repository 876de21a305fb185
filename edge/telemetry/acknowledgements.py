"""What the autopilot makes of what it is sent: what an answer means, and whether positions then move its own.

ACCEPTED  but a filter that is not in use accepts as well
FAILED, TEMPORARILY_REJECTED, CANCELED  not now (GPS works, no origin, not dead reckoning): pause, longer each time
DENIED, UNSUPPORTED  never: no more until the autopilot reboots
no answer  the next position goes when it is due; PX4 1.15 never answers

An autopilot that is far from what it is sent must come nearer: to a stream, which is not acknowledged, within
STREAM_NS, and by resets within RESETS_NS.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.backoff import BackOff, Exchange
from edge.journal.records import FixAnswered, FixChecked
from edge.localization import Fix, PlaceFix
from edge.telemetry.people import Publisher

Verdict: TypeAlias = Literal["accepted", "not now", "never", "wait"]

BACK_OFF_FIRST_NS = 1_000_000_000
BACK_OFF_LAST_NS = 30_000_000_000
ANSWER_NS = 1_000_000_001  # more than a second
NO_ANSWER = "NO_ANSWER"

MOVED_NS = 1_500_000_000
"""How long a stream may pause, unless it is of poses, and be the same."""
STREAM_NS, RESETS_NS = 10_000_000_000, 3_000_000_000
"""How long an autopilot may take to come nearer to positions of a stream, and to those that it is reset by."""
FAR_SIGMAS = 2.0
"""Standard deviations of a position beyond which the autopilot's own should come nearer to it."""
log = logging.getLogger(__name__)

VERDICTS: dict[int, Verdict] = {
    mavlink.MAV_RESULT_ACCEPTED: "accepted",
    mavlink.MAV_RESULT_DENIED: "never",
    mavlink.MAV_RESULT_UNSUPPORTED: "never",
    mavlink.MAV_RESULT_IN_PROGRESS: "wait",
    mavlink.MAV_RESULT_COMMAND_LONG_ONLY: "never",
    mavlink.MAV_RESULT_COMMAND_INT_ONLY: "never",
}
"""Of a MAV_RESULT; of any other, "not now"."""


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

    distance_m: from the autopilot's own position then, None where it had none. recorded_ns: when one was recorded last,
    this or an earlier one.
    """

    fix: Fix
    at_ns: int
    distance_m: float | None
    recorded_ns: int = 0

    @property
    def place(self) -> PlaceFix:
        """What was sent."""
        return self.fix.place

    @property
    def is_far(self) -> bool:
        """Whether the autopilot's own position should come nearer to it."""
        return (self.distance_m or 0.0) > FAR_SIGMAS * self.place.sigma_m


class PositionUse:
    """What is expected of the autopilot after a position, and whether it happens."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self.new_session()

    def new_session(self) -> None:
        """The autopilot may be another one, and has lost all that was sent before."""
        self.newest: FixTransmission | None = None
        """The newest that was sent, None before the first."""
        self.confirmed_ns: int | None = None
        """When the autopilot's own position last agreed with one that was sent, or moved to it."""
        self.command = Command()
        """That which carries one that is acknowledged."""
        self._first: FixTransmission | None = None  # from which on the autopilot must come nearer; None: that was said
        self._unused = ""  # why a stream is not used, as it was published

    def expect(self, sent: FixTransmission, *, is_reset: bool, unused: str = "") -> None:
        """A position is sent now: keep what it should be answered, and whether the autopilot has come nearer by now.

        is_reset: it is acknowledged; else it is one of a stream. unused: why the autopilot will not use that.
        """
        before, self.newest = self.newest, sent
        if is_reset:
            self.command.ask(sent.at_ns)
        elif unused and unused != self._unused:
            log.error("the autopilot uses no positions: %s; see firmware_config", unused)
            self._publisher.warn(f"Lookback: positions unused: {unused}")
        self._unused = unused
        pause_ns = STREAM_NS if is_reset or sent.fix.pose_sigma_m is not None else MOVED_NS
        if before is None or sent.at_ns - before.at_ns > pause_ns:
            self._first = sent
        first = self._first
        if first is not None and sent.at_ns - first.at_ns >= (RESETS_NS if is_reset else STREAM_NS):
            self._first = None if first.is_far else sent
            if first.is_far:
                self._check(first, sent)
        if sent.distance_m is not None and not sent.is_far:
            self.confirmed_ns = sent.at_ns

    def _check(self, first: FixTransmission, sent: FixTransmission) -> None:
        """Half of the way, or one standard deviation: so near an autopilot has come that uses them."""
        place, off_m = sent.place, sent.distance_m or 0.0
        moved = off_m <= max(place.sigma_m, (first.distance_m or 0.0) / 2)
        self._publisher.record(FixChecked(place.place, moved, off_m, place.map))
        if moved:
            self.confirmed_ns = sent.at_ns
        else:
            self._publisher.warn(f"Lookback: fixes sent, position {off_m:.0f} m off")

    def read_acknowledgement(self, result: int, now_ns: int) -> None:
        """The autopilot has answered the newest position."""
        fix = self.newest.place if self.newest is not None and self.command.is_waiting else None
        verdict = self.command.read(result, now_ns)
        if verdict == "wait" or fix is None:
            return
        self._publisher.record(FixAnswered(fix.place, result_name(result), fix.map))
        if verdict != "accepted":  # what was not accepted moves nothing
            self._first = None
        if verdict == "never":
            log.error("the autopilot answered %s: positions are off until it reboots", result_name(result))
            self._publisher.warn(f"Lookback: positions {result_name(result)}, off")

    def check_answer(self, now_ns: int) -> None:
        """A position whose answer has not come in time has none."""
        if self.newest is not None and self.command.is_overdue(now_ns):
            self.command.answered()
            self._publisher.record(FixAnswered(self.newest.place.place, NO_ANSWER, self.newest.place.map))
