"""What is requested of an autopilot: its time, streams, parameters, version and origin; and our time for it. No I/O.

Everything is requested again in the next session and after a silence, since the autopilot does not store requests.
Streams are requested one by one, since an acknowledgement does not say which stream it is for.

And what measures its velocity without GPS.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.backoff import BackOff, Exchange
from edge.config import TelemetryConfig
from edge.localization import PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import FusionStatus, Message
from edge.telemetry.encoders import POSITION_MESSAGES
from edge.telemetry.firmware import AIRSPEED, NO_AID, VISION
from edge.telemetry.people import Publisher
from edge.telemetry.session import Origin, Session
from edge.telemetry.vehicle import Vehicle
from edge.telemetry.vehicle_velocity import Aid
from edge.telemetry.wheel_store import WHEEL_RADIUS

TIMESYNC_NS = 500_000_000
AGAIN_NS = 5_000_000_000
STREAMS_HZ = {
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 4.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: 4.0,
    mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE: 5.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: 20.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
}
"""In the order in which they are requested."""
ATTITUDE_HZ = 20.0  # for [motion] only: the body pitches at 2.5 Hz on an uneven road
STREAM_SILENT_NS = 3_000_000_000
REQUEST_ANSWER_NS = 500_000_001  # more than half a second
AGAIN_LAST_NS = 60_000_000_000
PARAMETER_NS, TRIES_MOST = 200_000_000, 5
REFUSALS_MOST = 2
"""After so many a stream is requested no more: no firmware knows all of them. One may be an answer that came late."""
ON_WINGS = {mavlink.MAV_TYPE_FIXED_WING, *range(mavlink.MAV_TYPE_VTOL_DUOROTOR, mavlink.MAV_TYPE_VTOL_RESERVED5 + 1)}
CAMERA_SILENT_NS = 1_000_000_000
"""Without a message for so long, nothing measures the velocity: PX4 stops fusing after that time as well."""


class StreamRequests:
    """Requests the streams of one session, one at a time: each once, and again while it is silent."""

    def __init__(self, session: Session, streams_hz: Mapping[int, float] = STREAMS_HZ) -> None:
        self._session, self._streams_hz = session, streams_hz
        self._all = {
            message_id: Exchange(REQUEST_ANSWER_NS, BackOff(AGAIN_NS, AGAIN_LAST_NS), refusals_most=REFUSALS_MOST)
            for message_id in streams_hz
        }
        self._newest = Exchange(REQUEST_ANSWER_NS)

    def due(self, system_id: int, now_ns: int) -> list[Message]:
        """The next request, unless one is waiting for its answer."""
        if not self._newest.is_waiting or self._newest.is_overdue(now_ns):
            for message_id, one in self._all.items():
                heard_ns = self._session.heard_ns.get(message_id)
                is_heard = heard_ns is not None and now_ns - heard_ns <= STREAM_SILENT_NS
                if is_heard:
                    one.pause.reset()
                if (is_heard and not one.times) or (not is_heard and one.is_due(now_ns)):
                    self._newest = one
                    one.ask(now_ns)
                    one.pause.failed(now_ns)
                    return [encoders.stream_request(system_id, message_id, self._streams_hz[message_id])]
        return []

    def read_acknowledgement(self, result: int) -> None:
        """COMMAND_ACK of a stream request: any refusal counts, since firmware differs in how it refuses."""
        if self._newest.is_waiting:
            self._newest.refusals += result != mavlink.MAV_RESULT_ACCEPTED
            self._newest.answered()


class ParameterRequests:
    """Requests parameters one by one, and again while one is missing."""

    def __init__(self, session: Session, names: Iterable[str] = ()) -> None:
        self._session = session
        self._all: dict[str, Exchange] = {}
        self._newest = ""
        self.add(names)

    def add(self, names: Iterable[str]) -> None:
        """Request these as well."""
        for name in names:
            self._all.setdefault(name, Exchange(PARAMETER_NS, most=TRIES_MOST))

    def due(self, system_id: int, now_ns: int) -> list[Message]:
        """The next request, once the last is answered or overdue; none where all came or were requested too often."""
        missing = self._missing()
        name = min(missing, key=lambda name: missing[name].times, default="")
        is_waiting = self._newest in missing and not missing[self._newest].is_overdue(now_ns)
        if not name or is_waiting or not missing[name].is_due(now_ns):
            return []
        self._newest = name
        missing[name].ask(now_ns)
        return [encoders.parameter_request(system_id, name)]

    def are_over(self, now_ns: int) -> bool:
        """Whether those that have not come have been requested too often, and the last answer would be here."""
        return all(one.is_given_up and one.is_overdue(now_ns, REQUEST_ANSWER_NS) for one in self._missing().values())

    def _missing(self) -> dict[str, Exchange]:
        return {name: one for name, one in self._all.items() if name not in self._session.parameters}


class Requests:
    """What is requested of an autopilot in one session, and answered."""

    def __init__(self, config: TelemetryConfig, vehicle: Vehicle, *, asks_attitude: bool = False) -> None:
        self._vehicle, self.session, self.asks_attitude = vehicle, vehicle.session, asks_attitude
        firmware = self.session.firmware
        attitude_hz = {mavlink.MAVLINK_MSG_ID_ATTITUDE: ATTITUDE_HZ} if asks_attitude else {}
        fusion_hz = {FusionStatus.id: 2.0} if firmware.gps_switch == "fusion" else {}
        self._streams = StreamRequests(vehicle.session, STREAMS_HZ | attitude_hz | fusion_hz)
        # What aids the velocity, and whether positions are used, matters only where some are sent.
        may_be = {str(config.emit), *(message for _, message in firmware.takes)}
        sent = [name for name in firmware.needs if name in may_be and not POSITION_MESSAGES[name].acknowledged]
        names = *firmware.aid_parameters, *(one.parameter for name in sent for one in firmware.needs[name])
        self.parameters = ParameterRequests(vehicle.session, names if config.emit != "report" else ())
        self.parameters.add({WHEEL_RADIUS} if "WENC_TYPE" in firmware.aid_parameters else ())
        self._origin = Origin(*config.origin) if config.origin else None
        self.needs_place = self._origin is not None and firmware.stands_at_origin
        """Whether no origin is set before a place is believed."""
        self._timesync, self._version, self._known_origin = map(Exchange, (TIMESYNC_NS, AGAIN_NS, AGAIN_NS))

    def due(self, now_ns: int) -> list[Message]:
        """The requests that are due."""
        session, system_id = self.session, self._vehicle.target_id
        messages: list[Message] = []
        if self._timesync.is_due(now_ns):
            self._timesync.ask(now_ns)
            session.clock.requested(now_ns)
            messages.append(encoders.timesync_request(now_ns))
        messages += self._streams.due(system_id, now_ns)
        messages += self.parameters.due(system_id, now_ns)
        if session.version is None and self._version.is_due(now_ns):
            self._version.ask(now_ns)
            messages.append(encoders.message_request(system_id, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION))
        if session.origin is None and self._known_origin.is_due(now_ns):
            # Set ours only where the autopilot reports none: an origin cannot be moved in flight.
            if self._known_origin.times and self._origin is not None and not self.needs_place:
                messages.append(encoders.set_origin(system_id, self._origin))
            self._known_origin.ask(now_ns)
            messages.append(encoders.message_request(system_id, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN))
        return messages

    def believe(self, place: PlaceFix) -> None:
        """The vehicle is at a place: an autopilot that takes its origin for where it is gets that which is right."""
        if self.needs_place and self._origin is not None and place.lat_deg is not None and place.lon_deg is not None:
            self.needs_place = False
            self._origin = self.session.origin_of_place(place.lat_deg, place.lon_deg, self._origin.alt_m)

    @property
    def waits_for_place(self) -> bool:
        """Whether an origin would have been set by now."""
        return self.needs_place and self.session.origin is None and self._known_origin.times > 1

    def answer(self, message: Message, now_ns: int) -> list[Message]:
        """The answers to a message of the autopilot that is for us."""
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
            if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                self._streams.read_acknowledgement(message.result)
            return []
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            return [encoders.timesync_answer(message, now_ns)]
        return []


class VelocityAid:
    """What measures the autopilot's velocity besides our positions: a sensor of its own, or our camera."""

    def __init__(self, vehicle: Vehicle, publisher: Publisher, *, sends: bool) -> None:
        """sends: what the camera measures, by [motion] use and [telemetry] emit."""
        self._vehicle, self._publisher, self.sends = vehicle, publisher, sends
        self.without_gps: str | None = None
        """See `velocity_aid`."""
        self.sent_ns: int | None = None
        """When a velocity of the camera was last sent."""
        self._warned: Session | None = None

    def is_known(self, now_ns: int) -> bool:
        """Whether anything besides GPS does; the camera of ours only while it sees the road."""
        is_silent = self.sends and (self.sent_ns is None or now_ns - self.sent_ns > CAMERA_SILENT_NS)
        return self.without_gps not in (None, NO_AID) and not (self.without_gps == VISION and is_silent)

    def update(self, source_set: int, now_ns: int, *, is_by_gps: bool, may_be_gps: bool, is_needed: bool) -> Aid:
        """What does now. is_by_gps: GPS does, and is not ignored; may_be_gps: it may have a part in it.

        is_needed: positions are sent, which could come back; where none are, parameters are not requested.
        """
        self.without_gps = velocity_aid(self._vehicle, source_set)
        is_any = is_by_gps or not is_needed or self.is_known(now_ns)
        is_camera = not is_by_gps and self.sends and self.without_gps == VISION
        is_drifting_camera = is_camera and self._vehicle.session.firmware.camera_drifts
        return Aid(is_any, is_drifting_camera, may_be_gps)

    def warn_without(self, *, all_came: bool) -> None:
        """Once in a session, where none is known. all_came: whether no further parameter will."""
        if self._warned is self._vehicle.session or not (self.without_gps == NO_AID or all_came):
            return
        if self.without_gps in (None, NO_AID):
            self._warned = self._vehicle.session
            is_known = self.without_gps == NO_AID
            words = "the autopilot has no velocity aid" if is_known else "velocity aid not known, assuming none"
            self._publisher.warn(f"Lookback: {words}")


def velocity_aid(vehicle: Vehicle, source_set: int) -> str | None:
    """What measures the velocity when GPS is gone, by the autopilot's parameters: an aid, or `NO_AID`; None: not known.

    source_set: of ArduPilot's sets, that without GPS. Without an aid an estimator loses its position within seconds,
    and a position that we send comes back as its velocity: the two agree with each other and not with the truth. The
    estimator's flags do not show it, since they return while our position is fused.
    """
    session = vehicle.session
    if session.kind in ON_WINGS:
        return AIRSPEED
    return session.firmware.aid(session.parameters, session.heard_ns, source_set)
