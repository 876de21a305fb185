"""How a vehicle moves: by the autopilot's estimate, its wheels, and the error of its velocity found from places.

No I/O: the time comes in as an argument.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from edge.geodesy import VehiclePosition, east_north_of
from edge.localization import PULLED_NS, DeadReckoning, Displacement, ReportedMotion

WHEELS_APART_NS = 2_500_000_000
MOST_SHARE, SLOW_MPS = 0.5, 2.0
"""Of the speed, but at least of SLOW_MPS: by which a velocity that nothing measures may be uncertain to be of use."""
STAYS, LEAST_DRIFT = 0.37, 0.05
"""How much of that stays over a line, since it changes within seconds: with it, positions on simulated drives are about
as wrong as they say. And the least share of a distance by which it may be wrong."""
MAY_BE = 0.5
"""Standard deviations of a speed that nothing measures, at which frames are used where it seems to be less: one in 4 m
at a deviation of 2 m/s and a true speed of 8."""
SPEED_FRESH_NS = 5_000_000_000
"""How long a speed of the wheels holds, and an error that was found: that comes with each used frame."""
CAMERA_FRESH_NS = 1_000_000_000  # it measures ten times a second, and is silent where it cannot; so is odometry
WHEELS, ODOMETRY, CAMERA = 3, 5, 6  # ranks of speeds, after those of the autopilot
POSITIONS_APART_S = 0.5
PULLS_KEPT = 16
"""More than are sent within PULLED_NS."""
ALIKE_MPS, ALIKE = 0.5, 0.1
"""By how much the velocity between two positions may differ from the reported one, and by which share of it."""
BACKWARDS_COS = -0.5  # of the angle between velocity and heading; a multirotor may fly to the side


class VehicleMotion:
    """The distance driven and the displacement, of all sessions; what is known of the velocity, of this one."""

    def __init__(self) -> None:
        self._motion = DeadReckoning()
        self._pulls: deque[tuple[int, float]] = deque(maxlen=PULLS_KEPT)
        """When positions of ours were sent, and how far they were from the autopilot's own."""
        self._wheels: tuple[int, float] | None = None
        self._speeds: dict[int, tuple[int, float]] = {}  # by what else measures them
        self._reported_ns = 0
        self._error: tuple[int, tuple[float, float]] | None = None
        self._error_sigma_mps = 0.0
        self._course = (0.0, 0.0), 0.0  # velocity east and north in m/s, and heading in radians
        self.is_aided = True
        """Whether something besides our positions measures the autopilot's velocity. Where nothing does, the vehicle
        moves ahead at the speed of its wheels, or at that velocity less the error that was found from places."""
        self.has_our_position = False
        """Whether a position that we sent may have moved the autopilot's own since GPS bounded it last."""

    def _end_leg(self, *, is_same_vehicle: bool) -> None:
        """The session has ended."""
        self._motion.end_leg(is_same_vehicle=is_same_vehicle)
        self._pulls.clear()
        self._wheels = self._error = None
        self._speeds.clear()
        self.is_aided = True

    def distance_m(self, stamp_ns: int) -> float | None:
        """Meters driven since the first report, at the moment of a frame; None when no speed is known around it."""
        return self._motion.distance_m(stamp_ns)

    def motion(self, stamp_ns: int, now_ns: int) -> ReportedMotion:
        """What was reported of the motion, at the moment of a frame."""
        is_measured = self._is_speed_measured(now_ns)
        pulled_m = max((off_m for sent_ns, off_m in self._pulls if now_ns - sent_ns <= PULLED_NS), default=0.0)
        return ReportedMotion(self.distance_m(stamp_ns), is_measured, *self._course, pulled_m)

    def expect_pull(self, off_m: float, now_ns: int) -> None:
        """A position of ours is sent, so far from the autopilot's own."""
        self.has_our_position = True
        self._pulls.append((now_ns, off_m))

    def _is_speed_measured(self, now_ns: int) -> bool:
        return self.is_aided or self._own_speed(now_ns) is not None

    def _own_speed(self, now_ns: int) -> float | None:
        """By the wheels, else by odometry, else by the camera; None where nothing measures it."""
        wheels_mps = _newest(self._speeds.get(WHEELS), now_ns)
        others = (_newest(self._speeds.get(source), now_ns, CAMERA_FRESH_NS) for source in (ODOMETRY, CAMERA))
        return next((one for one in (wheels_mps, *others) if one is not None), None)

    def use_speed(self, stamp_ns: int, speed_mps: float, source: int = CAMERA) -> None:
        """The speed ahead by the camera or by ODOMETRY; of use where neither autopilot nor wheels report one."""
        if math.isfinite(speed_mps):
            self._speeds[source] = stamp_ns, speed_mps
        if _newest(self._speeds.get(WHEELS), stamp_ns) is None:
            self._motion.add_speed(stamp_ns, speed_mps, source)

    def use_odometry(self, stamp_ns: int, ahead_mps: float, left_mps: float, yaw_rad: float | None) -> None:
        """The velocity by another program; yaw_rad: counterclockwise from east, used where no autopilot reports."""
        self.use_speed(stamp_ns, ahead_mps, ODOMETRY)
        if yaw_rad is None or stamp_ns - self._reported_ns <= CAMERA_FRESH_NS:
            return
        sin, cos = math.sin(yaw_rad), math.cos(yaw_rad)
        velocity_mps = ahead_mps * cos - left_mps * sin, ahead_mps * sin + left_mps * cos
        self._course = velocity_mps, math.pi / 2 - yaw_rad
        self._motion.add_velocity(stamp_ns, *velocity_mps)

    def use_velocity_error(self, error_mps: tuple[float, float], sigma_mps: float, now_ns: int) -> None:
        """What the velocity is wrong by, and one standard deviation of that ahead; of use while nothing measures it."""
        self._error, self._error_sigma_mps = (now_ns, error_mps), sigma_mps

    @property
    def distance_gaps(self) -> int:
        """How often the reports of speed paused for so long that the distance driven meanwhile is not known."""
        return self._motion.gaps

    def driven_m(self, now_ns: int) -> float | None:
        """Meters driven up to the newest report; None when no speed has come for a second."""
        return None if self._motion.speed_mps(now_ns) is None else self._motion.total_m

    def displacement(self, stamp_ns: int) -> Displacement | None:
        """Meters east and north at the moment of a frame, by the autopilot's own velocity."""
        moved = self._motion.displacement(stamp_ns)
        if moved is None or self._is_speed_measured(stamp_ns):
            return moved
        share = self._error_sigma_mps / max(self._motion.speed_mps(stamp_ns) or 0.0, SLOW_MPS)
        return replace(moved, drift=max(STAYS * share, LEAST_DRIFT)) if share <= MOST_SHARE else None

    def speed_mps(self, now_ns: int) -> float | None:
        """Ground speed, None when the newest is over a second old."""
        return self._motion.speed_mps(now_ns)

    def _move(self, before: VehiclePosition | None, now: VehiclePosition) -> None:
        """The autopilot's own position, and the one before it."""
        reported = now.east_mps, now.north_mps
        self._add_speed(now.stamp_ns, signed_speed(*reported, now.heading_deg), source=1)
        self._add_velocity(now.stamp_ns, *self._east_north_mps(before, now), now.heading_deg, reported)

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

    def _turn_wheels(self, stamp_ns: int, driven_m: float) -> None:
        """Meters that the wheels have turned since some moment."""
        before, self._wheels = self._wheels, (stamp_ns, driven_m)
        if before is not None and 0 < stamp_ns - before[0] <= WHEELS_APART_NS:
            speed_mps = (driven_m - before[1]) / (stamp_ns - before[0]) * 1e9
            self._speeds[WHEELS] = stamp_ns, speed_mps
            self._motion.add_speed(stamp_ns, speed_mps, WHEELS)

    def _add_speed(self, stamp_ns: int, speed_mps: float, source: int) -> None:
        """A speed by the autopilot's estimate, which counts only where something aids that."""
        if self.is_aided:
            self._motion.add_speed(stamp_ns, speed_mps, source)

    def _add_velocity(
        self,
        stamp_ns: int,
        east_mps: float,
        north_mps: float,
        heading_deg: float | None,
        reported_mps: tuple[float, float] | None = None,
    ) -> None:
        """A velocity by the autopilot's estimate; where nothing aids that, only what is known of it ahead counts."""
        heading_rad = self._course[1] if heading_deg is None else math.radians(heading_deg)
        self._course, self._reported_ns = ((east_mps, north_mps), heading_rad), stamp_ns
        if not self.is_aided:
            sin, cos = math.sin(heading_rad), math.cos(heading_rad)
            speed_mps = self._own_speed(stamp_ns)
            if speed_mps is None and self._error is not None and stamp_ns - self._error[0] <= SPEED_FRESH_NS:
                east_error_mps, north_error_mps = self._error[1]
                speed_mps = (east_mps - east_error_mps) * sin + (north_mps - north_error_mps) * cos
                # As fast as it may well be, or it would use no frame that could say that it does not stand.
                self._motion.add_speed(stamp_ns, max(speed_mps, MAY_BE * self._error_sigma_mps), source=1)
            if speed_mps is None or heading_deg is None:
                return
            east_mps, north_mps = speed_mps * sin, speed_mps * cos
            reported_mps = None
        self._motion.add_velocity(stamp_ns, east_mps, north_mps, reported_mps)


def _newest(speed: tuple[int, float] | None, now_ns: int, fresh_ns: int = SPEED_FRESH_NS) -> float | None:
    """A speed of some moment in m/s, None where it is too old."""
    return None if speed is None or now_ns - speed[0] > fresh_ns else speed[1]


def signed_speed(east_mps: float, north_mps: float, heading_deg: float | None) -> float:
    """Ground speed, negative where the vehicle moves backwards; a heading that is not known says nothing."""
    speed_mps, heading_rad = math.hypot(east_mps, north_mps), math.radians(heading_deg or 0.0)
    ahead_mps = east_mps * math.sin(heading_rad) + north_mps * math.cos(heading_rad)
    return -speed_mps if heading_deg is not None and ahead_mps < BACKWARDS_COS * speed_mps else speed_mps
