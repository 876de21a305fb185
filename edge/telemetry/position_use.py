"""Whether the autopilot uses the positions that it is sent: what they must do to its own, which is checked."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from edge.journal.records import FixChecked, Record
from edge.localization import AGREE_SIGMAS, PlaceFix, offset_m
from edge.telemetry.acknowledgements import MOVED_NS, Jump
from edge.telemetry.position_messages import PositionMessage
from edge.telemetry.stream_check import StreamCheck, unused_because
from edge.telemetry.vehicle import Vehicle

log = logging.getLogger(__name__)


class PositionUse:
    """What is expected of the autopilot's own position, and whether it happens."""

    def __init__(
        self,
        vehicle: Vehicle,
        bind: Callable[[float, int], object],
        sensor_id: int,
        record: Callable[[Record], object],
        send_text: Callable[[str], object],
    ) -> None:
        """bind: is called with the standard deviation of the autopilot's position where it has used one of ours."""
        self._vehicle, self._bind, self._sensor_id = vehicle, bind, sensor_id
        self._record, self._send_text = record, send_text
        self.reset_counter = 0
        """Of the positions of a stream: another number where they jump."""
        self.new_session()

    def new_session(self) -> None:
        """The autopilot may be another one, and has lost all that was sent before."""
        self._jump: tuple[PlaceFix, Jump, int] | None = None  # and when it was accepted; 0: not yet
        self._stream, self._unused = StreamCheck(), ""

    def expect(self, fix: PlaceFix, message: PositionMessage, now_ns: int, *, is_new_stream: bool) -> None:
        """A position is sent now: keep how far it should move the autopilot's own."""
        own = self._vehicle.position(now_ns)
        if own is None:
            return
        east_m, north_m = offset_m(own, fix)
        distance_m = math.hypot(east_m, north_m)
        if message.acknowledged:
            self._jump = fix, Jump(own, east_m, north_m, fix.sigma_m), 0
            return
        self._publish_unused(unused_because(self._vehicle, message.name, self._sensor_id))
        moved = self._stream.add(distance_m, fix.sigma_m, now_ns)
        if moved is not None:
            self._publish_check(fix, distance_m, "fixes sent", moved=moved)
        # So near, an autopilot follows the stream.
        if distance_m <= AGREE_SIGMAS * fix.sigma_m:
            self._bind(max(fix.sigma_m, distance_m), now_ns)
        elif is_new_stream:
            self.reset_counter = (self.reset_counter + 1) % 256

    def accepted(self, now_ns: int) -> None:
        """The autopilot has accepted the newest position: its own must move."""
        if self._jump is not None:
            self._jump = *self._jump[:2], now_ns

    def refused(self) -> None:
        """It has not: nothing need move."""
        self._jump = None

    def was_ignored(self, now_ns: int) -> bool:
        """Whether the autopilot's position, once it has had time to move to an accepted one, turns out not to have."""
        if self._jump is None or self._jump[2] == 0:
            return False
        fix, jump, accepted_ns = self._jump
        own = self._vehicle.position(now_ns)
        if own is None or own.stamp_ns <= accepted_ns:
            return False
        moved = jump.happened(own)
        if not moved and now_ns - accepted_ns < MOVED_NS:
            return False
        self._jump = None
        remaining_m = jump.remaining_m(own)
        self._publish_check(fix, remaining_m, "fix accepted", moved=moved)
        if moved:
            self._bind(max(fix.sigma_m, remaining_m), now_ns)
        return not moved

    def _publish_unused(self, why: str) -> None:
        if why and why != self._unused:
            log.error("the autopilot uses no positions: %s; see firmware_config", why)
            self._send_text(f"Lookback: positions unused: {why}")
        self._unused = why

    def _publish_check(self, fix: PlaceFix, off_m: float, what: str, *, moved: bool) -> None:
        self._record(FixChecked(fix.place, moved, round(off_m, 2), fix.map))
        if not moved:
            self._send_text(f"Lookback: {what}, position {off_m:.0f} m off")
