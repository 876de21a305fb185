"""Positions for the autopilot: by which message, and when one is due. No I/O.

A fix is encoded as the chosen message, and followed until the next one (`PositionUse`). Every change is recorded in the
journal; repetitions are not.
"""

from __future__ import annotations

import math
from pathlib import Path

from msgspec import UNSET
from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import GatesConfig, TelemetryConfig
from edge.geodesy import moved
from edge.journal.records import FixSent, FixWithheld, PositionMessageChosen, VehicleMisled
from edge.localization import (
    CORRELATION_M,
    HOLE_S,
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
from edge.telemetry.acknowledgements import MOVED_NS, FixTransmission, PositionUse
from edge.telemetry.codec import Message
from edge.telemetry.encoders import POSITION_MESSAGES, MessageContext, PositionMessage
from edge.telemetry.firmware import GPS_SET, ON_THE_GROUND, SET_WITHOUT_GPS
from edge.telemetry.people import Publisher
from edge.telemetry.source_selection import LOST, SourceSelection
from edge.telemetry.vehicle import Vehicle

STEADY_RECORD_NS = 1_000_000_000
KEEP_UP_NS = 200_000_000  # ArduPilot calls a visual odometry unhealthy after 0.3 s (AP_VISUALODOM_TIMEOUT_MS)
SENT_S = 10.0  # so long after a position, nobody asks why there is none
DOUBTED = ("suspect", "inconsistent", "faulty")  # verdicts on GPS
MISLED, STOP_NS = ("inconsistent", "faulty"), 3_000_000_000
"""Verdicts on GPS by which no vehicle may steer itself for longer; the pilot is asked, or it is stopped, as often."""


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
        self.use = PositionUse(publisher)
        self._reset_ns = 0  # when a stream was helped by a reset last; 0 before
        self._is_led = True  # by a GPS that was taken away
        self._withheld: FixWithheld | None = None  # as recorded
        self._misled_ns, self._stopped_ns = 0, 0  # since when it is not, and when it was stopped last
        self._asked_ns, self._hole_ns = 0, 0
        self._judged_ns: int | None = None  # the moment of the newest position that was sent, or withheld
        self._kept_up_ns = 0  # when a sensor was last kept healthy without a pose
        self._refused = NoFix(NO_PLACES)

    def new_session(self) -> None:
        """The link came up, or the autopilot rebooted: it may be another one, and has lost all that was sent before."""
        self.use.new_session()
        self.sources.new_session()
        self._choose()

    def _choose(self, *, all_came: bool = False) -> None:
        """Choose the message; recorded when the choice changes. all_came: no further parameter will."""
        emit, session = self._telemetry.emit, self._vehicle.session
        name, why = str(emit), f"[telemetry] emit = {emit}"
        if emit == "auto":
            name, why = session.firmware.suitable(session.version, session.parameters, all_came=all_came)
        message = POSITION_MESSAGES.get(name)
        self._vehicle.fuses_poses = message is not None and not message.acknowledged
        if (message, why) != (self.message, self.why):
            self.message, self.why = message, why
            self._publisher.record(PositionMessageChosen(message.name if message else "report", why))
            if message is not None and emit == "auto":
                self._publisher.warn(f"Lookback: {why}")

    @property
    def enabled(self) -> bool:
        """Whether positions are sent at all, when the gates allow."""
        return self.message is not None and not self.use.command.is_refused

    @property
    def _message_now(self) -> PositionMessage | None:
        """That which was chosen; where no keypoint pose says where the vehicle is, a reset in place of poses."""
        waits = self.message is not None and self.message.moment == "pose" and self._drive.pose_ns is None
        return POSITION_MESSAGES["external_position"] if waits else self.message

    @property
    def selects_sources(self) -> bool:
        """Whether a GPS that is ignored is taken from the autopilot as well."""
        return self._gates.doubted_gps == "switch" and self.enabled

    def due(self, now_ns: int) -> FixRequest | None:
        """What holds for the position that is due now, None while none is."""
        message, use = self._message_now, self.use
        if message is None:
            return None
        limits = FixRequest(message.moment, message.max_age_s, message.acknowledged)
        if message.moment == "pose":
            # Each pose is judged when it is new, and every second what keeps them away.
            if self._drive.pose_ns == self._judged_ns and now_ns - self._asked_ns < STEADY_RECORD_NS:
                return None
            self._asked_ns = now_ns
        return limits if use.command.is_due(now_ns) and self._since_s(now_ns) >= self._period_s(message) else None

    def send(self, answer: Fix | NoFix, now_ns: int) -> list[Message]:
        """The messages that carry the position which was due, if there is one; else why there is none is recorded."""
        message, newest = self._message_now, self.use.newest
        place = answer.place if isinstance(answer, Fix) else answer.fix
        if newest and place is not None and place.stamp_ns == newest.place.stamp_ns:
            return []  # the last exposure was sent already
        if place is not None and message is not None and message.moment != "exposure":
            if place.stamp_ns == self._judged_ns:
                return []  # a pose is judged once, and grows old until the next one
            self._judged_ns = place.stamp_ns
        if isinstance(answer, NoFix):
            self._withhold(answer)
            return []
        if message is None:
            return []
        self._withheld, self._refused = None, NoFix(NO_PLACES)
        # Poses alone are for set 2: while GPS is its source, they would move what its filter has for them.
        if message.moment == "pose" and not self.sources.is_without_gps:
            known = self._drive.state
            # One that is ignored counts again only once it is consistent.
            self.sources.want(SET_WITHOUT_GPS, known.gps.state if known.ignores_gps else LOST)
            self._judged_ns = None  # this one waits for it: there may be none after it
            self._hole_ns = now_ns
            return []
        hole_s = min(self._since_s(now_ns), (now_ns - self._hole_ns) / 1e9)
        is_wide = (answer.pose_sigma_m or 0.0) > message.widest_m and hole_s < HOLE_S
        return [] if is_wide else self._encode(answer, now_ns, message)

    def _period_s(self, message: PositionMessage) -> float:
        return self._gates.min_interval_s if message.period_s is None else message.period_s

    def _since_s(self, now_ns: int) -> float:
        """Seconds since the newest position was sent; endless before the first."""
        newest = self.use.newest
        return math.inf if newest is None else (now_ns - newest.at_ns) / 1e9

    def why_none(self, now_ns: int) -> str:
        """Why no position has been sent for a while, for people; "" where one has been."""
        if self.message is None:
            return self.why
        if self.use.command.is_refused:
            return "the autopilot refuses positions"
        return "" if self._since_s(now_ns) < SENT_S else str(self._refused)

    def _withhold(self, refused: NoFix) -> None:
        fix, before = refused.fix, self._withheld
        self._refused = refused
        if fix is not None and (before is None or str(refused) != before.reason):
            self._withheld = FixWithheld(fix.place, str(refused), refused.distance_m, fix.map)
            self._publisher.record(self._withheld)

    def _encode(self, fix: Fix, now_ns: int, message: PositionMessage) -> list[Message]:
        """Encode a fix that may be sent, and keep what is needed to follow it up."""
        vehicle, place = self._vehicle, self._moved_on(fix, now_ns)
        boot_s, own, newest = vehicle.boot_time_s(now_ns), vehicle.position(now_ns), self.use.newest
        origin = vehicle.session.origin
        if place is None or boot_s is None or (message.moment == "pose" and (own is None or origin is None)):
            return []
        recorded_ns = newest.recorded_ns if newest else 0
        is_recorded = message.acknowledged or now_ns - recorded_ns >= STEADY_RECORD_NS
        distance_m = None if own is None else distance_from(own, fix.place)
        sent = FixTransmission(fix, now_ns, distance_m, now_ns if is_recorded else recorded_ns)
        session, sensor_id, unused = vehicle.session, self._telemetry.sensor_id, ""
        if not message.acknowledged:
            unused = session.firmware.unused_because(session.parameters, message.name, sensor_id, session.kind)
        self._drive.update(now_ns, FixFeedback(fix))
        self.use.expect(sent, is_reset=message.acknowledged, unused=unused)
        age_s, alt_m = (now_ns - place.stamp_ns) / 1e9, 0.0 if own is None else own.alt_m
        sending = MessageContext(vehicle.target_id, boot_s, age_s, sensor_id, origin, alt_m)
        values: list[Message] = []
        if is_recorded:
            self._record(sent, message, sending)
            values = encoders.protection_values(fix.level, round(1000 * boot_s))
        if not (message.acknowledged or vehicle.velocity.aid.is_any or fix.pose_sigma_m):
            place = self._one_of_many(place, now_ns, self._period_s(message))
        resets = [] if message.acknowledged else self._reset_from_gps(sent, sending)
        return [*resets, message.encode(place, sending), *values]

    def _moved_on(self, fix: Fix, now_ns: int) -> PlaceFix | None:
        """A keypoint pose as a measurement of now, by the vehicle's motion since; None where that is not known.

        Without the error of the map, which is alike for all of them: the autopilot follows the map.
        """
        place, then, now = fix.place, fix.motion, self._vehicle.motion.displacement(now_ns)
        if fix.pose_sigma_m is None:
            return place
        if then is None or now is None or now.odometry_epoch != then.odometry_epoch:
            return None
        assert place.lat_deg is not None and place.lon_deg is not None
        lat_deg, lon_deg = moved(place.lat_deg, place.lon_deg, *now.since(then))
        each_m = fix.pose_sigma_m / math.sqrt(2)
        return replace(place, lat_deg=lat_deg, lon_deg=lon_deg, sigma_along_m=each_m, sigma_cross_track_m=each_m)

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
            self._is_led &= sent.is_far
        if not self._is_led:
            return []
        self._reset_ns, message = sent.at_ns, POSITION_MESSAGES["external_position"]
        self._record(sent, message, sending)
        return [message.encode(sent.place, sending)]

    def _record(self, sent: FixTransmission, message: PositionMessage, sending: MessageContext) -> None:
        fix = sent.place
        self._publisher.record(
            FixSent(
                fix.place,
                message.name,
                fix.lat_deg or 0.0,
                fix.lon_deg or 0.0,
                fix.sigma_m,
                sending.boot_s,
                sending.age_s,
                sent.distance_m,
                fix.map,
                *level_m(sent.fix.level),
                fix.points,
                fix.sigma_along_m,
                UNSET if sent.fix.pose_sigma_m is None else sent.fix.pose_sigma_m,
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

    def follow_up(self, now_ns: int, *, all_came: bool) -> list[Message]:
        """To be called often: select sources, check what was accepted. all_came: no further parameter will."""
        if self._telemetry.emit == "auto":
            self._choose(all_came=all_came)
        self._choose_sources(works=self._vehicle.session.gps.receiver_state(now_ns) == "healthy")
        messages = [] if self.sources.wanted is None else self.sources.due(now_ns)
        self.use.check_answer(now_ns)
        return [*messages, *self._keep_up(now_ns), *self._stop_if_misled(now_ns)]

    def _stop_if_misled(self, now_ns: int) -> list[Message]:
        """Stop a vehicle that steers itself while GPS is wrong and no place says where it is; or have the pilot do so.

        By [gates] misled, and only one on the ground: others cannot just stop.
        """
        vehicle, state = self._vehicle, self._drive.state.gps.state
        is_misled = state in MISLED and bool(vehicle.drives_itself) and self._since_s(now_ns) > SENT_S
        if not is_misled:
            self._misled_ns = now_ns
            return []
        if now_ns - max(self._misled_ns, self._stopped_ns) < STOP_NS:
            return []
        self._stopped_ns, session = now_ns, vehicle.session
        may_stop = self._gates.misled == "hold" and self.enabled and session.kind in ON_THE_GROUND
        stops = may_stop and bool(session.firmware.hold)
        self._publisher.record(VehicleMisled(state, stops))
        self._publisher.warn(f"Lookback: GPS {state}, no place: {'stopping' if stops else 'stop now'}")
        return [encoders.set_mode(vehicle.target_id, session.firmware.hold)] if stops else []

    def _keep_up(self, now_ns: int) -> list[Message]:
        """What keeps an autopilot that fuses poses from calling their sensor unhealthy where none come."""
        boot_s = self._vehicle.boot_time_s(now_ns)
        is_due = self.message is not None and self.message.moment == "pose" and now_ns - self._kept_up_ns >= KEEP_UP_NS
        if boot_s is None or not is_due:
            return []
        self._kept_up_ns = now_ns
        return [encoders.no_vision_position(boot_s)]

    def _choose_sources(self, *, works: bool) -> None:
        """Without GPS where it is ignored and positions are sent in its place; with it once it is consistent again.

        One that was only lost counts again once it works, and nothing speaks against it. Of one that was taken away
        before a crash of this program, nobody knows why.
        """
        known, sources = self._drive.state, self.sources
        if known.ignores_gps:
            if self.selects_sources and self._vehicle.session.firmware.gps_switch:
                sources.want(SET_WITHOUT_GPS, known.gps.state)
        elif works and (known.gps.state == "consistent" or not (sources.is_doubted or known.gps.state in DOUBTED)):
            sources.want(GPS_SET, "works")


def level_m(level: ProtectionLevel | None) -> tuple[float | None, float | None]:
    """Meters along-track and cross-track for people, None where nothing bounds them."""
    if level is None or not math.isfinite(level.along_track_m + level.cross_track_m):
        return None, None
    return round(level.along_track_m, 2), round(level.cross_track_m, 2)
