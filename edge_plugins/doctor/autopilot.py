"""What `lookback doctor` finds out about the autopilot: whether it is heard, what it reports, how it is configured.

Sets nothing: it sends heartbeats, asks for streams as the daemon would, and reads parameters one by one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing

from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import TelemetryConfig
from edge.errors import LookbackError
from edge.localization import TWO_AUTOPILOTS, learned
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.firmware import (
    GPS_MODE,
    GPS_SET,
    NO_AID,
    NO_AID_TIMEOUT,
    SET_WITHOUT_GPS,
    VISION,
    WHEEL_PARAMETERS,
    Requirement,
)
from edge.telemetry.link_protocol import velocity_aid
from edge.telemetry.vehicle import Vehicle
from edge.telemetry.vehicle_velocity import NO_SPEED
from edge.telemetry.wheel_store import drives_of, in_percent
from edge_plugins.doctor import fused
from edge_plugins.doctor.findings import DoctorContext, Found, bad, good, note
from edge_plugins.motion import MotionConfig

TURN_S = 0.01
FUSES = ("auto", "vision_position")
NO_SERIAL = (
    "check the wires, the baud rate, and that the port speaks MAVLink 2 (ArduPilot: SERIALn_PROTOCOL 2); with signing,"
    " both ends need the same key"
)
NO_NETWORK = (
    "check that a program sends MAVLink 2 to this address (mavlink-router, or MAVProxy with --out), that its computer"
    " is running, and that no firewall is between; with signing, both ends need the same key"
)
MEASURED = "measure it on the vehicle, see firmware_config/ardupilot_rover_fused.param"


def requirements(config: TelemetryConfig, vehicle: Vehicle) -> tuple[Requirement, ...]:
    """The parameters that the configured position message needs on that firmware."""
    session, name = vehicle.session, str(config.emit)
    if name == "auto":
        name, _ = session.firmware.suitable(session.version, session.parameters, all_came=True)
    return session.firmware.needs.get(name, ())


def _judged(one: Requirement, vehicle: Vehicle, sensor_id: int = 0) -> Found:
    """What is found of the vehicle's parameter."""
    value = vehicle.session.parameters.get(one.parameter)
    if value is None:
        return note(f"{one.parameter}: no answer", "this firmware may not have it; see firmware_config/")
    words = f"{one.parameter} = {value:g}"
    if one.is_met(value, sensor_id, vehicle.session.kind):
        return good(words)
    return bad(f"{words}: {one.why}", f"set it to {sensor_id}" if one.is_sensor_id else one.remedy)


def _wanted_parameters(config: TelemetryConfig, vehicle: Vehicle) -> set[str]:
    """The names of all parameters that are judged for the configured message on that firmware."""
    if config.emit == "report" or vehicle.session.version is None:
        return set()
    firmware, needed = vehicle.session.firmware, requirements(config, vehicle)
    of_poses = fused.wanted(vehicle.session.parameters) if _may_fuse(config, vehicle) else set()
    return {*(one.parameter for one in needed), *firmware.examined, *firmware.aid_parameters, *of_poses}


def _may_fuse(config: TelemetryConfig, vehicle: Vehicle) -> bool:
    """Whether each pose is fused where the autopilot's parameters allow it."""
    return config.emit in FUSES and "EK3_SRC2_VELXY" in vehicle.session.firmware.aid_parameters


def ground_station(config: TelemetryConfig) -> AutopilotConnection:
    """The link as a ground station's: nothing that moves a vehicle or selects anything is sent. LookbackError.

    Not as a companion computer either, which a PX4 would miss afterwards.
    """
    alone = replace(config, emit="report", origin=(), links=(), journal="")
    link = AutopilotConnection(replace(alone, component_id=mavlink.MAV_COMP_ID_MISSIONPLANNER))
    link.set_system_status(mavlink.MAV_STATE_STANDBY)
    link.speak_as(mavlink.MAV_TYPE_GCS)
    return link


def poll_until(link: AutopilotConnection, is_done: Callable[[], bool], seconds: float) -> None:
    """Poll until something is done, or at most so long; longer where a busy computer makes turns longer."""
    link.poll()
    for _ in range(round(seconds / TURN_S)):
        if is_done():
            break
        time.sleep(TURN_S)
        link.poll()


