"""What each autopilot's firmware can do, and how: a row of `FIRMWARES` for each, and of which version.

Telemetry, the plug-ins, `lookback doctor` and the simulator look here, so that another autopilot is one more row. What
each firmware does with each message was tried on the firmware itself, or read in its source.

ArduPilot fuses a velocity alone only as VISION_POSITION_DELTA, which makes its filter aid itself as with wheel encoders
(`readyToUseBodyOdm` in NavEKF3_core); VISION_SPEED_ESTIMATE and ODOMETRY need a position as well. PX4 fuses ODOMETRY in
the frame of the body, with its own gate (ev_vel_control.cpp). Both take nothing that is older than 200 ms for a start,
and go on alone as soon as nothing comes.

ArduPilot's pull request 31738, open in August 2026, fuses 43003 and GLOBAL_POSITION_SENSOR while an option of
EK3_OPTIONS is set. No release has it, the option's bit may still change, and no version says that a build has it: so
`auto` never chooses that message for ArduPilot, and the user of such a build does.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Version: TypeAlias = tuple[int, int]
Parameters: TypeAlias = Mapping[str, float]
AIRSPEED, WHEELS, FLOW, VISION, BEACONS = "airspeed and wind", "wheel encoders", "optical flow", "vision", "beacons"
NO_AID = "none"
GPS_SET, SET_WITHOUT_GPS = 1, 2
ON_ROTORS = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_HELICOPTER,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_DODECAROTOR,
)
ON_THE_GROUND = (mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT)
CONTROL, ID, EV_CONTROL = "EKF2_AGP0_CTRL", "EKF2_AGP0_ID", "EKF2_EV_CTRL"
GPS_MODE, NO_AID_TIMEOUT = "EKF2_GPS_MODE", "EKF2_NOAID_TOUT"
FUSES_POSITION, EV_VELOCITY = 1, 1 << 2  # bits of CONTROL and EV_CONTROL
WHEEL_PARAMETERS = ("WENC_TYPE", "WENC_POS_Y", "WENC_RADIUS", "WENC_CPR")
FUSION = "message 296 is fused by builds with pull request 31738 alone, where its option is set"
DCM = "else a rover or plane without GPS falls back to DCM: it answers ACCEPTED, and its position does not move"


@dataclass(frozen=True)
class Requirement:
    """What a parameter must be: with `bits` set, or one of `values`, or [telemetry] sensor_id; else not 0.

    not_of: MAV_TYPE of vehicles that do without it.
    """

    parameter: str
    why: str
    remedy: str
    values: tuple[int, ...] = ()
    bits: int = 0
    is_sensor_id: bool = False
    not_of: tuple[int, ...] = ()

    def is_met(self, value: float, sensor_id: int, kind: int | None) -> bool:
        """Whether the parameter may have this value; kind: MAV_TYPE."""
        if kind in self.not_of:
            return True
        if self.bits:
            return round(value) & self.bits == self.bits
        values = (sensor_id,) if self.is_sensor_id else self.values
        return round(value) in values if values else value != 0


@dataclass(frozen=True)
class Firmware:
    """One autopilot; the defaults are those of one that is not known.

    takes: by which message it takes a position, from which version on; the first that fits is used. asks: the
    parameters that its user sets for a message which is not used without them. needs: what a message needs. aid: what
    measures its velocity without GPS by its `aid_parameters`, see `NO_AID`; None: not known. camera_velocity: the
    message by which it takes a velocity of the camera; camera_drifts: whether its filter adds errors of its own to
    that, which change in 200 m: on five simulated roads, positions were up to 12 m and 4.9 standard deviations off by
    it. gps_glitch: the flag of its filter. rates_follow_gps: whether the bias of the turn rates in its ATTITUDE follows
    a spoofed GPS, so that its gyros count. integers_as_bytes: whether the bytes of an integer parameter are put where
    the float goes. home_is_item_0: whether that item of a mission is its own home position. stands_at_origin: whether
    one that has no position takes an origin for where it is, and can be armed. hold: parameters of DO_SET_MODE by which
    a vehicle on the ground stops and stays. gps_switch: what its filter uses is selected as one of its sets of sources,
    which it does not report, or by GPS itself, which it does; such a one ignores positions far from GPS. examined: what
    else `lookback doctor` reads. aid_remedy, camera_remedy: what to do where a velocity is not measured, or that of the
    camera not used.
    """

    name: str
    takes: tuple[tuple[Version, str], ...] = ()
    asks: Mapping[str, tuple[Requirement, ...]] = field(default_factory=dict)
    needs: Mapping[str, tuple[Requirement, ...]] = field(default_factory=dict)
    aid_parameters: tuple[str, ...] = ()
    aid: Callable[[Parameters, Collection[int], int], str | None] = lambda parameters, heard, source_set: None
    camera_velocity: Literal["", "ODOMETRY", "VISION_POSITION_DELTA"] = ""
    camera_drifts: bool = False
    gps_glitch: int = 0
    rates_follow_gps: bool = False
    integers_as_bytes: bool = False
    home_is_item_0: bool = False
    stands_at_origin: bool = False
    hold: tuple[int, ...] = ()
    gps_switch: Literal["", "sources", "fusion"] = ""
    examined: tuple[str, ...] = ()
    aid_remedy: str = ""
    camera_remedy: str = 'use = "odometer"'

    def suitable(self, version: Version | None, parameters: Parameters, *, all_came: bool) -> tuple[str, str]:
        """The message that `auto` chooses, and why; "" while that is not known, or it takes no position.

        all_came: no further parameter will.
        """
        if version is None:
            return "", f"{self.name} has not reported its version"
        fits = [message for first, message in self.takes if version >= first]
        for message in fits:
            asked = self.asks.get(message, ())
            unknown = [one.parameter for one in asked if one.parameter not in parameters]
            if unknown and not all_came:
                return "", f"{self.name}: {unknown[0]} not reported"
            if not unknown and all(one.is_met(parameters[one.parameter], 0, None) for one in asked):
                return message, f"{self.name} {version[0]}.{version[1]} takes {message}"
        return "", f"{self.name} {version[0]}.{version[1]} takes no position"

    def unused_because(self, parameters: Parameters, message: str, sensor_id: int, kind: int | None) -> str:
        """Why it will use no position that comes in that message; "" where nothing is known against it."""
        for one in self.needs.get(message, ()):
            value = parameters.get(one.parameter)
            if value is not None and not one.is_met(value, sensor_id, kind):
                return f"{one.parameter} is {value:.0f}"
        return ""


def _ardupilot_aid(parameters: Parameters, heard: Collection[int], source_set: int) -> str | None:
    source = parameters.get(f"EK3_SRC{source_set}_VELXY")
    if source is None:
        return None
    sensors = {5: ("FLOW_TYPE", FLOW), 7: ("WENC_TYPE", WHEELS)}
    if round(source) not in sensors:
        return {4: BEACONS, 6: VISION}.get(round(source), NO_AID)
    parameter, aid = sensors[round(source)]
    kind = parameters.get(parameter)
    return None if kind is None else aid if kind else NO_AID


def _px4_aid(parameters: Parameters, heard: Collection[int], source_set: int) -> str | None:
    """Flow is enabled by default, with or without a sensor, so that it has to be heard."""
    vision = parameters.get(EV_CONTROL)
    if vision is None:
        return None
    if round(vision) & EV_VELOCITY:
        return VISION
    if mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD not in heard:
        return NO_AID
    controls = [parameters.get(name) for name in ("EKF2_OF_CTRL", "EKF2_OF0_CTRL")]
    return FLOW if any(controls) else None if controls == [None, None] else NO_AID


EKF3 = (
    Requirement("AHRS_EKF_TYPE", "only EKF3 uses positions sent to it", "set it to 3", (3,)),
    Requirement("AHRS_OPTIONS", DCM, "set its bits 3", bits=3, not_of=ON_ROTORS),  # AP_AHRS: FLAG_ALWAYS_USE_EKF
)
FUSES_POSES = (
    Requirement("VISO_TYPE", "else it reads no VISION_POSITION_ESTIMATE", "load firmware_config/*_fused.param", (1,)),
    Requirement("EK3_SRC2_POSXY", "else set 2 of its sources takes no position", "set it to 6", (6,)),
)
FIRMWARES = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: Firmware(
        "ArduPilot",
        takes=(((4, 5), "vision_position"), ((4, 5), "external_position")),
        asks={"vision_position": FUSES_POSES},
        needs={
            "vision_position": (*EKF3, *FUSES_POSES),
            "external_position": EKF3,
            "global_position_sensor": (*EKF3, Requirement("EK3_OPTIONS", FUSION, "set its option SetLatLngFusion")),
        },
        aid_parameters=("EK3_SRC1_VELXY", "EK3_SRC2_VELXY", "WENC_TYPE", "FLOW_TYPE"),
        aid=_ardupilot_aid,
        camera_velocity="VISION_POSITION_DELTA",
        gps_glitch=1 << 15,  # EKF_GPS_GLITCHING, in EKF_STATUS_REPORT
        rates_follow_gps=True,
        home_is_item_0=True,
        hold=(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 4),  # Rover's HOLD
        gps_switch="sources",
        examined=("EK3_SRC1_POSXY", *WHEEL_PARAMETERS),
        aid_remedy="fit wheel encoders (EK3_SRC1_VELXY 7) or optical flow (5), see firmware_config/, or set [motion]",
        camera_remedy="load firmware_config/ardupilot_camera_velocity.param",
    ),
    mavlink.MAV_AUTOPILOT_PX4: Firmware(
        "PX4",
        takes=(((1, 18), "global_position_sensor"), ((1, 15), "external_position")),
        needs={
            "global_position_sensor": (
                Requirement(CONTROL, "else message 296 is not fused", "set its bits 1", bits=FUSES_POSITION),
                Requirement(ID, "it must equal [telemetry] sensor_id", "set it to that", is_sensor_id=True),
            )
        },
        aid_parameters=(EV_CONTROL, "EKF2_OF_CTRL", "EKF2_OF0_CTRL"),
        aid=_px4_aid,
        camera_velocity="ODOMETRY",
        camera_drifts=True,
        gps_glitch=mavlink.ESTIMATOR_GPS_GLITCH,
        integers_as_bytes=True,
        stands_at_origin=True,
        hold=(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 4, 3),  # AUTO, LOITER
        gps_switch="fusion",
        examined=(GPS_MODE, NO_AID_TIMEOUT),
        aid_remedy=("fit optical flow, or send ODOMETRY, see firmware_config/px4_velocity_aid.params, or set [motion]"),
        camera_remedy="load firmware_config/px4_camera_velocity.params",
    ),
}
"""By MAV_AUTOPILOT."""


def firmware_of(autopilot: int | None) -> Firmware:
    """Of a MAV_AUTOPILOT, None where none was heard."""
    return FIRMWARES.get(autopilot) or Firmware("no autopilot" if autopilot is None else f"autopilot {autopilot}")
