"""Positions for the autopilot: by which message, whether now, what it answered, and whether it then moved. No I/O.

A fix passes the gates, is encoded as the chosen message, and is followed up until the next one. Every change is
recorded in the journal; repetitions are not.
"""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Any

from msgspec.structs import replace
from pymavlink.dialects.v20 import common as mavlink

from edge.config import GatesConfig, TelemetryConfig
from edge.journal.records import FixSent, FixWithheld, PositionMessageChosen
from edge.localization import (
    BOUND_WRONG,
    CORRELATION_M,
    Decision,
    GpsVerdict,
    Limits,
    PlaceFix,
    PositionEstimator,
    ProtectionLevel,
    Refusal,
    Report,
    distance_from,
)
from edge.telemetry import encoders
from edge.telemetry.acknowledgements import MOVED_NS
from edge.telemetry.codec import Message
from edge.telemetry.doubted_gps import DoubtedGps
from edge.telemetry.encoders import Sending
from edge.telemetry.link_protocol import Publisher, velocity_aid
from edge.telemetry.position_messages import POSITION_MESSAGES, PositionMessage, TimeBase, suitable_message
from edge.telemetry.position_use import PositionUse
from edge.telemetry.remembered_bound import RememberedBound
from edge.telemetry.source_selection import GPS_SET, VISION_SET, SourceSelection
from edge.telemetry.vehicle import Vehicle

STEADY_RECORD_NS = 1_000_000_000
SETTLED_NS = 10_000_000_000  # after GPS is used again, nothing is left of a position of ours
LATE_NS = 10_000_000_000  # resets that improve on the autopilot come up to so far apart
log = logging.getLogger(__name__)


