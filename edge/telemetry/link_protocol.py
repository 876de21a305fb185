"""What a MAVLink component sends besides positions: heartbeats, requests (time, streams, parameters), lines. No I/O.

Everything is requested again after a reboot of the autopilot and after a silence, since the autopilot does not store
requests. Streams are requested one by one, since an acknowledgement does not say which stream it is for.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from edge.backoff import BackOff
from edge.config import TelemetryConfig
from edge.journal.records import Record
from edge.localization import PlaceFix
from edge.telemetry import encoders, stream_check
from edge.telemetry.codec import EkfStatusReport, Message
from edge.telemetry.confirmation import Origin
from edge.telemetry.vehicle import Vehicle

HEARTBEAT_NS = 1_000_000_000
TIMESYNC_NS = 500_000_000
AGAIN_NS = 5_000_000_000
STREAMS_HZ = {
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 4.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    EkfStatusReport.id: 2.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: 4.0,
    mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE: 5.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
}
"""In the order in which they are requested.

ODOMETRY is read where the autopilot sends it, but not requested: it is long, and adds nothing to these.
"""
ATTITUDE_HZ = 20.0  # for [motion] only: the body pitches at 2.5 Hz on an uneven road
TEXT_NS = 500_000_000
PLACE_NS = 5_000_000_000
QUEUE_LINES = 8
SILENT_NS = 3_000_000_000
ANSWER_NS = 500_000_000
AGAIN_LAST_NS = 60_000_000_000
PARAMETER_NS, TRIES_MOST = 200_000_000, 5
REFUSALS_MOST = 2
"""After so many a stream is requested no more: no firmware knows all of them. One may be an answer that came late."""
ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
AID_PARAMETERS: dict[int, tuple[str, ...]] = {
    ARDUPILOT: ("EK3_SRC1_VELXY", "EK3_SRC2_VELXY", "WENC_TYPE", "FLOW_TYPE"),
    PX4: ("EKF2_EV_CTRL", "EKF2_OF_CTRL", "EKF2_OF0_CTRL"),
}
ON_WINGS = {mavlink.MAV_TYPE_FIXED_WING, *range(mavlink.MAV_TYPE_VTOL_DUOROTOR, mavlink.MAV_TYPE_VTOL_RESERVED5 + 1)}
AIRSPEED, WHEELS, FLOW, VISION, BEACONS = "airspeed and wind", "wheel encoders", "optical flow", "vision", "beacons"
NO_AID = "none"
EV_VELOCITY = 1 << 2  # of EKF2_EV_CTRL
FIRST_SYSTEM_ID = 1  # the default of autopilots, until the vehicle's own is known


class StreamRequests:
    """Requests the streams of one session, one at a time: each once, and again while it is silent."""

    def __init__(self, streams_hz: Mapping[int, float] = STREAMS_HZ) -> None:
        self._streams_hz = streams_hz
        self._back_offs = {message_id: BackOff(AGAIN_NS, AGAIN_LAST_NS) for message_id in streams_hz}
        self._requested: set[int] = set()
        self._refusals: Counter[int] = Counter()
        self._asked: tuple[int, int] | None = None  # which message, and when

    def due(self, vehicle: Vehicle, system_id: int, now_ns: int) -> list[Message]:
        """The next request, unless one is waiting for its answer."""
        if self._asked is not None and now_ns - self._asked[1] <= ANSWER_NS:
            return []
        for message_id, back_off in self._back_offs.items():
            if self._is_due(message_id, back_off, vehicle.heard_ns(message_id), now_ns):
                self._asked = message_id, now_ns
                self._requested.add(message_id)
                back_off.failed(now_ns)
                return [encoders.stream_request(system_id, message_id, self._streams_hz[message_id])]
        return []

    def _is_due(self, message_id: int, back_off: BackOff, heard_ns: int | None, now_ns: int) -> bool:
        if heard_ns is not None and now_ns - heard_ns <= SILENT_NS:
            back_off.reset()
            return message_id not in self._requested
        return self._refusals[message_id] < REFUSALS_MOST and back_off.is_over(now_ns)

    def read_acknowledgement(self, result: int) -> None:
        """COMMAND_ACK of a stream request: any refusal counts, since firmware differs in how it refuses."""
        if self._asked is not None:
            self._refusals[self._asked[0]] += result != mavlink.MAV_RESULT_ACCEPTED
            self._asked = None


class ParameterRequests:
    """Requests parameters one by one, and again while one is missing."""

    def __init__(self, names: Iterable[str] = ()) -> None:
        self._tries = dict.fromkeys(names, 0)
        self._due_ns = 0

    def add(self, names: Iterable[str]) -> None:
        """Request these as well."""
        for name in names:
            self._tries.setdefault(name, 0)

    def due(self, vehicle: Vehicle, system_id: int, now_ns: int) -> list[Message]:
        """The next request; none where all have come, or have been requested too often."""
        missing = self._missing(vehicle)
        name = min(missing, key=missing.__getitem__, default="")
        if not name or missing[name] >= TRIES_MOST or now_ns < self._due_ns:
            return []
        self._tries[name] += 1
        self._due_ns = now_ns + PARAMETER_NS
        return [encoders.parameter_request(system_id, name)]

    def are_over(self, vehicle: Vehicle, now_ns: int) -> bool:
        """Whether those that have not come have been requested too often, and the last answer would be here."""
        tries = self._missing(vehicle).values()
        return min(tries, default=TRIES_MOST) >= TRIES_MOST and now_ns - self._due_ns > ANSWER_NS

    def _missing(self, vehicle: Vehicle) -> dict[str, int]:
        """How often each that has not come was requested."""
        return {name: tries for name, tries in self._tries.items() if name not in vehicle.parameters}


class LinkProtocol:
    """Which messages are due on the autopilot's link."""

    def __init__(self, config: TelemetryConfig, vehicle: Vehicle, *, asks_attitude: bool = False) -> None:
        self._streams_hz = STREAMS_HZ | ({mavlink.MAVLINK_MSG_ID_ATTITUDE: ATTITUDE_HZ} if asks_attitude else {})
        self._origin = Origin(*config.origin) if config.origin else None
        self._vehicle = vehicle
        self._due_ns = dict.fromkeys(("heartbeat", "timesync", "version", "origin"), 0)
        self._streams, self.parameters = StreamRequests(self._streams_hz), ParameterRequests()
        self._moves = config.emit != "report"
        self._origin_requested = False

    def opened(self, now_ns: int) -> None:
        """The port is open: send a heartbeat at once."""
        self._due_ns.update(heartbeat=now_ns, timesync=now_ns)

    def new_session(self) -> None:
        """The autopilot is another one, or has rebooted: request everything."""
        self._due_ns.update(version=0, origin=0)
        self._streams = StreamRequests(self._streams_hz)
        # What aids the velocity, and whether positions are used, matters only where some are sent.
        autopilot = self._vehicle.autopilot or 0
        names = *AID_PARAMETERS.get(autopilot, ()), *stream_check.PARAMETERS.get(autopilot, ())
        self.parameters = ParameterRequests(names if self._moves else ())
        self._origin_requested = False

    def heartbeat(self, system_status: int, now_ns: int) -> list[Message]:
        """Once a second, whether there is a peer or not."""
        return [encoders.heartbeat(system_status)] if self._is_due("heartbeat", now_ns, HEARTBEAT_NS) else []

    def requests(self, now_ns: int) -> list[Message]:
        """The requests that are due to a connected autopilot."""
        vehicle, system_id = self._vehicle, self._vehicle.system_id or FIRST_SYSTEM_ID
        messages: list[Message] = []
        if self._is_due("timesync", now_ns, TIMESYNC_NS):
            vehicle.timesync_sent(now_ns)
            messages.append(encoders.timesync_request(now_ns))
        messages += self._streams.due(vehicle, system_id, now_ns)
        messages += self.parameters.due(vehicle, system_id, now_ns)
        if vehicle.version is None and self._is_due("version", now_ns, AGAIN_NS):
            messages.append(encoders.message_request(system_id, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION))
        if vehicle.origin is None and self._is_due("origin", now_ns, AGAIN_NS):
            messages += self._request_origin(system_id)
        return messages

    def answer(self, message: Message, now_ns: int) -> list[Message]:
        """The answers to a message of the autopilot that is for us."""
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
            if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                self._streams.read_acknowledgement(message.result)
            return []
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            return [encoders.timesync_answer(message, now_ns)]
        return []

    def _request_origin(self, system_id: int) -> list[Message]:
        """Request it first, and set ours only where the autopilot reports none: an origin cannot be moved in flight."""
        requested, self._origin_requested = self._origin_requested, True
        messages = [encoders.message_request(system_id, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)]
        if requested and self._origin is not None:
            messages.insert(0, encoders.set_origin(system_id, self._origin))
        return messages

    def _is_due(self, what: str, now_ns: int, period_ns: int) -> bool:
        if now_ns < self._due_ns[what]:
            return False
        self._due_ns[what] = now_ns + period_ns
        return True


