"""What each autopilot firmware does with a position, as a table; every row was measured on that firmware."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.encoders import SENSOR_ENABLE
from edge.telemetry.firmware import CONTROL, EV_CONTROL, ID, firmware_of
from edge.telemetry.firmware import Firmware as Abilities
from sim.vehicle.estimator import FilterNoise, VelocitySource

EKF3 = FilterNoise()
AcceptsFix: TypeAlias = Literal["aiding", "dead reckoning", "always"]


@dataclass(frozen=True)
class SimulatedFirmware:
    """One firmware on one kind of vehicle.

    accepts_fix: when MAV_CMD_EXTERNAL_POSITION_ESTIMATE is accepted: "aiding" is ArduPilot's rule (it has an origin,
    and had no GPS for a second), "dead reckoning" means not while GPS is used. acknowledges: whether commands are
    answered; PX4 1.15 does not. fix_rejected: the answer to a fix that is not accepted. oldest_fix_s: a larger age is
    taken for this one. aids_for_s: how long after the loss of GPS the filter goes on aiding; without wheel encoders,
    flow or airspeed it then stops, and answers FAILED for ever. uses_filter_for_s: after that time the vehicle uses
    another estimate, and an accepted fix moves nothing. corrects_lag: the time of a fix is computed from its send time
    on the boot clock, or set half a second back if that is wrong. accepts_fix_as_long: also as COMMAND_LONG, with
    float32 degrees. denies_height: a fix with a height is denied. fuses_sensor: GLOBAL_POSITION_SENSOR is fused.
    selects_by: the command that takes GPS from the filter, 0 where there is none; that of PX4 lasts over a reboot, and
    is reported (by its messages; not measured). resets_softly: a fix within 5 sigma is fused; one beyond, or of
    below 1 m, resets. noise: of its filter. needs_origin: the filter has no global position until an origin is set or
    GPS has a fix. timesync_s: period of its own TIMESYNC requests.
    """

    name: str
    autopilot: int
    version: tuple[int, int, int]
    accepts_fix: AcceptsFix
    oldest_fix_s: float
    timesync_s: float
    acknowledges: bool = True
    fix_rejected: int = mavlink.MAV_RESULT_FAILED
    aids_for_s: float = math.inf
    uses_filter_for_s: float = math.inf
    corrects_lag: bool = False
    accepts_fix_as_long: bool = False
    denies_height: bool = False
    fuses_sensor: bool = False
    selects_by: int = 0
    needs_origin: bool = False
    reports_accuracy: bool = False
    resets_softly: bool = False
    fuses_poses: bool = False
    noise: FilterNoise = EKF3

    @property
    def can(self) -> Abilities:
        """What the daemon knows of it."""
        return firmware_of(self.autopilot)


ARDUPILOT = SimulatedFirmware(
    "ardupilot", mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, (4, 6, 3), "aiding", oldest_fix_s=5.0, timesync_s=10.0,
    corrects_lag=True, denies_height=True, needs_origin=True,
    selects_by=mavlink.MAV_CMD_SET_EKF_SOURCE_SET,
)  # fmt: skip
"""With wheel encoders, flow or airspeed the filter goes on as long as anybody tried."""
PX4 = SimulatedFirmware(
    "px4", mavlink.MAV_AUTOPILOT_PX4, (1, 18, 0), "always", oldest_fix_s=15.0, timesync_s=0.1,
    fix_rejected=mavlink.MAV_RESULT_TEMPORARILY_REJECTED, accepts_fix_as_long=True, fuses_sensor=True,
    reports_accuracy=True, resets_softly=True, selects_by=SENSOR_ENABLE,
    # It believes a velocity sensor of 0.1 m/s, whose scale is wrong, and so moves little with a position.
    noise=FilterNoise(position=3.3e-4, gate_sigmas=3.0),
)  # fmt: skip
OLDER_PX4 = replace(PX4, fuses_sensor=False, resets_softly=False, selects_by=0)
FIRMWARES: dict[str, SimulatedFirmware] = {
    firmware.name: firmware
    for firmware in (
        ARDUPILOT,
        # A plain rover: stops aiding after 15 s, and falls back to DCM after 7.
        replace(ARDUPILOT, name="ardupilot-plain", aids_for_s=15.0, uses_filter_for_s=7.0),
        # As firmware_config/ardupilot_rover_fused.param has it: EK3_WENC_VERR 1 lets a pose move it more.
        replace(ARDUPILOT, name="ardupilot-fused", fuses_poses=True, noise=FilterNoise(position=0.1)),
        PX4,
        # EKF2_AGP0_ID and EKF2_AGP0_CTRL as they are shipped: positions are not used.
        replace(PX4, name="px4-without-agp", fuses_sensor=False),
        replace(OLDER_PX4, name="px4-1.17", version=(1, 17, 0)),
        replace(OLDER_PX4, name="px4-1.16", version=(1, 16, 0), accepts_fix="dead reckoning"),
        replace(OLDER_PX4, name="px4-1.15", version=(1, 15, 4), accepts_fix="dead reckoning", acknowledges=False),
    )
}


def parameters_of(firmware: SimulatedFirmware, source: VelocitySource) -> dict[str, tuple[float, int]]:
    """Value and MAV_PARAM_TYPE of its parameters for what measures its velocity, and for streams of positions."""
    kind, is_aided = mavlink.MAV_PARAM_TYPE_REAL32, source != "none"
    if EV_CONTROL in firmware.can.aid_parameters:
        return {
            EV_CONTROL: (4.0 * is_aided, kind),
            CONTROL: (float(firmware.fuses_sensor), kind),
            ID: (float(firmware.fuses_sensor), kind),
        }
    wheels = 6.0 if source == "camera" else 7.0 * is_aided
    values = {"EK3_SRC1_VELXY": wheels, "EK3_SRC2_VELXY": wheels, "WENC_TYPE": 1.0, "WENC_RADIUS": 0.1}
    poses = {name: value * firmware.fuses_poses for name, value in (("VISO_TYPE", 1.0), ("EK3_SRC2_POSXY", 6.0))}
    return {name: (value, kind) for name, value in (values | poses).items()}
