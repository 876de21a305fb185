"""The messages that the simulated autopilot sends: one encoder for each, from a snapshot of its state."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import FusionStatus, Message
from sim import ORIGIN_ALT_M, Pose, geodetic
from sim.vehicle.attitude import AttitudeEstimate
from sim.vehicle.estimator import Estimator
from sim.vehicle.firmware import SimulatedFirmware
from sim.vehicle.gps import GpsReport

NOT_AIDED_FLAGS = 0x65
MOST_RATE = 32767  # of RAW_IMU, as of a gyroscope that saturates: the pose may jump within a step
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
RELATIVE_FLAGS, ABSOLUTE_FLAGS = 0x12F, mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS


@dataclass(frozen=True)
class AutopilotSnapshot:
    """The state of the autopilot at one moment.

    pose: the truth, for GPS only. uses_gps: whether the filter fuses it; is_fusion_on: whether it may. estimate,
    attitude: of the filter, in the simulation's frame. origin_m: the filter's local origin there, None while it has
    none. has_wheels: whether it counts their turns. base_mode: flags of MAV_MODE_FLAG. custom_mode: PX4's mode.
    """

    firmware: SimulatedFirmware
    boot_ns: int
    pose: Pose
    gps: GpsReport
    uses_gps: bool
    is_fusion_on: bool
    estimate: Estimator
    attitude: AttitudeEstimate
    origin_m: tuple[float, float] | None
    has_wheels: bool
    base_mode: int
    custom_mode: int = 0

    @property
    def boot_ms(self) -> int:
        """Milliseconds since boot, which MAVLink counts up to 49.7 days."""
        return self.boot_ns // 1_000_000 % 2**32

    @property
    def speed_mps(self) -> float:
        """Ground speed as the filter has it."""
        return math.hypot(*self.estimate.velocity_mps)

    @property
    def heading_cdeg(self) -> int:
        """Hundredths of a degree clockwise from north."""
        return round(self.estimate.heading_deg * 100) % 36000

    def degrees(self, east_m: float, north_m: float) -> tuple[int, int]:
        """Latitude and longitude in 1e-7 degrees."""
        lat_deg, lon_deg = geodetic(east_m, north_m)
        return round(lat_deg * 1e7), round(lon_deg * 1e7)


def _heartbeat(state: AutopilotSnapshot) -> Message:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GROUND_ROVER,
        state.firmware.autopilot,
        state.base_mode,
        state.custom_mode,
        mavlink.MAV_STATE_ACTIVE,
        3,
    )


def _global_position(state: AutopilotSnapshot) -> Message:
    east_mps, north_mps = state.estimate.velocity_mps
    # Without an origin there is no global position: ArduPilot sends 0, 0.
    lat, lon = state.degrees(state.estimate.east_m, state.estimate.north_m) if state.origin_m is not None else (0, 0)
    speeds_cmps = [round(mps * 100) for mps in (north_mps, east_mps, 0.0)]
    return mavlink.MAVLink_global_position_int_message(
        state.boot_ms, lat, lon, round(ORIGIN_ALT_M * 1000), 0, *speeds_cmps, state.heading_cdeg
    )


def _local_position(state: AutopilotSnapshot) -> Message:
    east_mps, north_mps = state.estimate.velocity_mps
    here, (origin_east_m, origin_north_m) = state.estimate, state.origin_m or (0.0, 0.0)
    return mavlink.MAVLink_local_position_ned_message(
        state.boot_ms, here.north_m - origin_north_m, here.east_m - origin_east_m, 0.0, north_mps, east_mps, 0.0
    )


def _attitude(state: AutopilotSnapshot) -> Message:
    angles_deg = *state.attitude.tilt_deg, math.remainder(state.estimate.heading_deg, 360.0), *state.attitude.rates_dps
    return mavlink.MAVLink_attitude_message(state.boot_ms, *map(math.radians, angles_deg))


def _raw_imu(state: AutopilotSnapshot) -> Message | None:
    """Of ArduPilot, in thousandths of a radian per second, and of g."""
    if not state.firmware.can.rates_follow_gps:
        return None
    rates = [max(-MOST_RATE, min(int(math.radians(rate) * 1000), MOST_RATE)) for rate in state.attitude.rates_dps]
    return mavlink.MAVLink_raw_imu_message(state.boot_ns // 1000, 0, 0, -1000, *rates, 0, 0, 0)


def _vfr_hud(state: AutopilotSnapshot) -> Message:
    speed_mps, heading_deg = state.speed_mps, round(state.estimate.heading_deg) % 360
    return mavlink.MAVLink_vfr_hud_message(speed_mps, speed_mps, heading_deg, 0, ORIGIN_ALT_M, 0.0)


def _gps_raw(state: AutopilotSnapshot) -> Message:
    if state.gps.second or state.gps.fix_type <= mavlink.GPS_FIX_TYPE_NO_FIX:
        return mavlink.MAVLink_gps_raw_int_message(0, state.gps.fix_type * (not state.gps.second), *[0] * 3, *_NO_DOP)
    return mavlink.MAVLink_gps_raw_int_message(*_receiver(state), h_acc=round(state.gps.accuracy_m * 1e3))


def _gps2_raw(state: AutopilotSnapshot) -> Message | None:
    if not state.gps.second:
        return None
    return mavlink.MAVLink_gps2_raw_message(*_receiver(state), 0, 0, h_acc=round(state.gps.accuracy_m * 1e3))


_NO_DOP = (65535, 65535, 0, 0, 0)


def _receiver(state: AutopilotSnapshot) -> tuple[int, ...]:
    """The fields that both receivers' messages begin with."""
    at = *state.degrees(*state.gps.position(state.pose)), round(ORIGIN_ALT_M * 1000)
    moves = round(abs(state.pose.speed_mps) * 100), state.heading_cdeg
    return (state.boot_ns // 1000, state.gps.fix_type, *at, 70, 110, *moves, 10)


def _wheel_distance(state: AutopilotSnapshot) -> Message | None:
    if not state.has_wheels:
        return None
    driven_m = [state.estimate.driven_m] * 2 + [0.0] * 14
    return mavlink.MAVLink_wheel_distance_message(state.boot_ns // 1000, 2, driven_m)


def _odometry(state: AutopilotSnapshot) -> Message:
    here, half_rad, unknown = state.estimate, math.radians(state.estimate.heading_deg) / 2, [math.nan] * 21
    pose = here.north_m, here.east_m, 0.0, [math.cos(half_rad), 0.0, 0.0, math.sin(half_rad)]
    frames = mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD
    return mavlink.MAVLink_odometry_message(
        state.boot_ns // 1000, *frames, *pose, state.speed_mps, *[0.0] * 5, unknown, unknown
    )


def _filter_flags(state: AutopilotSnapshot) -> int:
    """As recorded: velocity and relative position while anything aids them, absolute position with GPS."""
    if not (state.estimate.is_aided or state.uses_gps):
        return NOT_AIDED_FLAGS
    return RELATIVE_FLAGS | (ABSOLUTE_FLAGS if state.uses_gps else 0)


def _estimator_status(state: AutopilotSnapshot) -> Message:
    return mavlink.MAVLink_estimator_status_message(
        state.boot_ns // 1000, _filter_flags(state), *[0] * 6, state.estimate.sigma_m, 1.0
    )


class _FusionStatus(FusionStatus):
    """With what only an autopilot needs."""

    def pack(self, mav: mavlink.MAVLink, force_mavlink1: bool = False) -> bytes:
        """As pymavlink's messages do it."""
        payload = self.unpacker.pack(*self.test_ratio, *self.intended, *self.active)
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))


