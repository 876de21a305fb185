"""Positions that the simulated autopilot receives: which it accepts, and what they do to its estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import east_north_of
from edge.telemetry.codec import Message
from edge.telemetry.encoders import ARDUPILOT_M_PER_DEG, EXTERNAL_POSITION_ESTIMATE, SENSOR_ENABLE, SENSOR_GPS
from sim import ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, geodetic
from sim.vehicle.estimator import Estimator
from sim.vehicle.firmware import SimulatedFirmware

POSE_SIGMA_M = 0.5  # EK3_POSNE_M_NSE, as shipped
LAG_S = 0.5  # ArduPilot's guess for a send time that is not on its boot clock
OTHER_POSITION_S = 1.0
SET_WITHOUT_GPS = 2
SOFT_GATE, ALWAYS_RESETS_M = 5.0, 1.0  # Ekf::resetGlobalPosToExternalObservation
EV_NOISE_MPS, VERR_MIN_MPS, VERR_MAX_MPS, VISO_DELAY_S = 0.1, 0.1, 0.9, 0.15
"""EKF2_EVV_NOISE and VISO_DELAY_MS for a camera as in firmware_config, EK3_VIS_VERR_MIN and _MAX as shipped."""


@dataclass(frozen=True)
class Reset:
    """A position that was used, and the error of the estimate after it."""

    time_s: float
    error_after_m: float


@dataclass
class InputContext:
    """The state that decides what a position does: seconds on two clocks, GPS, and the origin.

    gps_lost_s: time of the loss of GPS, infinity while it works. origin_m: the filter's local zero, meters east and
    north of the simulation's; None while it has none.
    """

    now_s: float
    boot_s: float
    gps_lost_s: float
    origin_m: tuple[float, float] | None


class PositionInputs:
    """Handles positions as one firmware does."""

    def __init__(self, firmware: SimulatedFirmware, estimate: Estimator) -> None:
        self._firmware = firmware
        self._estimate = estimate
        self.resets: list[Reset] = []
        """Hard resets, by MAV_CMD_EXTERNAL_POSITION_ESTIMATE (43003)."""
        self.fused: list[Reset] = []
        """Corrections by a stream of positions, which passed the gate."""
        self.source_set = 1
        """2 is without GPS."""
        self.is_aided_by_camera = False
        """By its parameters: a velocity that a camera measured is fused."""
        self.velocities_fused: list[bool] = []
        """Whether the gate let each one pass."""

    def command(self, command: Message, moment: InputContext) -> int:
        """The MAV_RESULT of 43003 (a fix), or of the command that selects sources."""
        firmware = self._firmware
        if command.command == firmware.selects_by:
            is_sensor = command.command == SENSOR_ENABLE
            if is_sensor and command.param1 != SENSOR_GPS:
                return int(mavlink.MAV_RESULT_DENIED)
            self.source_set = int(command.param1) if not is_sensor else 1 if command.param3 else SET_WITHOUT_GPS
            return int(mavlink.MAV_RESULT_ACCEPTED)
        as_long = command.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_LONG
        if command.command != EXTERNAL_POSITION_ESTIMATE or (as_long and not firmware.accepts_fix_as_long):
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        if as_long:
            return self._accept_fix(command, command.param5, command.param6, moment)
        if firmware.denies_height and (command.frame != mavlink.MAV_FRAME_GLOBAL or not math.isnan(command.z)):
            return int(mavlink.MAV_RESULT_DENIED)
        return self._accept_fix(command, command.x / 1e7, command.y / 1e7, moment)

    def _accept_fix(self, command: Message, lat_deg: float, lon_deg: float, moment: InputContext) -> int:
        """A hard horizontal reset to where the vehicle was, if the firmware's rule accepts it."""
        without_gps_s = moment.now_s - moment.gps_lost_s
        if not self._would_accept(without_gps_s, moment):
            return self._firmware.fix_rejected
        age_s = min(command.param2, self._firmware.oldest_fix_s)
        if self._firmware.corrects_lag:
            late_s = moment.boot_s - command.param1
            age_s += late_s if 0 <= late_s < LAG_S else LAG_S
        if without_gps_s <= self._firmware.uses_filter_for_s:
            self._reset(*east_north_m(lat_deg, lon_deg), moment, age_s, command.param3)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _would_accept(self, without_gps_s: float, moment: InputContext) -> bool:
        if self._firmware.accepts_fix == "aiding":
            has_position = moment.origin_m is not None and (self._estimate.is_aided or not self.is_aided_by_camera)
            return has_position and OTHER_POSITION_S <= without_gps_s <= self._firmware.aids_for_s
        return self._firmware.accepts_fix == "always" or without_gps_s > 0

    def sensor(self, message: Message, moment: InputContext) -> None:
        """GLOBAL_POSITION_SENSOR: gated, its times ignored."""
        if self._firmware.fuses_sensor and not message.flags & mavlink.GLOBAL_POSITION_UNHEALTHY:
            east_m, north_m = east_north_m(message.lat / 1e7, message.lon / 1e7)
            self._fuse(east_m, north_m, moment, message.eph)

    def vision(self, message: Message, moment: InputContext) -> None:
        """VISION_POSITION_ESTIMATE: fused where set 2 of the sources is selected, by ArduPilot's flat formula.

        Its sigma is not used once a GPS with an accuracy has had a fix (Rover-4.6.3, `NavEKF3_core::FuseVelPosNED`).
        """
        if not self._firmware.fuses_poses or self.source_set != SET_WITHOUT_GPS or moment.origin_m is None:
            return
        origin_deg = geodetic(*moment.origin_m)
        self._fuse(*east_north_m(*vision_deg(message, origin_deg)), moment, POSE_SIGMA_M)

    def velocity(self, message: Message, moment: InputContext) -> None:
        """ODOMETRY (PX4) or VISION_POSITION_DELTA (ArduPilot, which stamps it when it arrives), gated.

        That of the body is turned by the filter's own heading; PX4 takes one north and east as it is.
        """
        kind, course_rad = message.get_type(), None
        if not self.is_aided_by_camera or kind != self._firmware.can.camera_velocity:
            return
        if kind == "ODOMETRY":
            variances = message.velocity_covariance
            sigmas = max(variances[0], EV_NOISE_MPS**2) ** 0.5, max(variances[6], EV_NOISE_MPS**2) ** 0.5
            ahead_mps = message.vx
            if message.child_frame_id == mavlink.MAV_FRAME_LOCAL_NED:
                ahead_mps, course_rad = math.hypot(message.vx, message.vy), math.atan2(message.vy, message.vx)
            values = ahead_mps, *sigmas, message.time_usec / 1e6
        else:
            error_mps = VERR_MAX_MPS + (VERR_MIN_MPS - VERR_MAX_MPS) * 0.01 * message.confidence
            ahead_mps = message.position_delta[0] / (message.time_delta_usec / 1e6)
            values = ahead_mps, error_mps, error_mps, moment.now_s - VISO_DELAY_S
        self.velocities_fused.append(self._estimate.fuse_velocity(*values, course_rad))

    def _reset(self, east_m: float, north_m: float, moment: InputContext, age_s: float, sigma_m: float) -> None:
        is_weighed = self._firmware.resets_softly and not sigma_m < ALWAYS_RESETS_M
        if is_weighed and moment.gps_lost_s < math.inf:
            self._estimate.fuse(east_m, north_m, moment.now_s - age_s, sigma_m, reset_gate=SOFT_GATE)
        else:
            self._estimate.reset(east_m, north_m, moment.now_s - age_s, sigma_m)
        self.resets.append(Reset(moment.now_s, self._estimate.error_m))

    def _fuse(self, east_m: float, north_m: float, moment: InputContext, sigma_m: float) -> None:
        if self._estimate.fuse(east_m, north_m, moment.now_s, sigma_m):
            self.fused.append(Reset(moment.now_s, self._estimate.error_m))


def vision_deg(message: Message, origin_deg: tuple[float, float]) -> tuple[float, float]:
    """Latitude and longitude of VISION_POSITION_ESTIMATE, as ArduPilot has them; origin_deg: those of its filter."""
    lat_deg = origin_deg[0] + message.x / ARDUPILOT_M_PER_DEG
    to_east = math.cos(math.radians((lat_deg + origin_deg[0]) / 2))
    return lat_deg, origin_deg[1] + message.y / ARDUPILOT_M_PER_DEG / to_east


def east_north_m(lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """Meters east and north of the simulation's origin, which lies so many degrees further east than usual."""
    return east_north_of(lat_deg, lon_deg, (ORIGIN_LAT_DEG, ORIGIN_LON_DEG), ORIGIN_ALT_M)
