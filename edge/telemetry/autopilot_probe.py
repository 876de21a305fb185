"""A look at the autopilot for `lookback doctor`: who it is, what it reports, and how its parameters are set.

Sets nothing: it sends heartbeats, asks for streams as the daemon would, and reads parameters one by one.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
from pymavlink.dialects.v20 import common as mavlink

from edge.config import LinkConfig, TelemetryConfig
from edge.telemetry.autopilot import open_port
from edge.telemetry.codec import Message
from edge.telemetry.link_protocol import FIRST_SYSTEM_ID, LinkProtocol
from edge.telemetry.vehicle import Vehicle

ASK_AGAIN_NS = 700_000_000
TURN_S = 0.01
ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
PX4_INTEGERS = {mavlink.MAV_PARAM_TYPE_INT32: "<i", mavlink.MAV_PARAM_TYPE_UINT32: "<I"}


@dataclass(frozen=True)
class Wanted:
    """A parameter that a way of telling positions needs; `bits` must be set, or the value be one of `values`."""

    autopilot: int
    way: str
    name: str
    why: str
    values: tuple[int, ...] = ()
    bits: int = 0

    def holds(self, value: float) -> bool:
        """Whether a value will do."""
        return round(value) & self.bits == self.bits if self.bits else round(value) in self.values

    @property
    def remedy(self) -> str:
        """What to do about a value that will not do."""
        return f"set its bits {self.bits}" if self.bits else f"set it to {' or '.join(map(str, self.values))}"


WANTED = (
    Wanted(ARDUPILOT, "external_position", "AHRS_EKF_TYPE", "place fixes go to EKF3 alone", values=(3,)),
    Wanted(
        ARDUPILOT,
        "external_position",
        "AHRS_OPTIONS",
        "else a rover or plane without GPS falls back to DCM: it says ACCEPTED, and its position does not move",
        bits=3,
    ),
    Wanted(ARDUPILOT, "vision_position", "VISO_TYPE", "else vision positions are not listened to", values=(1,)),
    Wanted(ARDUPILOT, "vision_position", "EK3_SRC2_POSXY", "the second source set takes vision positions", values=(6,)),
    Wanted(PX4, "global_position_sensor", "EKF2_AGP0_CTRL", "else message 296 is not fused", bits=1),
)


@dataclass
class AutopilotProbe:
    """What was found. parameters: by name, None for one that was asked for and did not come."""

    why_closed: str = ""
    connected: bool = False
    system_id: int | None = None
    autopilot: int | None = None
    version: tuple[int, int] | None = None
    gps_healthy: bool = False
    speed_known: bool = False
    position_known: bool = False
    parameters: dict[str, float | None] = field(default_factory=dict)


def probe_autopilot(
    config: TelemetryConfig,
    names: Callable[[int | None, tuple[int, int] | None], list[str]],
    seconds: float,
    clock_ns: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], object] = time.sleep,
) -> AutopilotProbe:
    """Listen until all is known, at most `seconds`. `names` are the parameters to read, given autopilot and version.

    ConfigError for a malformed connection, or a key that cannot be used.
    """
    vehicle, found = Vehicle(), AutopilotProbe()
    port = open_port(config, LinkConfig(config.connection, config.signing_key), 0, clock_ns)
    manners = LinkProtocol(msgspec.structs.replace(config, origin=()), vehicle)
    asked_ns = 0
    end_ns = clock_ns() + seconds * 1e9
    try:
        while clock_ns() < end_ns and not _is_complete(found):
            now_ns = clock_ns()
            if port.open_if_due(now_ns):
                for message in manners.heartbeat(mavlink.MAV_STATE_STANDBY, now_ns):
                    port.send(message)
                for message in port.receive():
                    if vehicle.handle(message, now_ns):
                        _read_parameter(message, found)
                _note(vehicle, found, now_ns)
                if vehicle.version is not None and not found.parameters:
                    found.parameters = dict.fromkeys(names(vehicle.autopilot, vehicle.version))
                    asked_ns = 0
                if vehicle.connected and now_ns - asked_ns > ASK_AGAIN_NS:
                    asked_ns = now_ns
                    for message in (*manners.requests(now_ns), *_missing(found)):
                        port.send(message)
            found.why_closed = port.why_closed
            sleep(TURN_S)
    finally:
        port.close()
    return found


def _is_complete(found: AutopilotProbe) -> bool:
    known = found.version is not None and found.speed_known and found.position_known
    return known and found.gps_healthy and None not in found.parameters.values()


def _note(vehicle: Vehicle, found: AutopilotProbe, now_ns: int) -> None:
    found.connected, found.system_id = vehicle.connected, vehicle.system_id
    found.autopilot, found.version = vehicle.autopilot, vehicle.version
    found.gps_healthy = vehicle.gps_healthy(now_ns)
    found.speed_known = vehicle.speed_mps(now_ns) is not None
    found.position_known = vehicle.position(now_ns) is not None


def _missing(found: AutopilotProbe) -> list[Message]:
    """PARAM_REQUEST_READ for each parameter that has not come yet."""
    return [
        mavlink.MAVLink_param_request_read_message(
            found.system_id or FIRST_SYSTEM_ID, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1
        )
        for name, value in found.parameters.items()
        if value is None
    ]


def _read_parameter(message: Message, found: AutopilotProbe) -> None:
    if message.get_msgId() != mavlink.MAVLINK_MSG_ID_PARAM_VALUE:
        return
    name, value = str(message.param_id).rstrip("\0"), float(message.param_value)
    layout = PX4_INTEGERS.get(message.param_type)
    if found.autopilot == PX4 and layout:
        # PX4 puts the bytes of an integer where the float goes; ArduPilot converts.
        value = float(struct.unpack(layout, struct.pack("<f", value))[0])
    if name in found.parameters:
        found.parameters[name] = value
