"""Messages of one component, and a vehicle that has heard its heartbeats."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.vehicle import Vehicle
from tests.common import S


class Speaker:
    """Messages of one component."""

    def __init__(self, system_id: int = 1, component_id: int = 1) -> None:
        self._out, self._in = MavlinkCodec(system_id, component_id), MavlinkCodec(1, 191)

    def say(self, message: Any) -> Any:
        return self._in.decode(self._out.encode(message))[0]

    def heartbeat(self, autopilot: int = mavlink.MAV_AUTOPILOT_PX4) -> Any:
        return self.say(mavlink.MAVLink_heartbeat_message(10, autopilot, 0, 0, 4, 3))

    def position(self, boot_ms: int, speed_mps: float = 0.0) -> Any:
        return self.say(
            mavlink.MAVLink_global_position_int_message(boot_ms, 1, 1, 0, 0, round(speed_mps * 100), 0, 0, 65535)
        )

    def fix(self, boot_ms: int, north_m: float, vn_mps: float, ve_mps: float) -> Any:
        lat = round((-27.0 + north_m / 110_773) * 1e7)
        velocity = round(vn_mps * 100), round(ve_mps * 100), 0
        return self.say(mavlink.MAVLink_global_position_int_message(boot_ms, lat, 1530000000, 0, 0, *velocity, 0))


def connect(speaker: Speaker, now_ns: int = 0) -> Vehicle:
    vehicle = Vehicle()
    for beat in (0, 1):
        vehicle.handle(speaker.heartbeat(), now_ns + beat * S)
    assert vehicle.connected
    return vehicle
