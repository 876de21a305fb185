"""What `lookback doctor` finds out about the autopilot: whether it is heard, what it reports, how it is configured.

Sets nothing: it sends heartbeats, asks for streams as the daemon would, and reads parameters one by one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import msgspec
from pymavlink.dialects.v20 import common as mavlink

from edge.commands.diagnostic import Diagnostic, bad, good, note
from edge.config import GatesConfig, LinkConfig, TelemetryConfig
from edge.errors import LookbackError
from edge.localization import GpsState
from edge.telemetry import stream_check
from edge.telemetry.autopilot import open_port
from edge.telemetry.link_protocol import LinkProtocol
from edge.telemetry.position_messages import autopilot_name, suitable_message
from edge.telemetry.vehicle import DOUBLED, Vehicle
from edge.telemetry.velocity_aid import NO_AID, PARAMETERS, velocity_aid

TURN_S = 0.01
ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
SERIAL = (
    "check the wires, the baud rate, and that the port speaks MAVLink 2 (ArduPilot: SERIALn_PROTOCOL 2); with signing,"
    " both ends need the same key"
)
AIDS = {
    ARDUPILOT: "fit wheel encoders (EK3_SRC1_VELXY 7) or optical flow (5), see firmware_config/",
    PX4: "fit optical flow, or send a velocity as ODOMETRY, see firmware_config/px4_velocity_aid.params",
}
NETWORK = (
    "check that a program sends MAVLink 2 to this address (mavlink-router, or MAVProxy with --out), that its computer"
    " is running, and that no firewall is between; with signing, both ends need the same key"
)


@dataclass(frozen=True)
class Requirement:
    """A parameter that a position message needs: `bits` set, those of `clear` not, not 0, or one of `values`."""

    autopilot: int
    message: str
    parameter: str
    why: str
    values: tuple[int, ...] = ()
    bits: int = 0
    clear: int = 0
    remedy: str = ""

    def is_met(self, value: float) -> bool:
        """Whether the parameter may have this value."""
        if self.bits or self.clear:
            return round(value) & (self.bits | self.clear) == self.bits
        return round(value) in self.values if self.values else value != 0

    @property
    def what_to_do(self) -> str:
        """What to do about a value that it must not have."""
        if self.remedy:
            return self.remedy
        return f"set its bits {self.bits}" if self.bits else f"set it to {' or '.join(map(str, self.values))}"


GPS_MODE = "EKF2_GPS_MODE"
MEASURED = "measure it on the vehicle, see firmware_config/ardupilot_rover.param"
WHEEL_PARAMETERS = ("WENC_TYPE", "WENC_POS_Y", "WENC_RADIUS", "WENC_CPR")
VISUAL_ODOMETRY = 1 << 0 | 1 << 18  # of ARMING_CHECK: all checks, and that one
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
    Requirement(
        ARDUPILOT,
        "vision_position",
        "ARMING_CHECK",
        'the vehicle can be armed only at a recognized place, else "VisOdom: not healthy"',
        clear=VISUAL_ODOMETRY,
        remedy="set it to 785918: all checks of a rover but VisualOdometry",
    ),
    Requirement(
        PX4,
        "global_position_sensor",
        stream_check.CONTROL,
        "else message 296 is not fused",
        bits=stream_check.FUSES_POSITION,
    ),
)


@dataclass
class Probe:
    """What was found. parameters: those that were asked for; the vehicle has those that came."""

    vehicle: Vehicle
    why_closed: str = ""
    gps: GpsState = "unknown"
    gps_why: str = ""
    has_receiver: bool = False
    speed_known: bool = False
    position_known: bool = False
    parameters: tuple[str, ...] = ()

    def is_complete(self) -> bool:
        """Whether there is nothing more to wait for."""
        known = self.vehicle.version is not None and self.speed_known and self.position_known
        return known and self.gps == "healthy" and set(self.parameters) <= set(self.vehicle.parameters)

    def read_vehicle(self, now_ns: int) -> None:
        """Keep what the vehicle has reported so far and what becomes stale."""
        vehicle = self.vehicle
        self.gps, self.gps_why = vehicle.gps.state(now_ns), vehicle.gps.why(now_ns)
        self.has_receiver = vehicle.gps.receiver_state(now_ns) == "healthy"
        self.speed_known = vehicle.speed_mps(now_ns) is not None
        self.position_known = vehicle.position(now_ns) is not None


def check_autopilot(config: TelemetryConfig, gates: GatesConfig, seconds: float) -> Iterator[Diagnostic]:
    """Listen to the autopilot for up to `seconds` and judge what it reports."""
    try:
        probe = probe_autopilot(config, seconds)
    except LookbackError:
        return  # the links have a finding of their own
    if probe.why_closed and not probe.vehicle.connected:
        yield bad("autopilot", probe.why_closed, "see firmware_config/README.md for wiring and permissions")
    elif probe.vehicle.is_doubled:
        yield bad("autopilot", f"{config.connection}: {DOUBLED}", "give each vehicle a system id of its own")
    elif not probe.vehicle.connected:
        silent = f"{config.connection}: no heartbeat in {seconds:g} s"
        yield bad("autopilot", silent, SERIAL if config.connection.startswith("serial:") else NETWORK)
    else:
        yield from _judge(config, probe)
        if config.emit != "report" and gates.doubted_gps != "report":
            yield from _judge_doubted_gps(config, gates, probe.vehicle)


def probe_autopilot(
    config: TelemetryConfig,
    seconds: float,
    clock_ns: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], object] = time.sleep,
) -> Probe:
    """Listen until all is known, at most `seconds`. ConfigError for a malformed connection, or an unusable key."""
    vehicle = Vehicle(config.system_id)
    probe = Probe(vehicle)
    port = open_port(config, LinkConfig(config.connection, config.signing_key), 0, clock_ns)
    protocol = LinkProtocol(msgspec.structs.replace(config, origin=()), vehicle)
    session = 0
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
                probe.read_vehicle(now_ns)
                if vehicle.session != session:
                    session = vehicle.session
                    protocol.new_session()
                if vehicle.version is not None and not probe.parameters:
                    probe.parameters = wanted_parameters(config, vehicle)
                    protocol.parameters.add(probe.parameters)
                for message in protocol.requests(now_ns) if vehicle.connected else ():
                    port.send(message)
            probe.why_closed = port.why_closed
            sleep(TURN_S)
    finally:
        port.close()
    return probe


def wanted_parameters(config: TelemetryConfig, vehicle: Vehicle) -> tuple[str, ...]:
    """The names of all parameters that are judged for the configured message on that firmware."""
    if config.emit == "report":
        return ()
    names = [one.parameter for one in requirements(config, vehicle.autopilot, vehicle.version)]
    if vehicle.autopilot == ARDUPILOT:
        names += ["EK3_SRC1_POSXY", *WHEEL_PARAMETERS]
    if vehicle.autopilot == PX4:
        names.append(GPS_MODE)
    return (*names, *PARAMETERS.get(vehicle.autopilot or 0, ()))


def requirements(config: TelemetryConfig, autopilot: int | None, version: tuple[int, int] | None) -> list[Requirement]:
    """The parameters that the configured position message needs on that firmware."""
    name: str = config.emit
    if name == "auto":
        suitable, _ = suitable_message(autopilot, version)
        name = suitable.name if suitable else "report"
    needed = [one for one in REQUIREMENTS if (one.autopilot, one.message) == (autopilot, name)]
    if autopilot == PX4 and name == "global_position_sensor":
        why = "it must equal [telemetry] sensor_id"
        needed.append(Requirement(PX4, name, stream_check.ID, why, values=(config.sensor_id,)))
    return needed


def _judge(config: TelemetryConfig, probe: Probe) -> Iterator[Diagnostic]:
    vehicle = probe.vehicle
    name = autopilot_name(vehicle.autopilot)
    version = "{}.{}".format(*vehicle.version) if vehicle.version else "(version not reported)"
    yield good("autopilot", f"{config.connection}: {name} {version}, system {vehicle.system_id}")
    if config.emit == "auto":
        suitable, why = suitable_message(vehicle.autopilot, vehicle.version)
        level = good if suitable else note
        yield level("autopilot", f"emit = auto: {suitable.name if suitable else 'report'}, {why}")
    if not probe.speed_known:
        yield note("autopilot", "it reports no speed", "frames are chosen by time, which fits a map by distance badly")
    if not probe.position_known:
        yield note("autopilot", "it reports no position", "recordings have no positions until it has GPS or an origin")
    if probe.gps != "healthy":
        words = f"its GPS is {probe.gps}" + (f": {probe.gps_why}" if probe.gps_why else "")
        yield note("autopilot", words, "recordings for a map or for `lookback calibrate` need GPS")
    if config.emit == "report":
        return
    for one in requirements(config, vehicle.autopilot, vehicle.version):
        yield _judge_parameter(one, vehicle)
    if vehicle.autopilot == ARDUPILOT:
        yield from _judge_sources(probe)
    yield from _judge_velocity_aid(config, vehicle)


def _judge_parameter(one: Requirement, vehicle: Vehicle) -> Diagnostic:
    value = vehicle.parameters.get(one.parameter)
    if value is None:
        words = f"{one.parameter}: no answer"
        return note("parameter", words, "this firmware may not have it; see firmware_config/")
    if one.is_met(value):
        return good("parameter", f"{one.parameter} = {value:g}")
    return bad("parameter", f"{one.parameter} = {value:g}: {one.why}", one.what_to_do)


def _judge_sources(probe: Probe) -> Iterator[Diagnostic]:
    """Whether the filter uses the GPS that is there, and has all that wheel encoders need."""
    values = probe.vehicle.parameters
    position = values.get("EK3_SRC1_POSXY")
    if position == 0 and probe.has_receiver:
        words = "EK3_SRC1_POSXY = 0: the autopilot ignores its GPS, which works, and drifts from it"
        yield bad("parameter", words, "set it to 3, as firmware_config/ardupilot_rover_gps.param does")
    elif position is not None:
        meaning = {0: ", no GPS", 3: ", GPS", 6: ", vision"}.get(round(position), "")
        yield good("parameter", f"EK3_SRC1_POSXY = {position:g}{meaning}")
    if 7 in (values.get("EK3_SRC1_VELXY"), values.get("EK3_SRC2_VELXY")):
        for name in WHEEL_PARAMETERS:
            why = "wheel encoders give no speed with 0"
            yield _judge_parameter(Requirement(ARDUPILOT, "", name, why, remedy=MEASURED), probe.vehicle)


def _judge_velocity_aid(config: TelemetryConfig, vehicle: Vehicle) -> Iterator[Diagnostic]:
    aid = velocity_aid(vehicle, 2 if config.emit == "vision_position" else 1)
    if aid is None:
        words = "whether anything measures velocity without GPS is not known: the daemon assumes that nothing does"
        yield note("autopilot", words, "see firmware_config/")
    elif aid == NO_AID:
        words = "no velocity aid: without GPS the autopilot cannot hold its position between fixes"
        yield bad("autopilot", words, AIDS.get(vehicle.autopilot or 0, ""))
    else:
        yield good("autopilot", f"velocity without GPS: {aid}")


def _judge_doubted_gps(config: TelemetryConfig, gates: GatesConfig, vehicle: Vehicle) -> Iterator[Diagnostic]:
    """Whether positions can replace a GPS that the places contradict."""
    if velocity_aid(vehicle, 2 if config.emit == "vision_position" else 1) in (None, NO_AID):
        words = f'[gates] doubted_gps = "{gates.doubted_gps}" sends no position: only GPS is known to measure velocity'
        yield bad("autopilot", words, AIDS.get(vehicle.autopilot or 0, ""))
    if vehicle.parameters.get(GPS_MODE) == 0:
        words = f"{GPS_MODE} = 0: PX4 goes back to GPS between positions, though the places contradict it"
        yield bad("parameter", words, "set it to 1, see firmware_config/px4_velocity_aid.params")