def check_autopilot(examined: DoctorContext) -> Iterator[Found]:
    """Listen to the autopilot until all is known, at most `seconds`, and judge what it reports."""
    config, doubts = examined.settings.telemetry, examined.settings.gates.doubted_gps
    try:
        link = ground_station(config)
    except LookbackError:
        return  # the links have a finding of their own
    vehicle = link.vehicle

    def is_complete() -> bool:
        status, wanted = link.status(), _wanted_parameters(config, vehicle)
        link.requests.parameters.add(wanted)
        is_known = vehicle.session.version is not None and None not in (status.speed_mps, status.lat_deg)
        is_known &= status.gps == "healthy" and wanted <= set(vehicle.session.parameters)
        is_known &= vehicle.session.gps.is_fusion_on is not None or not _takes_gps_from_px4(examined, vehicle)
        return is_known and (doubts == "report" or not vehicle.velocity.witness(time.monotonic_ns())[1])

    with closing(link):
        poll_until(link, is_complete, examined.seconds)
        status = link.status()
        witness, missing = vehicle.velocity.witness(time.monotonic_ns())
        examined.has_receiver = vehicle.session.gps.receiver_state(time.monotonic_ns()) == "healthy"
    if vehicle.is_doubled:
        yield bad(f"{config.connection}: {TWO_AUTOPILOTS}", "give each vehicle a system id of its own")
        return
    if status.state != "up":
        silent = f"{config.connection}: no heartbeat in {examined.seconds:g} s"
        remedy = NO_SERIAL if config.connection.startswith("serial:") else NO_NETWORK
        closed = "see firmware_config/README.md for wiring and permissions"
        yield bad(link.why_closed, closed) if link.why_closed else bad(silent, remedy)
        return
    examined.autopilot = vehicle
    version = "{}.{}".format(*vehicle.session.version) if vehicle.session.version else "(version not reported)"
    firmware = vehicle.session.firmware
    yield good(f"{config.connection}: {firmware.name} {version}, system {vehicle.system_id}")
    yield good(
        f"ground stations: texts are shown as of system {vehicle.system_id}; the values (NAMED_VALUE_FLOAT) by Mission"
        " Planner and MAVProxy, not by QGroundControl"
    )
    if config.emit == "auto":
        suitable, why = firmware.suitable(vehicle.session.version, vehicle.session.parameters, all_came=True)
        yield good(f"emit = auto: {suitable}, {why}") if suitable else note(f"emit = auto: report, {why}")
    if status.speed_mps is None:
        yield note("it reports no speed", "without one no place is recognized on a map with distances")
    if status.lat_deg is None:
        yield note("it reports no position", "recordings have no positions until it has GPS or an origin")
    if status.gps != "healthy":
        words = f"GPS is {status.gps}" + (f": {status.gps_why}" if status.gps_why else "")
        yield note(words, "recordings for a map or for `lookback calibrate` need GPS")
    if config.emit != "report":
        yield from _judge_velocity_aid(examined, vehicle)
    if doubts != "report":
        yield _judge_witness(examined, witness, missing)


def _judge_wheels(config: TelemetryConfig, vehicle: Vehicle) -> Iterator[Found]:
    """What earlier drives have found of the wheels, where there are any."""
    drives = drives_of(config.journal, vehicle)
    scale = learned(drives)
    if scale is not None:
        yield good(f"wheels: {in_percent(scale)}, by {len(drives)} drives")
    elif drives:
        words = "wheels: how wrong they are is known only when two drives agree"
        yield note(words, "drive another 100 m with GPS, in a new run of `lookback run`")


def _judge_witness(examined: DoctorContext, witness: str, missing: str) -> Found:
    """What decides between GPS and places that contradict it."""
    doubted = f'[gates] doubted_gps = "{examined.settings.gates.doubted_gps}"'
    if missing == NO_SPEED and examined.settings.of(MotionConfig).use in ("odometer", "send"):
        witness, missing = "gyros, and the camera while it sees the road", ""
    if not missing:
        return good(f"{doubted}: the witness is heard: {witness}")
    remedy = "it needs RAW_IMU (ArduPilot) or ATTITUDE, and wheel encoders, ODOMETRY of another program, or [motion]"
    return bad(f"{doubted} does nothing: GPS that the places contradict is declared faulty only with {missing}", remedy)


def _judge_velocity_aid(examined: DoctorContext, vehicle: Vehicle) -> Iterator[Found]:
    """What measures velocity without GPS; without it, nothing replaces a GPS that the places contradict."""
    doubted_gps, firmware = examined.settings.gates.doubted_gps, vehicle.session.firmware
    aid, sends = velocity_aid(vehicle, GPS_SET), examined.settings.of(MotionConfig).use == "send"
    aid_of_doubted = velocity_aid(vehicle, SET_WITHOUT_GPS) if doubted_gps == "switch" else aid
    if aid is None:
        words = "whether anything measures velocity without GPS is not known: the daemon assumes that nothing does"
        yield note(words, "see firmware_config/")
    elif aid == NO_AID:
        words = "no velocity aid: without GPS the autopilot cannot hold its position between fixes"
        yield bad(words, firmware.aid_remedy)
    elif aid == VISION and not (sends or vehicle.velocity.hears_odometry(time.monotonic_ns())):
        words = (
            "velocity without GPS: by a parameter it is vision, but no ODOMETRY is heard, nor does [motion] send any"
        )
        remedy = (
            'start the program that sends it and name it in [telemetry] odometry_from, or set [motion] use = "send"'
        )
        yield bad(words, remedy)
    else:
        yield good(f"velocity without GPS: {aid}")
    if sends and aid != VISION:
        words = '[motion] use = "send" is of no use: the autopilot does not use a velocity by vision'
        yield bad(words, firmware.camera_remedy)
    if doubted_gps != "report" and aid_of_doubted in (None, NO_AID):
        words = f'[gates] doubted_gps = "{doubted_gps}" sends no position: only GPS is known to measure velocity'
        yield bad(words, firmware.aid_remedy)
    yield from _judge_wheels(examined.settings.telemetry, vehicle)