@dataclass(frozen=True)
class Publisher:
    """Where what happens is published: a record in the journal, a warning to the pilot."""

    record: Callable[[Record], object]
    warn: Callable[[str], object]


class StatusTexts:
    """A queue of lines for the pilot: at most two a second come out, and of many only the newest.

    A slow link carries the pilot's telemetry as well.
    """

    def __init__(self) -> None:
        self._queue: deque[list[Message]] = deque(maxlen=QUEUE_LINES)
        self._next_ns = 0
        self._next_place_ns = 0

    def put(self, text: str, severity: int) -> None:
        """Queue a line of any length."""
        self._queue.append(encoders.status_text(text, severity))

    def put_place(self, fix: PlaceFix, now_ns: int) -> None:
        """Queue a line about a place, but not more than one each five seconds: places come by the second."""
        if now_ns >= self._next_place_ns:
            self._next_place_ns = now_ns + PLACE_NS
            self.put(encoders.describe(fix), mavlink.MAV_SEVERITY_INFO)

    def due(self, now_ns: int) -> list[Message]:
        """The messages of the next line, if it is time for one."""
        if not self._queue or now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + TEXT_NS
        return self._queue.popleft()


def velocity_aid(vehicle: Vehicle, source_set: int) -> str | None:
    """What measures the velocity when GPS is gone, by the autopilot's parameters: an aid, or `NO_AID`; None: not known.

    source_set: of ArduPilot's sets, that without GPS. Without an aid an estimator loses its position within seconds,
    and a position that we send comes back as its velocity: the two agree with each other and not with the truth. The
    estimator's flags do not show it, since they return while our position is fused.
    """
    if vehicle.kind in ON_WINGS:
        return AIRSPEED
    if vehicle.autopilot == ARDUPILOT:
        return _ardupilot(vehicle, source_set)
    return _px4(vehicle) if vehicle.autopilot == PX4 else None


def _ardupilot(vehicle: Vehicle, source_set: int) -> str | None:
    source = vehicle.parameters.get(f"EK3_SRC{source_set}_VELXY")
    if source is None:
        return None
    sensors = {5: ("FLOW_TYPE", FLOW), 7: ("WENC_TYPE", WHEELS)}
    if round(source) not in sensors:
        return {4: BEACONS, 6: VISION}.get(round(source), NO_AID)
    parameter, aid = sensors[round(source)]
    kind = vehicle.parameters.get(parameter)
    return None if kind is None else aid if kind else NO_AID


def _px4(vehicle: Vehicle) -> str | None:
    """Flow is enabled by default, with or without a sensor, so that it has to be heard."""
    vision = vehicle.parameters.get("EKF2_EV_CTRL")
    if vision is None:
        return None
    if round(vision) & EV_VELOCITY:
        return VISION
    if vehicle.heard_ns(mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD) is None:
        return NO_AID
    controls = [vehicle.parameters.get(name) for name in ("EKF2_OF_CTRL", "EKF2_OF0_CTRL")]
    return FLOW if any(controls) else None if controls == [None, None] else NO_AID
