"""The way of a drive: where it truly goes, meter by meter, and which part of which road the camera sees there.

Both are the same on an ordinary road. They differ where a way is put together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
