"""How a vehicle moves: by the autopilot's estimate, or where nothing measures that, by its wheels or its camera.

No I/O: the time comes in as an argument.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import VehiclePosition, east_north_of
from edge.localization import MAX_SPEED_MPS, DeadReckoning, GyroHeading, Integral, OdometerCalibration
from edge.telemetry.codec import Message

WHEELS_APART_NS = 2_500_000_000
SPEED_FRESH_NS = 5_000_000_000
"""How long a speed of the wheels holds."""
CAMERA_FRESH_NS = 1_000_000_000  # it measures ten times a second, and is silent where it cannot; so is odometry
BRIDGED_NS, BRIDGED_MPS2 = 10_000_000_000, 0.5
"""How long a speed of the camera goes on as the autopilot's own changes, and by how much that may be off at most: PX4
was 4 to 6 m off within 5 s without it (six drives)."""
RATES_APART_NS, RATES_AHEAD_NS, MOST_RADPS = 300_000_000, 100_000_000, 10.0
"""Between two rates, of six that are requested; how long the newest holds; beyond it, a rate is damaged."""
LOCAL, GLOBAL, WHEELS, HUD, ODOMETRY, CAMERA, LATERAL = range(7)
"""What a speed comes from, the best first: the autopilot's two positions, wheels, its display, ROS 2, our camera. And
that of odometry to the left."""
FRESH_NS = {WHEELS: SPEED_FRESH_NS, ODOMETRY: CAMERA_FRESH_NS, CAMERA: CAMERA_FRESH_NS, LATERAL: CAMERA_FRESH_NS}
SPEEDS = {WHEELS: "wheels", ODOMETRY: "odometry", CAMERA: "the camera"}
"""What measures a speed in which GPS has no part, the best first, and in words."""
NO_RATES, NO_SPEED = "gyro rates", "a speed without GPS"
TILT_FRESH_NS, MOST_PITCH_RAD = 2_000_000_000, math.radians(80)
"""How long roll and pitch hold, and beyond which pitch a heading is none."""
POSITIONS_APART_S = 0.5
ALIKE_MPS, ALIKE = 0.5, 0.1
"""By how much the velocity between two positions may differ from the reported one, and by which share of it."""
BACKWARDS_COS = -0.5  # of the angle between velocity and heading; a multirotor may fly to the side


@dataclass(frozen=True)
class Aid:
    """What measures the autopilot's velocity now.

    is_any: whether something besides our positions does. Where nothing does, the vehicle moves the way it heads at the
    speed of its wheels, or at that which the camera measures. is_drifting_camera: whether only our camera does, see
    `Firmware.camera_drifts`. may_be_gps: whether GPS may have a part in it.
    """

    is_any: bool = True
    is_drifting_camera: bool = False
    may_be_gps: bool = True


class VehicleVelocity:
    """What is known of the velocity in this session, and which of it counts for the motion."""

    def __init__(self, motion: DeadReckoning) -> None:
        """motion: gets the speeds and velocities that count."""
        self._motion = motion
        self.without_gps = GyroHeading()
        """What GPS has no part in: gyros, with wheels, odometry or our camera, or the autopilot without GPS."""
        self.shown = OdometerCalibration()
        """What GPS has shown of the wheels."""
        self.listen: Callable[[int, float, int | None], object] = lambda stamp_ns, value, source: None
        """Gets what GPS has no part in, stamped: meters by WHEELS, m/s by ODOMETRY or CAMERA; None: a session ended."""
        self.aid = Aid()
        """What measures the autopilot's velocity, by what arrived last."""
        self._turned = Integral(RATES_AHEAD_NS, RATES_APART_NS)
        self._tilt = 0, 0.0, 0.0  # when, roll and pitch in radians
        self._wheels: tuple[int, float] | None = None
        self._speeds: dict[int, tuple[float, float]] = {}  # when and m/s, by what of FRESH_NS measures them
        self._own: VehiclePosition | None = None
        self._seen: tuple[int, float, float] | None = None  # the camera's newest speed, and the autopilot's own of then
        self._reported_ns = 0
        self.has_our_position = False
        """Whether a fix of ours may have moved the autopilot's own position since GPS aided it last."""

    def end_leg(self, *, is_same_vehicle: bool) -> None:
        """The session has ended."""
        self._motion.end_leg(is_same_vehicle=is_same_vehicle)
        self.without_gps.end_leg()
        self.listen(0, 0.0, None)
        self.shown = OdometerCalibration() if not is_same_vehicle else self.shown
        self._wheels, self._own, self._seen = None, None, None
        self._tilt = 0, 0.0, 0.0
        self._speeds.clear()
        self.aid = replace(self.aid, is_any=True)

    def _own_speed(self, now_ns: int) -> float | None:
        """By the wheels, else by odometry, else by the camera; None where nothing measures it."""
        return next((one for source in SPEEDS if (one := self._fresh(source, now_ns)) is not None), None)

    def _fresh(self, source: int, now_ns: int) -> float | None:
        """The newest by one of FRESH_NS, m/s, None where it is too old."""
        stamp_ns, speed_mps = self._speeds.get(source, (-math.inf, None))
        return speed_mps if now_ns - stamp_ns <= FRESH_NS[source] else None

    def use_speed(self, stamp_ns: int, speed_mps: float, source: int = CAMERA, left_mps: float = 0.0) -> None:
        """The speed ahead by the camera or by another program; of use where neither autopilot nor wheels report one."""
        if math.isfinite(speed_mps):
            self.listen(stamp_ns, speed_mps, source)
            self._speeds[source] = stamp_ns, speed_mps
            if source == ODOMETRY or self._fresh(ODOMETRY, stamp_ns) is None:
                self._speeds[LATERAL] = stamp_ns, left_mps
            own = self._own
            if source == CAMERA and own is not None and own.heading_deg is not None:
                self._seen = stamp_ns, speed_mps, _ahead(own.east_mps, own.north_mps, own.heading_deg)
        if self._fresh(WHEELS, stamp_ns) is None:
            self._motion.add_speed(stamp_ns, speed_mps, source)

    def use_odometry(self, stamp_ns: int, ahead_mps: float, left_mps: float, yaw_rad: float | None) -> None:
        """The velocity by another program; yaw_rad: counterclockwise from east, used where no autopilot reports."""
        self.use_speed(stamp_ns, ahead_mps, ODOMETRY, left_mps)
        if yaw_rad is None or stamp_ns - self._reported_ns <= CAMERA_FRESH_NS:
            return
        sin, cos = math.sin(yaw_rad), math.cos(yaw_rad)
        east_mps, north_mps = ahead_mps * cos - left_mps * sin, ahead_mps * sin + left_mps * cos
        self._motion.add_velocity(stamp_ns, east_mps, north_mps, may_slip=False)

    def read(self, message: Message, stamp_ns: int, now_ns: int, *, rates_follow_gps: bool) -> None:
        """ATTITUDE, RAW_IMU, WHEEL_DISTANCE or VFR_HUD. rates_follow_gps: see `Firmware`."""
        kind = message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_ATTITUDE:
            self.turn(stamp_ns, message.pitchspeed, message.yawspeed)
            self._tilt = now_ns, message.roll, message.pitch
            if not rates_follow_gps:
                self._turn_heading(stamp_ns, now_ns, message.pitchspeed, message.yawspeed)
        elif kind == mavlink.MAVLINK_MSG_ID_RAW_IMU and rates_follow_gps:  # in thousandths
            self._turn_heading(stamp_ns, now_ns, message.ygyro / 1000, message.zgyro / 1000)
        elif kind == mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE:
            # Of up to 16 wheels. The mean, since both sides turn against each other on the spot.
            self.turn_wheels(stamp_ns, sum(message.distance[: message.count]) / max(message.count, 1))
        elif kind == mavlink.MAVLINK_MSG_ID_VFR_HUD:
            self.add_speed(now_ns, message.groundspeed, HUD)

    def turn(self, stamp_ns: int, nose_up_radps: float, right_radps: float) -> None:
        """The body turns so fast by the autopilot's gyroscopes."""
        last_ns = self._turned.last_ns
        if not max(abs(nose_up_radps), abs(right_radps)) <= MOST_RADPS or (last_ns is not None and stamp_ns <= last_ns):
            return
        if last_ns is None or stamp_ns - last_ns > RATES_APART_NS:
            self._turned.begin(stamp_ns, (0.0, 0.0), nose_up_radps, right_radps)
        else:
            self._turned.add(stamp_ns, nose_up_radps, right_radps)

    def _turn_heading(self, stamp_ns: int, now_ns: int, nose_up_radps: float, right_radps: float) -> None:
        """By rates of the body in which GPS has no part, and by how the body is tilted."""
        tilt_ns, roll, pitch = self._tilt
        if now_ns - tilt_ns > TILT_FRESH_NS or not (abs(pitch) < MOST_PITCH_RAD and math.isfinite(roll)):
            return
        right_radps = (nose_up_radps * math.sin(roll) + right_radps * math.cos(roll)) / math.cos(pitch)
        if abs(right_radps) <= MOST_RADPS:
            own, heading_rad = self._own, None
            if own is not None and own.heading_deg is not None and stamp_ns - own.stamp_ns <= CAMERA_FRESH_NS:
                heading_rad = math.radians(own.heading_deg)
            self.without_gps.turn(stamp_ns, right_radps, heading_rad, has_speed=self._has_speed(stamp_ns))

    def witness(self, now_ns: int) -> tuple[str, str]:
        """What measures its own motion, in which GPS has no part; and what is missing of that, "" where nothing is."""
        heard = [words for source, words in SPEEDS.items() if self._fresh(source, now_ns) is not None]
        speed = heard[0] if heard else "" if self.aid.may_be_gps else "the autopilot's velocity"
        missing = [] if self.without_gps.is_turned(now_ns) else [NO_RATES]
        missing += [] if speed else [NO_SPEED]
        return f"gyros and {speed}" if not missing else "", " and ".join(missing)

    def hears_odometry(self, now_ns: int) -> bool:
        """Whether odometry of another program comes."""
        return self._fresh(ODOMETRY, now_ns) is not None

    def _has_speed(self, now_ns: int) -> bool:
        """Whether a speed is known in which GPS has no part."""
        own, speed_mps = self._own, self._own_speed(now_ns)
        if speed_mps is not None:
            return abs(speed_mps) <= MAX_SPEED_MPS
        is_fresh = own is not None and own.heading_deg is not None and now_ns - own.stamp_ns <= CAMERA_FRESH_NS
        return is_fresh and not self.aid.may_be_gps

    def _left_mps(self, now_ns: int) -> float:
        """To the left, where wheels do not measure the speed."""
        return 0.0 if self._fresh(WHEELS, now_ns) is not None else self._fresh(LATERAL, now_ns) or 0.0

    def turned_rad(self, since_ns: int, until_ns: int) -> tuple[float, float] | None:
        """By how much the body has turned between two moments: nose up, and to the right; None where not known."""
        before, after = self._turned.at(since_ns), self._turned.at(until_ns)
        return None if before is None or after is None else (after[0] - before[0], after[1] - before[1])

    def move(self, before: VehiclePosition | None, now: VehiclePosition) -> None:
        """The autopilot's own position, and the one before it."""
        self._own = now
        reported = now.east_mps, now.north_mps
        self.add_speed(now.stamp_ns, signed_speed(*reported, now.heading_deg), GLOBAL)
        self.add_velocity(now.stamp_ns, *self._east_north_mps(before, now), now.heading_deg, reported)

    def _east_north_mps(self, before: VehiclePosition | None, now: VehiclePosition) -> tuple[float, float]:
        """Velocity by two positions, while no position of ours has moved them; else, and over jumps, as reported.

        Without GPS, ArduPilot's positions drift by a third of the angle by which its velocity does (recorded on Rover
        4.6.3: median 0.4 and 1.0 deg), since its compass corrects them afterwards.
        """
        reported = now.east_mps, now.north_mps
        apart_s = 0.0 if before is None else (now.stamp_ns - before.stamp_ns) / 1e9
        if before is None or self.has_our_position or not 0 < apart_s <= POSITIONS_APART_S:
            return reported
        moved_m = east_north_of(now.lat_deg, now.lon_deg, (before.lat_deg, before.lon_deg))
        by_positions = moved_m[0] / apart_s, moved_m[1] / apart_s
        return by_positions if math.dist(by_positions, reported) <= ALIKE_MPS + ALIKE * now.speed_mps else reported

    def turn_wheels(self, stamp_ns: int, driven_m: float) -> None:
        """Meters that the wheels have turned since some moment."""
        self.listen(stamp_ns, driven_m, WHEELS)
        self.shown.add_meters(stamp_ns, driven_m, self._motion.total_m)
        before, self._wheels = self._wheels, (stamp_ns, driven_m)
        if before is not None and 0 < stamp_ns - before[0] <= WHEELS_APART_NS:
            speed_mps = (driven_m - before[1]) / (stamp_ns - before[0]) * 1e9
            self._speeds[WHEELS] = stamp_ns, speed_mps
            self._motion.add_speed(stamp_ns, speed_mps, WHEELS)

    def add_speed(self, stamp_ns: int, speed_mps: float, source: int) -> None:
        """A speed by the autopilot's estimate, which counts only where something aids that."""
        if self.aid.is_any and not self.aid.is_drifting_camera:
            self._motion.add_speed(stamp_ns, speed_mps, source)

    def add_velocity(
        self,
        stamp_ns: int,
        east_mps: float,
        north_mps: float,
        heading_deg: float | None,
        reported_mps: tuple[float, float] | None = None,
    ) -> None:
        """A velocity by the autopilot's estimate; where nothing aids that, its heading and the speed of the vehicle."""
        self._reported_ns, unknown_mps = stamp_ns, 0.0
        is_reported = self.aid.is_any and not self.aid.is_drifting_camera
        if not is_reported:
            if heading_deg is None:
                return
            speed_mps, reported_mps = self._own_speed(stamp_ns), None
            if speed_mps is None:
                speed_mps, unknown_mps = self._bridged(stamp_ns, _ahead(east_mps, north_mps, heading_deg))
            if speed_mps is None:
                return
            heading_rad, left_mps = math.radians(heading_deg), self._left_mps(stamp_ns)
            sin, cos = math.sin(heading_rad), math.cos(heading_rad)
            east_mps, north_mps = speed_mps * sin - left_mps * cos, speed_mps * cos + left_mps * sin
        may_slip = is_reported or self._fresh(WHEELS, stamp_ns) is not None
        self._motion.add_velocity(
            stamp_ns, east_mps, north_mps, reported_mps, may_slip=may_slip, unknown_mps=unknown_mps
        )

    def _bridged(self, stamp_ns: int, own_mps: float) -> tuple[float | None, float]:
        """The camera's last speed, changed as the autopilot's own has since, and by how much it may be off at most."""
        seen_ns, seen_mps, then_mps = self._seen or (stamp_ns, 0.0, 0.0)
        if not (self.aid.is_drifting_camera and 0 < stamp_ns - seen_ns <= BRIDGED_NS):
            return None, 0.0
        changed_mps = seen_mps + own_mps - then_mps
        speed_mps = max(0.0, changed_mps) if seen_mps >= 0 else min(0.0, changed_mps)
        self._motion.add_speed(stamp_ns, speed_mps, CAMERA)
        return speed_mps, BRIDGED_MPS2 * (stamp_ns - seen_ns) / 1e9


def _ahead(east_mps: float, north_mps: float, heading_deg: float) -> float:
    """What of a velocity goes along a heading."""
    return east_mps * math.sin(math.radians(heading_deg)) + north_mps * math.cos(math.radians(heading_deg))


def slip(east_mps: float, north_mps: float, heading_deg: float) -> float | None:
    """Lateral over forward velocity, to the right of a heading; None if the vehicle moves mostly sideways."""
    ahead_mps, right_mps = (_ahead(east_mps, north_mps, heading_deg + turned_deg) for turned_deg in (0.0, 90.0))
    return right_mps / ahead_mps if abs(ahead_mps) > abs(right_mps) else None


def signed_speed(east_mps: float, north_mps: float, heading_deg: float | None) -> float:
    """Ground speed, negative where the vehicle moves backwards; a heading that is not known says nothing."""
    speed_mps = math.hypot(east_mps, north_mps)
    if heading_deg is not None and _ahead(east_mps, north_mps, heading_deg) < BACKWARDS_COS * speed_mps:
        return -speed_mps
    return speed_mps