def _fusion_status(state: AutopilotSnapshot) -> Message:
    """GPS, and what a recorded PX4 was set to fuse besides."""
    others = [1, 0, 1, 1, 1, 1, 0, 0]
    return _FusionStatus([int(state.is_fusion_on), *others], [int(state.uses_gps), *others], [math.nan] * 9)


def _origin(state: AutopilotSnapshot) -> Message | None:
    if state.origin_m is None:
        return None
    return mavlink.MAVLink_gps_global_origin_message(
        *state.degrees(*state.origin_m), round(ORIGIN_ALT_M * 1000), state.boot_ns // 1000
    )


def version_of(firmware: SimulatedFirmware) -> Message:
    """AUTOPILOT_VERSION."""
    major, minor, patch = firmware.version
    software = major << 24 | minor << 16 | patch << 8 | 255
    return mavlink.MAVLink_autopilot_version_message(
        CAPABILITIES, software, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
    )


ENCODERS: dict[int, Callable[[AutopilotSnapshot], Message | None]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: lambda state: mavlink.MAVLink_timesync_message(0, state.boot_ns),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: _raw_imu,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw,
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: _gps2_raw,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: lambda state: mavlink.MAVLink_system_time_message(0, state.boot_ms),
    mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE: _wheel_distance,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator_status,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: lambda state: mavlink.MAVLink_ekf_status_report_message(
        _filter_flags(state), *[0.0] * 5
    ),
    FusionStatus.id: _fusion_status,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _origin,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: lambda state: version_of(state.firmware),
}
"""By message id; ESTIMATOR_STATUS only for firmware that reports its accuracy, EKF_STATUS_REPORT only for the other."""
