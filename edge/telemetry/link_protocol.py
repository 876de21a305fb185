"""The heartbeats and requests that a MAVLink component sends: time, streams, version, origin. No I/O.

Everything is requested again after a reboot of the autopilot and after a silence, since the autopilot does not store
requests.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from edge.config import TelemetryConfig
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.vehicle import Origin, Vehicle

HEARTBEAT_NS = 1_000_000_000
TIMESYNC_NS = 500_000_000
AGAIN_NS = 5_000_000_000
STREAMS_HZ = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 5.0,
    mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE: 5.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
}
"""ODOMETRY is read where the autopilot sends it, but not requested: it is long, and adds nothing to these."""
FIRST_SYSTEM_ID = 1  # the default of autopilots, until the vehicle's own is known


class LinkProtocol:
    """Which messages are due on the autopilot's link."""

    def __init__(self, config: TelemetryConfig, vehicle: Vehicle) -> None:
        self._origin = Origin(*config.origin) if config.origin else None
        self._vehicle = vehicle
        self._due_ns = dict.fromkeys(("heartbeat", "timesync", "streams", "version", "origin"), 0)
        self._origin_requested = False

    def opened(self, now_ns: int) -> None:
        """The port is open: send a heartbeat at once."""
        self._due_ns.update(heartbeat=now_ns, timesync=now_ns)

    def new_session(self) -> None:
        """The autopilot is another one, or has rebooted: request everything."""
        self._due_ns.update(streams=0, version=0, origin=0)
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
        silent = vehicle.speed_mps(now_ns) is None or self._due_ns["streams"] == 0
        if silent and self._is_due("streams", now_ns, AGAIN_NS):
            messages += [encoders.stream_request(system_id, message_id, hz) for message_id, hz in STREAMS_HZ.items()]
        if vehicle.version is None and self._is_due("version", now_ns, AGAIN_NS):
            messages.append(encoders.message_request(system_id, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION))
        if vehicle.origin is None and self._is_due("origin", now_ns, AGAIN_NS):
            messages += self._request_origin(system_id)
        return messages

    def answer(self, message: Message, now_ns: int) -> list[Message]:
        """The answers to a message of the autopilot."""
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
