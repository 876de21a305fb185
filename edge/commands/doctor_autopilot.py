"""What `lookback doctor` finds out about the autopilot: whether it is heard, what it reports, how it is configured.

Sets nothing: it sends heartbeats, asks for streams as the daemon would, and reads parameters one by one.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import msgspec
from pymavlink.dialects.v20 import common as mavlink

from edge.commands.diagnostic import Diagnostic, bad, good, note
from edge.config import LinkConfig, TelemetryConfig
from edge.errors import LookbackError
from edge.localization import GpsState
from edge.telemetry.autopilot import open_port
from edge.telemetry.codec import Message
from edge.telemetry.link_protocol import FIRST_SYSTEM_ID, LinkProtocol
from edge.telemetry.position_messages import NAMES, suitable_message
from edge.telemetry.vehicle import Vehicle

ASK_AGAIN_NS = 700_000_000
TURN_S = 0.01
ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
PX4_INTEGERS = {mavlink.MAV_PARAM_TYPE_INT32: "<i", mavlink.MAV_PARAM_TYPE_UINT32: "<I"}
SERIAL = (
    "check the wires, the baud rate, and that the port speaks MAVLink 2 (ArduPilot: SERIALn_PROTOCOL 2); with signing,"
    " both ends need the same key"
)
NETWORK = (
    "check that a program sends MAVLink 2 to this address (mavlink-router, or MAVProxy with --out), that its computer"
    " is running, and that no firewall is between; with signing, both ends need the same key"
)


@dataclass(frozen=True)
class Requirement:
    """A parameter that a position message needs: `bits` must be set, or the value be one of `values`."""

    autopilot: int
    message: str
    parameter: str
    why: str
    values: tuple[int, ...] = ()
    bits: int = 0

    def is_met(self, value: float) -> bool:
        """Whether the parameter may have this value."""
        return round(value) & self.bits == self.bits if self.bits else round(value) in self.values

    @property
    def remedy(self) -> str:
        """What to do about a value that it must not have."""
        return f"set its bits {self.bits}" if self.bits else f"set it to {' or '.join(map(str, self.values))}"


REQUIREMENTS = (
    Requirement(ARDUPILOT, "external_position", "AHRS_EKF_TYPE", "only EKF3 uses positions sent to it", values=(3,)),
    Requirement(
        ARDUPILOT,
        "external_position",
        "AHRS_OPTIONS",
        "else a rover or plane without GPS falls back to DCM: it answers ACCEPTED, and its position does not move",
        bits=3,
    ),
    Requirement(ARDUPILOT, "vision_position", "VISO_TYPE", "else vision positions are ignored", values=(1,)),
    Requirement(
        ARDUPILOT, "vision_position", "EK3_SRC2_POSXY", "the second source set must use vision positions", values=(6,)
    ),
    Requirement(PX4, "global_position_sensor", "EKF2_AGP0_CTRL", "else message 296 is not fused", bits=1),
)


@dataclass
class Probe:
    """What was found. parameters: by name, None for one that was asked for and did not come."""

    why_closed: str = ""
    connected: bool = False
    system_id: int | None = None
    autopilot: int | None = None
    version: tuple[int, int] | None = None
    gps: GpsState = "unknown"
    gps_why: str = ""
    speed_known: bool = False
    position_known: bool = False
    parameters: dict[str, float | None] = field(default_factory=dict)

    def is_complete(self) -> bool:
        """Whether there is nothing more to wait for."""
        known = self.version is not None and self.speed_known and self.position_known
        return known and self.gps == "healthy" and None not in self.parameters.values()

    def read_vehicle(self, vehicle: Vehicle, now_ns: int) -> None:
        """Copy what the vehicle has reported so far."""
        self.connected, self.system_id = vehicle.connected, vehicle.system_id
        self.autopilot, self.version = vehicle.autopilot, vehicle.version
        self.gps, self.gps_why = vehicle.gps.state(now_ns), vehicle.gps.why(now_ns)
        self.speed_known = vehicle.speed_mps(now_ns) is not None
        self.position_known = vehicle.position(now_ns) is not None

    def read_parameter(self, message: Message) -> None:
        """Keep a PARAM_VALUE that was asked for."""
        if message.get_msgId() != mavlink.MAVLINK_MSG_ID_PARAM_VALUE:
            return
        name, value = str(message.param_id).rstrip("\0"), float(message.param_value)
        layout = PX4_INTEGERS.get(message.param_type)
        if self.autopilot == PX4 and layout:
            # PX4 puts the bytes of an integer where the float goes; ArduPilot converts.
            value = float(struct.unpack(layout, struct.pack("<f", value))[0])
        if name in self.parameters:
            self.parameters[name] = value

    def parameter_requests(self) -> list[Message]:
        """PARAM_REQUEST_READ for each parameter that has not come yet."""
        return [
            mavlink.MAVLink_param_request_read_message(
                self.system_id or FIRST_SYSTEM_ID, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1
            )
            for name, value in self.parameters.items()
            if value is None
        ]


def check_autopilot(config: TelemetryConfig, seconds: float) -> Iterator[Diagnostic]:
    """Listen to the autopilot for up to `seconds` and judge what it reports."""
    try:
        probe = probe_autopilot(config, seconds)
    except LookbackError:
        return  # the links have a finding of their own
    if probe.why_closed and not probe.connected:
        yield bad("autopilot", probe.why_closed, "see firmware_config/README.md for wiring and permissions")
    elif not probe.connected:
        silent = f"{config.connection}: no heartbeat in {seconds:g} s"
        yield bad("autopilot", silent, SERIAL if config.connection.startswith("serial:") else NETWORK)
    else:
        yield from _judge(config, probe)


def probe_autopilot(
    config: TelemetryConfig,
    seconds: float,
    clock_ns: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], object] = time.sleep,
) -> Probe:
    """Listen until all is known, at most `seconds`. ConfigError for a malformed connection, or an unusable key."""
    vehicle, probe = Vehicle(config.system_id), Probe()
    port = open_port(config, LinkConfig(config.connection, config.signing_key), 0, clock_ns)
    protocol = LinkProtocol(msgspec.structs.replace(config, origin=()), vehicle)
    asked_ns = 0
    end_ns = clock_ns() + seconds * 1e9
    try:
        while clock_ns() < end_ns and not probe.is_complete():
            now_ns = clock_ns()
            if port.open_if_due(now_ns):
                for message in protocol.heartbeat(mavlink.MAV_STATE_STANDBY, now_ns):
                    port.send(message)
                for message in port.receive():
                    if vehicle.handle(message, now_ns):
                        protocol.answer(message, now_ns)
                        probe.read_parameter(message)
                probe.read_vehicle(vehicle, now_ns)
                if vehicle.version is not None and not probe.parameters:
                    wanted = requirements(config, vehicle.autopilot, vehicle.version)
                    probe.parameters = dict.fromkeys(one.parameter for one in wanted)
                    asked_ns = 0
                if vehicle.connected:
                    for message in protocol.requests(now_ns):
                        port.send(message)
                    if now_ns - asked_ns > ASK_AGAIN_NS:
                        asked_ns = now_ns
                        for message in probe.parameter_requests():
                            port.send(message)
            probe.why_closed = port.why_closed
            sleep(TURN_S)
    finally:
        port.close()
    return probe


def requirements(config: TelemetryConfig, autopilot: int | None, version: tuple[int, int] | None) -> list[Requirement]:
    """The parameters that the configured position message needs on that firmware."""
    name: str = config.emit
    if name == "auto":
        suitable, _ = suitable_message(autopilot, version)
        name = suitable.name if suitable else "report"
    needed = [one for one in REQUIREMENTS if (one.autopilot, one.message) == (autopilot, name)]
    if autopilot == PX4 and name == "global_position_sensor":
        why = "it must equal [telemetry] sensor_id"
        needed.append(Requirement(PX4, name, "EKF2_AGP0_ID", why, values=(config.sensor_id,)))
    return needed


def _judge(config: TelemetryConfig, probe: Probe) -> Iterator[Diagnostic]:
    name = NAMES.get(probe.autopilot or 0, f"autopilot {probe.autopilot}")
    version = "{}.{}".format(*probe.version) if probe.version else "(version not reported)"
    yield good("autopilot", f"{config.connection}: {name} {version}, system {probe.system_id}")
    if config.emit == "auto":
        suitable, why = suitable_message(probe.autopilot, probe.version)
        level = good if suitable else note
        yield level("autopilot", f"emit = auto: {suitable.name if suitable else 'report'}, {why}")
    if not probe.speed_known:
        yield note("autopilot", "it reports no speed", "frames are chosen by time, which fits a map by distance badly")
    if not probe.position_known:
        yield note("autopilot", "it reports no position", "recordings have no positions until it has GPS or an origin")
    if probe.gps != "healthy":
        words = f"its GPS is {probe.gps}" + (f": {probe.gps_why}" if probe.gps_why else "")
        yield note("autopilot", words, "recordings for a map or for `lookback calibrate` need GPS")
    for one in requirements(config, probe.autopilot, probe.version):
        value = probe.parameters.get(one.parameter)
        if value is None:
            yield note(
                "parameter", f"{one.parameter}: no answer", "this firmware may not have it; see firmware_config/"
            )
        elif one.is_met(value):
            yield good("parameter", f"{one.parameter} = {value:g}")
        else:
            yield bad("parameter", f"{one.parameter} = {value:g}: {one.why}", one.remedy)
