"""Positions for the autopilot: by which message, and when one is due. No I/O.

A fix is encoded as the chosen message, and followed until the next one (`PositionUse`). Every change is recorded in the
journal; repetitions are not.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

from msgspec import UNSET, UnsetType
from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import GatesConfig, TelemetryConfig
from edge.journal.records import FixConfirmed, FixSent, FixWithheld, PositionMessageChosen
from edge.localization import (
    CORRELATION_M,
    NO_PLACES,
    Fix,
    FixFeedback,
    FixRequest,
    NoFix,
    PlaceFix,
    PositionEstimator,
    ProtectionLevel,
    distance_from,
)
from edge.telemetry import encoders
from edge.telemetry.acknowledgements import FAR_SIGMAS, MOVED_NS, FixTransmission, PositionUse
from edge.telemetry.codec import Message
from edge.telemetry.encoders import MessageContext
from edge.telemetry.firmware import GPS_SET, SET_WITHOUT_GPS
from edge.telemetry.people import Publisher
from edge.telemetry.position_messages import POSITION_MESSAGES, PositionMessage
from edge.telemetry.source_selection import SourceSelection
from edge.telemetry.vehicle import Vehicle

STEADY_RECORD_NS = 1_000_000_000
SAID_NS = 10_000_000_000  # after which the pilot reads the figures of why none is sent anew
IMPROVING_S = 10.0  # resets that improve on the autopilot come up to so far apart


class PositionSender:
    """From fixes to position messages, for the one link that carries positions."""

    def __init__(
        self,
        telemetry: TelemetryConfig,
        gates: GatesConfig,
        vehicle: Vehicle,
        drive: PositionEstimator,
        publisher: Publisher,
    ) -> None:
        """drive: gets what becomes of each position."""
        self._telemetry, self._gates = telemetry, gates
        self._drive = drive
        self._vehicle = vehicle
        self._publisher = publisher
        self.message: PositionMessage | None = None
        self.why = ""
        remembered = Path(telemetry.journal).with_suffix(".sources") if telemetry.journal else None
        self.sources = SourceSelection(vehicle, publisher, remembered)
        self.use = PositionUse(vehicle, drive, publisher)
        self._reset_ns = 0  # when a stream was helped by a reset last; 0 before
        self._is_led = True  # by a GPS that was taken away
        self._withheld: FixWithheld | None = None  # as recorded
        self._confirmed: tuple[int, Fix] | None = None  # when a position confirmed the autopilot's own last
        self._refused = NoFix(NO_PLACES)
        self._said = ("", 0, "")  # why, since when, and what people read of it

    def new_session(self) -> None:
        """The link came up, or the autopilot rebooted: it may be another one, and has lost all that was sent before."""
        self.use.new_session()
        self.sources.new_session()
        self._choose()

    def _choose(self) -> None:
        """Choose the message; recorded when the choice changes."""
        emit = self._telemetry.emit
        name, why = str(emit), f"[telemetry] emit = {emit}"
        if emit == "auto":
            name, why = self._vehicle.session.firmware.suitable(self._vehicle.session.version)
        message = POSITION_MESSAGES.get(name)
        if (message, why) != (self.message, self.why):
            self.message, self.why = message, why
            self._publisher.record(PositionMessageChosen(message.name if message else "report", why))
            if emit == "auto" and self._vehicle.session.version is not None:
                self._publisher.warn(f"Lookback: {why}")

    @property
    def enabled(self) -> bool:
        """Whether positions are sent at all, when the gates allow."""
        return self.message is not None and not self.use.command.is_refused

    @property
    def selects_sources(self) -> bool:
        """Whether a GPS that is ignored is taken from the autopilot as well."""
        return self._gates.doubted_gps == "switch" and self.enabled

    def due(self, now_ns: int) -> FixRequest | None:
        """What holds for the position that is due now, None while none is; once more for one that was not answered."""
        message, use = self.message, self.use
        if message is None:
            return None
        limits = FixRequest(message.time_base, message.max_age_s, message.acknowledged)
        overdue = use.overdue(now_ns)
        if overdue is not None:
            return replace(limits, again=overdue.fix)
        return limits if use.command.is_due(now_ns) and self._since_s(now_ns) >= self._period_s(message) else None

    def send(self, answer: Fix | NoFix, now_ns: int) -> list[Message]:
        """The messages that carry the position which was due, if there is one; else why there is none is recorded."""
        overdue, newest = self.use.overdue(now_ns), self.use.newest
        place = answer.place if isinstance(answer, Fix) else answer.fix
        is_again = overdue is not None and place is overdue.place
        if newest and place is not None and place.stamp_ns == newest.place.stamp_ns and not is_again:
            return []  # the last exposure was sent already
        messages: list[Message] = []
        if isinstance(answer, Fix) and self.message is not None:
            self._withheld, self._refused = None, NoFix(NO_PLACES)
            messages = self._encode(answer, now_ns, self.message, again=is_again)
        elif isinstance(answer, NoFix) and overdue is None:
            self._withhold(answer)
            if answer.confirms is not None:
                self._confirm(answer.confirms, answer.distance_m or 0.0, now_ns)
        if overdue is not None and not messages:
            self.use.give_up()
        return messages

    def _period_s(self, message: PositionMessage) -> float:
        return self._gates.min_interval_s if message.period_s is None else message.period_s

    def _since_s(self, now_ns: int) -> float:
        """Seconds since the newest position was sent, or confirmed the autopilot's own; endless before the first."""
        newest = self.newest
        return math.inf if newest is None else (now_ns - newest[0]) / 1e9

    @property
    def newest(self) -> tuple[int, Fix] | None:
        """The newest position that was sent, or confirmed the autopilot's own, and when; None before the first."""
        sent = None if self.use.newest is None else (self.use.newest.at_ns, self.use.newest.fix)
        return max((one for one in (sent, self._confirmed) if one is not None), key=lambda one: one[0], default=None)

    def why_none(self, now_ns: int) -> str:
        """Why no position has been sent for a while, for people; "" where one has been."""
        if self.message is None:
            return self.why
        if self.use.command.is_refused:
            return "the autopilot refuses positions"
        if self._since_s(now_ns) < IMPROVING_S:
            return ""
        why, at_ns, words = self._said
        if why != str(self._refused) or now_ns - at_ns >= SAID_NS:
            words = self._refused.in_words
            self._said = str(self._refused), now_ns, words
        return words

    def _withhold(self, refused: NoFix) -> None:
        fix, before = refused.fix, self._withheld
        self._refused = refused
        if fix is not None and (before is None or str(refused) != before.reason):
            self._withheld = FixWithheld(fix.place, str(refused), refused.distance_m, fix.map)
            self._publisher.record(self._withheld)

    def _confirm(self, fix: Fix, distance_m: float, now_ns: int) -> None:
        """The autopilot's own position agrees with one that might be sent, which aids it as one that it used."""
        place, self._confirmed = fix.place, (now_ns, fix)
        self._drive.update(now_ns, FixFeedback(fix, distance_m))
        self._publisher.record(
            FixConfirmed(
                place.place,
                place.stamp_ns,
                place.lat_deg or 0.0,
                place.lon_deg or 0.0,
                place.sigma_m,
                distance_m,
                place.map,
                *level_m(fix.level),
                place.points,
                place.sigma_along_m,
                held_axes(fix),
            )
        )

    def _encode(self, fix: Fix, now_ns: int, message: PositionMessage, *, again: bool) -> list[Message]:
        """Encode a fix that may be sent, and keep what is needed to follow it up."""
        vehicle, place = self._vehicle, fix.place
        boot_s = vehicle.boot_time_s(now_ns)
        if boot_s is None:
            return []
        own, newest = vehicle.position(now_ns), self.use.newest
        recorded_ns = newest.recorded_ns if newest else 0
        is_recorded = message.acknowledged or now_ns - recorded_ns >= STEADY_RECORD_NS
        sent = FixTransmission(fix, now_ns, own, again, now_ns if is_recorded else recorded_ns)
        session, sensor_id, unused = vehicle.session, self._telemetry.sensor_id, ""
        if not message.acknowledged:
            unused = session.firmware.unused_because(session.parameters, message.name, sensor_id)
        self._drive.update(now_ns, FixFeedback(fix))
        self.use.expect(sent, is_reset=message.acknowledged, unused=unused)
        sending = MessageContext(vehicle.target_id, boot_s, age_s=(now_ns - place.stamp_ns) / 1e9, sensor_id=sensor_id)
        values: list[Message] = []
        if is_recorded:
            self._record(sent, message, sending)
            values = encoders.protection_values(fix.level, round(1000 * boot_s))
        if not (message.acknowledged or vehicle.velocity.aid.is_any):
            place = self._one_of_many(place, now_ns, self._period_s(message))
        resets = [] if message.acknowledged else self._reset_from_gps(sent, sending)
        return [*resets, message.encode(place, sending), *values]

    def _reset_from_gps(self, sent: FixTransmission, sending: MessageContext) -> list[Message]:
        """A reset beside a stream once GPS is taken away, and again while the autopilot is far from the stream.

        PX4 1.18 fuses the first of a stream where it is less certain, hardly moves, and takes none of the rest for 7 s:
        15 m off became 20. The first reset corrects its heading as well, from 7.8 degrees off to 2.2 (it is fused with
        nearly no variance); the next one, while the stream is in use, is a hard one.
        """
        if not self.sources.is_gps_off:
            self._reset_ns, self._is_led = 0, True
            return []
        if sent.at_ns - self._reset_ns < MOVED_NS:
            return []
        if self._reset_ns:
            self._is_led &= sent.distance_m > FAR_SIGMAS * sent.place.sigma_m
        if not self._is_led:
            return []
        self._reset_ns, message = sent.at_ns, POSITION_MESSAGES["external_position"]
        self._record(sent, message, sending)
        return [message.encode(sent.place, sending)]

    def _record(self, sent: FixTransmission, message: PositionMessage, sending: MessageContext) -> None:
        fix, own = sent.place, sent.own
        self._publisher.record(
            FixSent(
                fix.place,
                message.name,
                fix.lat_deg or 0.0,
                fix.lon_deg or 0.0,
                fix.sigma_m,
                sending.boot_s,
                sending.age_s,
                distance_from(own, fix) if own else None,
                sent.is_again,
                fix.map,
                *level_m(sent.fix.level),
                fix.points,
                fix.sigma_along_m,
                held_axes(sent.fix),
            )
        )

    def _one_of_many(self, fix: PlaceFix, now_ns: int, period_s: float) -> PlaceFix:
        """The fix with a larger sigma: all within a correlation length have one error, and share its information."""
        speed_mps = self._vehicle.motion.speed_mps(now_ns) or 0.0
        times = math.sqrt(max(1.0, CORRELATION_M / max(speed_mps * period_s, 1.0)))
        return replace(
            fix, sigma_along_m=times * fix.sigma_along_m, sigma_cross_track_m=times * fix.sigma_cross_track_m
        )

    def read_acknowledgement(self, command: int, result: int, now_ns: int) -> None:
        """COMMAND_ACK that was addressed to us."""
        if command in (mavlink.MAV_CMD_SET_EKF_SOURCE_SET, encoders.SENSOR_ENABLE):
            self.sources.read_acknowledgement(result, now_ns)
        elif command == encoders.EXTERNAL_POSITION_ESTIMATE:
            self.use.read_acknowledgement(result, now_ns)

    def follow_up(self, now_ns: int) -> list[Message]:
        """To be called often: select sources, check what was accepted."""
        if self._telemetry.emit == "auto" and self.message is None:
            self._choose()
        self._choose_sources(works=self._vehicle.session.gps.receiver_state(now_ns) == "healthy")
        messages = [] if self.sources.wanted is None else self.sources.due(now_ns)
        self.use.check(now_ns)
        return messages

    def _choose_sources(self, *, works: bool) -> None:
        """Without GPS where it is ignored and positions are sent in its place; with it once it is consistent again.

        Only then: of a GPS that was not judged since a crash of this program, nobody knows whether it is wrong.
        """
        known = self._drive.state
        if known.ignores_gps:
            if self.selects_sources and self._vehicle.session.firmware.gps_switch:
                self.sources.wanted = SET_WITHOUT_GPS
        elif works and known.gps.state == "consistent":
            self.sources.wanted = GPS_SET


def held_axes(fix: Fix) -> Literal["along-track", "cross-track"] | UnsetType:
    """The axis on which a position is the autopilot's own, for the journal."""
    along, cross = fix.held_axes
    return "along-track" if along else "cross-track" if cross else UNSET


def level_m(level: ProtectionLevel | None) -> tuple[float | None, float | None]:
    """Meters along-track and cross-track for people, None where nothing bounds them."""
    if level is None or not math.isfinite(level.along_track_m + level.cross_track_m):
        return None, None
    return round(level.along_track_m, 2), round(level.cross_track_m, 2)
