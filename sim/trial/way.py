"""The way of a drive: where it truly goes, meter by meter, and which part of which road the camera sees there.

Both are the same on an ordinary road. They differ where a way is put together. A person drives, who keeps to the lane,
or the autopilot, which keeps to where it believes the lane to be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim import Pose
from sim.vehicle.estimator import Estimator
from sim.world.scenario import Scenario

NEAR_M = 15
PARTS = ("east_m", "north_m", "route_m", "turn_deg", "lateral_m", "carried")


@dataclass(frozen=True)
class Way:
    """One element for each meter: the true pose, and the view.

    road: index of the scenario in `roads`. route_m, turn_deg: arc length there, and how far the view is turned to the
    right of the way along that road. lateral_m: how far to the left of that road's lane the way is. carried: whether
    the vehicle is carried, its wheels at rest.
    """

    roads: tuple[Scenario, ...]
    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    road: NDArray[np.int64]
    route_m: NDArray[np.float64]
    turn_deg: NDArray[np.float64]
    lateral_m: NDArray[np.float64]
    carried: NDArray[np.bool_]

    @property
    def length_m(self) -> float:
        """Meters up to the last element."""
        return float(len(self.east_m) - 1)

    def at(self, along_m: float, left_m: float = 0.0) -> tuple[float, float, float]:
        """East, north (m) and heading (rad) after so many meters, `left_m` to the left of the way."""
        low = min(max(int(along_m), 0), len(self.east_m) - 2)
        share = along_m - low
        heading = self.heading_rad[low] + share * (self.heading_rad[low + 1] - self.heading_rad[low])
        east = self.east_m[low] + share * (self.east_m[low + 1] - self.east_m[low])
        north = self.north_m[low] + share * (self.north_m[low + 1] - self.north_m[low])
        return float(east - left_m * math.cos(heading)), float(north + left_m * math.sin(heading)), float(heading)

    def project(self, east_m: float, north_m: float, near_m: float) -> tuple[float, float]:
        """Meters along the way, and to its left, of the point of it that is next to a position, around `near_m`."""
        start = min(max(int(near_m) - NEAR_M, 0), len(self.east_m) - 1)
        part = slice(start, start + 2 * NEAR_M + 1)
        row = start + int(((self.east_m[part] - east_m) ** 2 + (self.north_m[part] - north_m) ** 2).argmin())
        sin, cos = math.sin(self.heading_rad[row]), math.cos(self.heading_rad[row])
        east_m, north_m = east_m - self.east_m[row], north_m - self.north_m[row]
        return float(row + east_m * sin + north_m * cos), float(north_m * sin - east_m * cos)

    def then(self, other: Way) -> Way:
        """This way and then the other."""
        new = [scenario for scenario in other.roads if scenario not in self.roads]
        roads = (*self.roads, *new)
        index = np.array([roads.index(scenario) for scenario in other.roads])
        road = np.concatenate([self.road, index[other.road]])
        unwrapped = np.unwrap(np.concatenate([self.heading_rad, other.heading_rad]))
        joined = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in PARTS}
        return Way(roads=roads, road=road, heading_rad=unwrapped, **joined)

    def turned(self, angle_deg: float, radius_m: float = 8.0) -> Way:
        """This way and then an arc to the right, on which the camera turns where it is."""
        count = max(2, round(abs(np.radians(angle_deg)) * radius_m))
        turns_deg = np.linspace(0.0, angle_deg, count + 1)[1:]
        last = self.heading_rad[-1]
        steps = np.concatenate([[last], last + np.radians(turns_deg[:-1])])
        arc = replace(
            self.stays(count),
            east_m=self.east_m[-1] + np.cumsum(np.sin(steps)),
            north_m=self.north_m[-1] + np.cumsum(np.cos(steps)),
            heading_rad=last + np.radians(turns_deg),
            turn_deg=self.turn_deg[-1] + turns_deg,
        )
        return self.then(arc)

    def stays(self, count: int) -> Way:
        """The last element, `count` times."""
        parts = (*PARTS, "road", "heading_rad")
        return Way(roads=self.roads, **{name: np.repeat(getattr(self, name)[-1], count) for name in parts})


def along(scenario: Scenario, start_m: float, end_m: float) -> Way:
    """A road in its lane, from one arc length to another, in the direction of the scenario."""
    drive = scenario.drive()
    sign = 1.0 if scenario.direction == "forward" else -1.0
    route_m = np.arange(start_m, end_m + sign / 2, sign)
    points = np.array([drive.route.at(float(m), sign * scenario.lane_m) for m in route_m])
    heading_rad = np.unwrap(points[:, 2]) + (0.0 if sign > 0 else np.pi)
    zeros = np.zeros(len(route_m))
    road, carried = zeros.astype(np.int64), zeros.astype(bool)
    return Way((scenario,), points[:, 0], points[:, 1], heading_rad, road, route_m, zeros, zeros, carried)


ACCELERATION_MPS2, BRAKES_MPS2 = 1.5, 3.0
CARRIED_MPS = 8.0
SWAY_M = 0.25
AHEAD_S, AHEAD_M = 0.8, 5.0
TURN_GAIN, TURN_RADPS = 1.5, 0.6
LAST_M = 0.5


@dataclass(frozen=True)
class Leg:
    """Drive up to a meter of the way, backwards if that lies behind; then wait."""

    to_m: float
    speed_mps: float = 8.0
    then_wait_s: float = 0.0


class Speed:
    """The signed speed along the legs; the wanted speed changes every few seconds, as on a road."""

    def __init__(self, legs: Sequence[Leg], rng: np.random.Generator) -> None:
        self._legs = list(legs)
        self._rng = rng
        self._factor, self._change_s, self._waited_s = 1.0, 4.0, 0.0
        self.speed_mps = 0.0

    @property
    def ended(self) -> bool:
        """Whether all legs are driven."""
        return not self._legs

    def step(self, along_m: float, step_s: float) -> float:
        """The speed for the next step, where the vehicle believes to be `along_m`."""
        if not self._legs:
            return 0.0
        leg = self._legs[0]
        sign = 1.0 if leg.speed_mps > 0 else -1.0
        left_m = sign * (leg.to_m - along_m)
        if left_m <= LAST_M:
            self.speed_mps = math.copysign(max(0.0, abs(self.speed_mps) - BRAKES_MPS2 * step_s), self.speed_mps)
            if self.speed_mps == 0.0:
                self._waited_s += step_s
                if self._waited_s >= leg.then_wait_s:
                    self._legs.pop(0)
                    self._waited_s = 0.0
            return self.speed_mps
        self._change_s -= step_s
        if self._change_s < 0:
            self._factor, self._change_s = self._rng.uniform(0.6, 1.3), self._rng.uniform(4.0, 10.0)
        wanted = min(abs(leg.speed_mps) * self._factor, math.sqrt(2 * ACCELERATION_MPS2 * left_m))
        speed = abs(self.speed_mps)
        slower, faster = speed - BRAKES_MPS2 * step_s, speed + ACCELERATION_MPS2 * step_s
        self.speed_mps = sign * max(0.2, min(faster, max(wanted, slower)))
        return self.speed_mps


class Driver:
    """Moves a vehicle along a line; `pose` is the truth."""

    def __init__(self, line: Way, legs: Sequence[Leg], rng: np.random.Generator, *, starts_m: float = 0.0) -> None:
        """legs: in meters of the line, from `starts_m` on."""
        self._line = line
        self._speed = Speed(legs, rng)
        self._phase = rng.uniform(0.0, 2 * np.pi)
        self.along_m, self.left_m = starts_m, 0.0
        self._believed_m = starts_m
        east_m, north_m, heading_rad = line.at(starts_m)
        self.pose = Pose(east_m, north_m, math.degrees(heading_rad) % 360, 0.0, 0.0)
        self.heading_rad = heading_rad
        self.belief: Estimator | None = None
        """Of the autopilot, if it steers."""

    @property
    def ended(self) -> bool:
        """Whether the vehicle has arrived."""
        return self._speed.ended or self.along_m >= self._line.length_m - 1

    def step(self, step_s: float) -> None:
        """Move on."""
        if self._line.carried[int(self.along_m)]:
            self._place(self.along_m + CARRIED_MPS * step_s, 0.0, 0.0, 0.0)
        elif self.belief is None:
            speed_mps = self._speed.step(self.along_m, step_s)
            left_m = SWAY_M * math.sin(2 * math.pi * self.along_m / 60.0 + self._phase)
            self._place(self.along_m + speed_mps * step_s, left_m, speed_mps, abs(speed_mps) * step_s)
        else:
            self._steer(self.belief, step_s)

    def _place(self, along_m: float, left_m: float, speed_mps: float, driven_m: float) -> None:
        east_m, north_m, self.heading_rad = self._line.at(along_m, left_m)
        self.along_m, self.left_m, self._believed_m = along_m, left_m, along_m
        heading_deg = math.degrees(self.heading_rad) % 360
        self.pose = Pose(east_m, north_m, heading_deg, speed_mps, self.pose.distance_m + driven_m)

    def _steer(self, belief: Estimator, step_s: float) -> None:
        """Pure pursuit of the line by the believed position and heading."""
        self._believed_m, _ = self._line.project(belief.east_m, belief.north_m, self._believed_m)
        speed_mps = self._speed.step(self._believed_m, step_s)
        ahead_m = math.copysign(max(AHEAD_M, AHEAD_S * abs(speed_mps)), speed_mps)
        east_m, north_m, _ = self._line.at(min(max(self._believed_m + ahead_m, 0.0), self._line.length_m - 1))
        sign = math.copysign(1.0, speed_mps)
        wanted_rad = math.atan2(sign * (east_m - belief.east_m), sign * (north_m - belief.north_m))
        off_rad = math.remainder(wanted_rad - self.heading_rad - belief.steering_error_rad, 2 * math.pi)
        if speed_mps:
            self.heading_rad += max(-TURN_RADPS, min(TURN_RADPS, TURN_GAIN * off_rad)) * step_s
        moved_m = speed_mps * step_s
        pose = self.pose
        east_m = pose.east_m + moved_m * math.sin(self.heading_rad)
        north_m = pose.north_m + moved_m * math.cos(self.heading_rad)
        heading_deg = math.degrees(self.heading_rad) % 360
        self.pose = Pose(east_m, north_m, heading_deg, speed_mps, pose.distance_m + abs(moved_m))
        self.along_m, self.left_m = self._line.project(east_m, north_m, self.along_m)