def check_parameters(examined: DoctorContext) -> Iterator[Found]:
    """What the configured message and wheel encoders need, and whether the filter uses the GPS that is there."""
    config, vehicle = examined.settings.telemetry, examined.autopilot
    if config.emit == "report" or vehicle is None:
        return
    yield from (_judged(one, vehicle, config.sensor_id) for one in requirements(config, vehicle))
    values = vehicle.session.parameters
    position = values.get("EK3_SRC1_POSXY")
    if position == 0 and examined.has_receiver:
        words = "EK3_SRC1_POSXY = 0: the autopilot ignores its GPS, which works, and drifts from it"
        yield bad(words, "set it to 3, as firmware_config/ardupilot_rover_fused.param does")
    elif position is not None:
        meaning = {0: ", no GPS", 3: ", GPS"}.get(round(position), "")
        yield good(f"EK3_SRC1_POSXY = {position:g}{meaning}")
    if 7 in (values.get("EK3_SRC1_VELXY"), values.get("EK3_SRC2_VELXY")):
        for name in WHEEL_PARAMETERS:
            yield _judged(Requirement(name, "wheel encoders give no speed with 0", MEASURED), vehicle)
    if _may_fuse(config, vehicle):
        yield from fused.judge(values, velocity_aid(vehicle, GPS_SET))
    if vehicle.session.firmware.gps_switch == "fusion":
        yield from _judge_gps_of_px4(examined, vehicle)
        if vehicle.session.kind == mavlink.MAV_TYPE_GROUND_ROVER:
            yield _judge_modes_of_rover(vehicle)


def _judge_modes_of_rover(vehicle: Vehicle) -> Found:
    """In which mode a PX4 rover is once it has lost its position."""
    if velocity_aid(vehicle, GPS_SET) not in (None, NO_AID):
        return good("PX4 rover: while its velocity is measured, it stays in Position, and in a mission, without GPS")
    timeout_us = vehicle.session.parameters.get(NO_AID_TIMEOUT)
    seconds = "5 s, as shipped" if timeout_us is None else f"{timeout_us / 1e6:g} s"
    words = f"PX4 rover: {NO_AID_TIMEOUT} ({seconds}) after GPS it leaves Position for Altitude, which rovers lack"
    return note(f"{words}, and a mission for Descend", "put Stabilized or Manual on a switch, or fit a velocity aid")


def _takes_gps_from_px4(examined: DoctorContext, vehicle: Vehicle) -> bool:
    return examined.settings.gates.doubted_gps == "switch" and vehicle.session.firmware.gps_switch == "fusion"


def _judge_gps_of_px4(examined: DoctorContext, vehicle: Vehicle) -> Iterator[Found]:
    """Whether PX4 uses its GPS, and what it does with one that the places contradict."""
    doubted_gps, is_on = examined.settings.gates.doubted_gps, vehicle.session.gps.is_fusion_on
    if is_on is False and examined.has_receiver:
        words = "PX4 is set not to use its GPS, which works"
        yield bad(words, "add 1 to EKF2_SENS_EN; after a crash Lookback does so once GPS is consistent with the places")
    if _takes_gps_from_px4(examined, vehicle) and is_on is not None:
        yield good('[gates] doubted_gps = "switch": PX4 reports that its GPS can be switched')
    elif doubted_gps != "report":
        words = f'[gates] doubted_gps = "{doubted_gps}": PX4 goes on using a GPS that is wrong, and ignores positions'
        remedy = 'set "switch"' if doubted_gps == "send" else "it needs the released PX4 1.18"
        yield bad(f"{words} far from it", f"{remedy}, or then set EKF2_GPS_CTRL 0 by hand")
        if vehicle.session.parameters.get(GPS_MODE) == 0:
            words = f"{GPS_MODE} = 0: PX4 goes back to GPS between positions, though the places contradict it"
            yield bad(words, "set it to 1, see firmware_config/px4_velocity_aid.params")