class PositionSender:
    """From fixes to position messages, for the one link that carries positions."""

    def __init__(
        self,
        telemetry: TelemetryConfig,
        gates: GatesConfig,
        vehicle: Vehicle,
        estimator: PositionEstimator,
        publisher: Publisher,
    ) -> None:
        """estimator: decides on each position, and reads of the autopilot whether it used one."""
        self._telemetry = telemetry
        self._gates = gates
        self._estimator = estimator
        self._vehicle = vehicle
        self._publisher = publisher
        self.message: PositionMessage | None = None
        self.why = ""
        remembered = Path(telemetry.journal) if telemetry.journal else None
        self.sources = SourceSelection(vehicle, publisher, remembered and remembered.with_suffix(".sources"))
        self.doubted_gps = DoubtedGps(vehicle, publisher)
        bound = remembered and remembered.with_suffix(".bound")
        self._remembered = RememberedBound(bound, gates.drift_percent)
        self._use = PositionUse(vehicle, self._bind, telemetry.sensor_id, publisher)
        self._withheld: FixWithheld | None = None
        self._recorded_ns = 0
        self._start_over()

    def _start_over(self) -> None:
        self._last_sent_ns: int | None = None
        self._bound_wrong = BOUND_WRONG
        self._sent_stamp_ns: int | None = None
        self.sent_status: dict[str, Any] = {}
        """The fields of `LinkStatus` on the newest position that was sent, of a steady stream about one per second."""
        self._had_gps = False
        self._use.new_session()

    def new_session(self) -> None:
        """The link came up, or the autopilot rebooted: it may be another one, and has lost all that was sent before."""
        self._start_over()
        self.sources.new_session()
        self._estimator.restart()
        self._choose()

    def _choose(self) -> None:
        """Choose the message; recorded when the choice changes."""
        emit = self._telemetry.emit
        if emit == "auto":
            message, why = suitable_message(self._vehicle.autopilot, self._vehicle.version)
        else:
            message, why = POSITION_MESSAGES.get(emit), f"[telemetry] emit = {emit}"
        if (message, why) != (self.message, self.why):
            self.message, self.why = message, why
            self._publisher.record(PositionMessageChosen(message.name if message else "report", why))
            if emit == "auto" and self._vehicle.version is not None:
                self._publisher.warn(f"Lookback: {why}")

    @property
    def set_without_gps(self) -> int:
        """Which of ArduPilot's sets of sources is used without GPS."""
        return VISION_SET if self.message is not None and self.message.name == "vision_position" else GPS_SET

    @property
    def enabled(self) -> bool:
        """Whether positions are sent at all, when the gates allow."""
        return self.message is not None and not self._use.is_off

    def uncertainty_m(self, now_ns: int) -> float | None:
        """One standard deviation of the autopilot's own position, None where nothing has ever bound it."""
        return self._estimator.uncertainty_m(self.report(now_ns))

    def report(self, now_ns: int) -> Report:
        """What the autopilot reports now."""
        vehicle = self._vehicle
        own = vehicle.position(now_ns)
        return Report(
            now_ns,
            gps=vehicle.gps.state(now_ns),
            gps_sigma_m=vehicle.gps.bound_m(own, now_ns),
            position=own,
            displacement=None if own is None else vehicle.displacement(own.stamp_ns),
            accuracy_m=vehicle.accuracy_m(now_ns),
            speed_mps=vehicle.speed_mps(now_ns),
            driven_m=vehicle.driven_m(now_ns),
            is_aided=vehicle.is_aided,
        )

    def _bind(self, sigma_m: float, now_ns: int) -> None:
        """The autopilot has used a position."""
        self._estimator.bind(sigma_m, self.report(now_ns), self._bound_wrong)

    def judge_gps(self, verdict: GpsVerdict, *, is_aided: bool) -> None:
        """What the places say of GPS now. is_aided: whether anything besides GPS measures the autopilot's velocity."""
        if self.doubted_gps.publish(verdict) and self._estimator.ignores_gps and not is_aided:
            self._publisher.warn("Lookback: no velocity aid, sends no position")

    def due(self, now_ns: int) -> TimeBase | None:
        """The time base of the fix that is due now, None while none is."""
        if self.message is None or not self._use.allows(now_ns):
            return None
        is_due = self._last_sent_ns is None or now_ns - self._last_sent_ns >= self._period_s(self.message) * 1e9
        return self.message.time_base if is_due else None

    def send(self, fix: PlaceFix, now_ns: int) -> list[Message]:
        """The messages that carry the fix, if it is due and every gate lets it pass."""
        if self.due(now_ns) is None or self.message is None or fix.stamp_ns == self._sent_stamp_ns:
            return []  # the last exposure was sent already
        decision = self._decide(fix, now_ns, self.message)
        if decision.refusal is not None:
            self._withhold(fix, decision.refusal, now_ns)
            return []
        self._withheld = None
        messages = self._encode(fix, now_ns, self.message, decision)
        if not messages:
            return []
        self._sent_stamp_ns = fix.stamp_ns
        if not self._has_sources:
            return messages
        self.sources.wanted = VISION_SET
        return [*self.sources.due(now_ns), *messages]

    def withdraw(self) -> None:
        """The vehicle is not on the map any more: what was not answered is not sent again."""
        self._use.withdraw()

    def _period_s(self, message: PositionMessage) -> float:
        return self._gates.min_interval_s if message.period_s is None else message.period_s

    def _decide(self, fix: PlaceFix, now_ns: int, message: PositionMessage, period_s: float | None = None) -> Decision:
        period_s = self._period_s(message) if period_s is None else period_s
        limits = Limits(period_s, message.max_age_s, message.acknowledged)
        displacement = self._vehicle.displacement(fix.stamp_ns)
        return self._estimator.decide(fix, limits, self._last_sent_ns, self.report(now_ns), displacement)

    def why_none(self, now_ns: int) -> str:
        """Why no position has been sent for a while, for people; "" where one has been."""
        if self.message is None:
            return self.why
        if self._use.is_off:
            return "the autopilot refuses positions"
        is_late = self._last_sent_ns is None or now_ns - self._last_sent_ns >= LATE_NS
        if not is_late:
            return ""
        withheld = self._withheld
        if withheld is None:
            return "the places do not agree yet"
        is_far = withheld.reason == "impossibly far" and withheld.distance_m is not None
        return f"{withheld.reason}, {withheld.distance_m:.0f} m" if is_far else withheld.reason

    def _withhold(self, fix: PlaceFix, refused: Refusal, now_ns: int) -> None:
        why = f": {self._vehicle.gps.why(now_ns)}" if refused.reason == "GPS is unknown" else ""
        if self._withheld is not None and refused.reason + why == self._withheld.reason:
            return
        distance_m = None if refused.distance_m is None else round(refused.distance_m, 3)
        self._withheld = FixWithheld(fix.place, refused.reason + why, distance_m, fix.map)
        self._publisher.record(self._withheld)

    def _encode(
        self, fix: PlaceFix, now_ns: int, message: PositionMessage, decision: Decision, *, again: bool = False
    ) -> list[Message]:
        """Encode a fix that may be sent, and keep what is needed to follow it up."""
        vehicle = self._vehicle
        boot_s = vehicle.boot_time_s(now_ns)
        if boot_s is None or (message.needs_origin and vehicle.origin is None):
            return []
        own = vehicle.position(now_ns)
        distance_m = round(distance_from(own, fix), 3) if own else None
        self._use.expect(fix, message, now_ns, again=again, is_new_stream=self._is_new_stream(now_ns))
        age_s = (now_ns - fix.stamp_ns) / 1e9
        down_m = vehicle.origin.alt_m - own.alt_m if own and vehicle.origin else 0.0
        sending = Sending(
            vehicle.system_id or 1,
            boot_s,
            age_s,
            self._telemetry.sensor_id,
            vehicle.origin,
            down_m,
            self._use.reset_counter,
            self._use.is_ignored and vehicle.is_aided and vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4,
        )
        values: list[Message] = []
        if message.acknowledged or now_ns - self._recorded_ns >= STEADY_RECORD_NS:
            self._recorded_ns = now_ns
            level_m = _level_m(decision.level)
            self._publisher.record(
                FixSent(
                    fix.place,
                    message.name,
                    fix.lat_deg or 0.0,
                    fix.lon_deg or 0.0,
                    fix.sigma_m,
                    boot_s,
                    age_s,
                    distance_m,
                    again,
                    fix.map,
                    *level_m,
                )
            )
            self.sent_status = {"sent_ns": now_ns, "sent_sigma_m": round(fix.sigma_m, 2)}
            self.sent_status |= {"level_along_m": level_m[0], "level_across_m": level_m[1]}
            values = encoders.protection_values(decision.level, round(1000 * boot_s))
        self._last_sent_ns, self._bound_wrong = now_ns, decision.bound_wrong
        vehicle.has_our_position = True
        if message.shares_information or not (message.acknowledged or vehicle.is_aided):
            fix = self._one_of_many(fix, now_ns, self._period_s(message))
        return [message.encode(fix, sending), *values]

    def _one_of_many(self, fix: PlaceFix, now_ns: int, period_s: float) -> PlaceFix:
        """The fix with a larger sigma: all within a correlation length have one error, and share its information."""
        speed_mps = self._vehicle.speed_mps(now_ns) or 0.0
        times = math.sqrt(max(1.0, CORRELATION_M / max(speed_mps * period_s, 1.0)))
        return replace(fix, sigma_along_m=times * fix.sigma_along_m, sigma_across_m=times * fix.sigma_across_m)

    def _is_new_stream(self, now_ns: int) -> bool:
        return self._last_sent_ns is None or now_ns - self._last_sent_ns > MOVED_NS

    @property
    def _has_sources(self) -> bool:
        """Whether ArduPilot's second set of sources is used without GPS, the first one with it."""
        return self.set_without_gps == VISION_SET and self._telemetry.switch_sources

    def read_acknowledgement(self, command: int, result: int, now_ns: int) -> None:
        """COMMAND_ACK that was addressed to us."""
        if command == encoders.SET_EKF_SOURCE_SET:
            self.sources.read_acknowledgement(result, now_ns)
        elif command == encoders.EXTERNAL_POSITION_ESTIMATE:
            self._use.read_acknowledgement(result, now_ns)

    def follow_up(self, now_ns: int) -> list[Message]:
        """To be called often: bound the uncertainty, send again what was not answered, check what was accepted."""
        if self._telemetry.emit == "auto" and self.message is None:
            self._choose()
        messages: list[Message] = []
        vehicle = self._vehicle
        report = self.report(now_ns)
        self._estimator.bind_by_gps(report)
        is_settled = self._last_sent_ns is None or now_ns - self._last_sent_ns > SETTLED_NS
        if is_settled and report.gps_sigma_m is not None and not self._estimator.ignores_gps:
            vehicle.has_our_position = False
        receivers = vehicle.gps.receiver_state(now_ns)
        if self._had_gps and receivers == "not healthy" and not self._estimator.is_bounded:
            log.warning("GPS is lost, and the autopilot had not used it yet: nothing bounds its position")
            self._publisher.warn("Lookback: GPS lost before the autopilot used it")
        self._had_gps = receivers == "healthy" or (self._had_gps and receivers == "unknown")
        self._choose_sources(works=receivers == "healthy")
        if self.sources.wanted is not None:
            messages += self.sources.due(now_ns)
        runs_away = not vehicle.is_aided and velocity_aid(vehicle, self.set_without_gps) is not None
        bounded_m = self._estimator.bounded_m(report)
        remembered_m = self._remembered.update(report, vehicle, bounded_m, runs_away=runs_away)
        if remembered_m is not None:
            self._bind(remembered_m, now_ns)
        self._use.check(now_ns)
        return messages + self._send_again(now_ns)

    def _choose_sources(self, *, works: bool) -> None:
        """The second set where GPS is ignored and positions are sent in its place, the first one where GPS works."""
        if self._estimator.ignores_gps:
            is_ardupilot = self._vehicle.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
            if self._gates.doubted_gps == "switch" and is_ardupilot and self.enabled:
                self.sources.wanted = VISION_SET
        # Whether or not the filter uses GPS: with the second set it does not.
        elif works and not self._gates.with_gps and (self._has_sources or self.sources.wanted == VISION_SET):
            self.sources.wanted = GPS_SET

    def _send_again(self, now_ns: int) -> list[Message]:
        """A fix that was not answered, once, unless it is stale by now, the vehicle stands, or GPS is back."""
        overdue = self._use.overdue(now_ns)
        if overdue is None or self.message is None:
            return []
        fix, may_be_sent = overdue
        messages: list[Message] = []
        if may_be_sent:
            decision = self._decide(fix, now_ns, self.message, period_s=0.0)
            if decision.refusal is None:
                messages = self._encode(fix, now_ns, self.message, decision, again=True)
        if not messages:
            self._use.give_up()
        return messages


def _level_m(level: ProtectionLevel | None) -> tuple[float | None, float | None]:
    """Meters along and across for the journal, None where nothing bounds them."""
    if level is None or not math.isfinite(level.along_m + level.across_m):
        return None, None
    return round(level.along_m, 2), round(level.across_m, 2)
