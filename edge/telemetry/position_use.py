"""What the autopilot makes of the positions that it is sent: its answers, and whether its own position then moves."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from edge.backoff import BackOff
from edge.journal.records import FixAnswered, FixChecked
from edge.localization import AGREE_SIGMAS, PlaceFix, offset_m
from edge.telemetry.acknowledgements import (
    ANSWER_NS,
    BACK_OFF_FIRST_NS,
    BACK_OFF_LAST_NS,
    MOVED_NS,
    NO_ANSWER,
    VERDICTS,
    Jump,
    result_name,
)
from edge.telemetry.link_protocol import Publisher
from edge.telemetry.position_messages import PositionMessage
from edge.telemetry.stream_check import StreamCheck
from edge.telemetry.vehicle import Vehicle

log = logging.getLogger(__name__)


class PositionUse:
    """What is expected of the autopilot after a position, and whether it happens."""

    def __init__(
        self, vehicle: Vehicle, bind: Callable[[float, int], object], sensor_id: int, publisher: Publisher
    ) -> None:
        """bind: is called with the standard deviation of the autopilot's position where it has used one of ours."""
        self._vehicle, self._bind, self._publisher = vehicle, bind, publisher
        self._stream = StreamCheck(vehicle, sensor_id)
        self.reset_counter = 0
        """Of the positions of a stream: another number where they jump."""
        self.new_session()

    def new_session(self) -> None:
        """The autopilot may be another one, and has lost all that was sent before."""
        self._back_off = BackOff(BACK_OFF_FIRST_NS, BACK_OFF_LAST_NS)
        self._unanswered: tuple[PlaceFix, int, bool] | None = None  # fix, when it was sent, whether for the last time
        self.is_off = False
        """Whether the autopilot has refused positions for good."""
        self._jump: tuple[PlaceFix, Jump, int] | None = None  # and when it was accepted; 0: not yet
        self.is_ignored = False
        """Whether the newest position that was accepted, and checked, has not moved the autopilot's own."""
        self._stream.new_session()

    def allows(self, now_ns: int) -> bool:
        """Whether a position may be sent: none waits for its answer, nor is one refused for good or for a while."""
        return not self.is_off and self._unanswered is None and self._back_off.is_over(now_ns)

    def expect(self, fix: PlaceFix, message: PositionMessage, now_ns: int, *, again: bool, is_new_stream: bool) -> None:
        """A position is sent now: keep what it should be answered, and how far it should move the autopilot's own."""
        if message.acknowledged:
            self._unanswered = fix, now_ns, again
        own = self._vehicle.position(now_ns)
        if own is None:
            return
        east_m, north_m = offset_m(own, fix)
        distance_m = math.hypot(east_m, north_m)
        if message.acknowledged:
            # One that was accepted is followed to its end: the next position comes before that.
            if self._jump is None or not self._jump[2]:
                self._jump = fix, Jump(own, east_m, north_m, fix.sigma_m), 0
            return
        unused = self._stream.newly_unused(message.name)
        if unused:
            log.error("the autopilot uses no positions: %s; see firmware_config", unused)
            self._publisher.warn(f"Lookback: positions unused: {unused}")
        moved = self._stream.add(distance_m, fix.sigma_m, now_ns)
        if moved is not None:
            self._publish_check(fix, distance_m, "fixes sent", moved=moved)
        # So near, an autopilot follows the stream.
        if distance_m <= AGREE_SIGMAS * fix.sigma_m:
            self._bind(max(fix.sigma_m, distance_m), now_ns)
        elif is_new_stream:
            self.reset_counter = (self.reset_counter + 1) % 256

    def read_acknowledgement(self, result: int, now_ns: int) -> None:
        """The autopilot has answered the newest position."""
        verdict = VERDICTS.get(result, "not now")
        if verdict == "wait":
            return
        if self._unanswered is None:
            self.is_off &= verdict == "never"  # of two answers to one position, a stranger may have forged the refusal
            return
        fix, _, _ = self._unanswered
        self._unanswered = None
        self._publisher.record(FixAnswered(fix.place, result_name(result), fix.map))
        if verdict == "accepted":
            self._back_off.reset()
            if self._jump is not None and not self._jump[2]:  # its own position must move
                self._jump = *self._jump[:2], now_ns
            return
        self._drop_jump()
        self._back_off.failed(now_ns)
        if verdict == "never":
            self.is_off = True
            log.error("the autopilot answered %s: positions are off until it reboots", result_name(result))
            self._publisher.warn(f"Lookback: positions {result_name(result)}, off")

    def withdraw(self) -> None:
        """What was not answered is not sent again."""
        if self._unanswered is not None:
            self._unanswered = *self._unanswered[:2], True

    def overdue(self, now_ns: int) -> tuple[PlaceFix, bool] | None:
        """A fix whose answer did not come in time, and whether it may be sent again; None while there is none."""
        if self._unanswered is None or now_ns - self._unanswered[1] <= ANSWER_NS:
            return None
        fix, _, was_last = self._unanswered
        return fix, not was_last

    def give_up(self) -> None:
        """A fix that is not answered is not sent again."""
        if self._unanswered is not None:
            fix, _, _ = self._unanswered
            self._unanswered = None
            self._drop_jump()
            self._publisher.record(FixAnswered(fix.place, NO_ANSWER, fix.map))

    def _drop_jump(self) -> None:
        """What was not accepted moves nothing."""
        if self._jump is not None and not self._jump[2]:
            self._jump = None

    def check(self, now_ns: int) -> None:
        """Once it has had time, the autopilot's position must have moved to an accepted one."""
        if self._was_ignored(now_ns):
            self._back_off.failed(now_ns)

    def _was_ignored(self, now_ns: int) -> bool:
        if self._jump is None or self._jump[2] == 0:
            return False
        fix, jump, accepted_ns = self._jump
        own = self._vehicle.position(now_ns)
        if own is None or own.stamp_ns <= accepted_ns:
            return False
        moved = jump.happened(own)
        if not moved and now_ns - accepted_ns < MOVED_NS:
            return False
        self._jump, self.is_ignored = None, not moved
        remaining_m = jump.remaining_m(own)
        self._publish_check(fix, remaining_m, "fix accepted", moved=moved)
        if moved:
            self._bind(max(fix.sigma_m, remaining_m), now_ns)
        return not moved

    def _publish_check(self, fix: PlaceFix, off_m: float, what: str, *, moved: bool) -> None:
        self._publisher.record(FixChecked(fix.place, moved, round(off_m, 2), fix.map))
        if not moved:
            self._publisher.warn(f"Lookback: {what}, position {off_m:.0f} m off")
