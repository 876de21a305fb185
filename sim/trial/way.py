"""The way of a drive: where it truly goes, meter by meter, and which part of which road the camera sees there.

Both are the same on an ordinary road. They differ where a way is put together: a turn-off leads to another road, which
lies elsewhere in its own world; on a ferry the truth moves and the picture does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.world.scenario import Scenario

NEAR_M = 15


@dataclass(frozen=True)
class Way:
    """One element for each meter: the true pose, and the view.

    road: index of the scenario in `roads`. route_m, turn_deg: arc length there, and how far the view is turned to the
    right of the way along that road. aside_m: how far to the left of that road's lane the way is. carried: whether the
    vehicle is carried, its wheels at rest.
    """

    roads: tuple[Scenario, ...]
    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    road: NDArray[np.int64]
    route_m: NDArray[np.float64]
    turn_deg: NDArray[np.float64]
    aside_m: NDArray[np.float64]
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

    def then(self, other: Way, *, moved: bool = False) -> Way:
        """This way and then the other; moved: the other lies where this one ends, in its direction."""
        other = other.placed(*self.at(self.length_m)) if moved else other
        new = [scenario for scenario in other.roads if scenario not in self.roads]
        roads = (*self.roads, *new)
        index = np.array([roads.index(scenario) for scenario in other.roads])
        road = np.concatenate([self.road, index[other.road]])
        unwrapped = np.unwrap(np.concatenate([self.heading_rad, other.heading_rad]))
        joined = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("east_m", "north_m", "route_m", "turn_deg", "aside_m", "carried")
        }
        return Way(roads=roads, road=road, heading_rad=unwrapped, **joined)

    def placed(self, east_m: float, north_m: float, heading_rad: float) -> Way:
        """The same way from another start, turned to start at that heading; the views stay."""
        turn = heading_rad - self.heading_rad[0]
        east, north = self.east_m - self.east_m[0], self.north_m - self.north_m[0]
        return replace(
            self,
            east_m=east_m + east * np.cos(turn) + north * np.sin(turn),
            north_m=north_m + north * np.cos(turn) - east * np.sin(turn),
            heading_rad=self.heading_rad + turn,
        )

    def turned(self, angle_deg: float, radius_m: float = 8.0) -> Way:
        """This way and then an arc to the right, on which the camera turns where it is."""
        count = max(2, round(abs(np.radians(angle_deg)) * radius_m))
        turns_deg = np.linspace(0.0, angle_deg, count + 1)[1:]
        last = self.heading_rad[-1]
        steps = np.concatenate([[last], last + np.radians(turns_deg[:-1])])
        arc = replace(
            self.only(-1, count),
            east_m=self.east_m[-1] + np.cumsum(np.sin(steps)),
            north_m=self.north_m[-1] + np.cumsum(np.cos(steps)),
            heading_rad=last + np.radians(turns_deg),
            turn_deg=self.turn_deg[-1] + turns_deg,
        )
        return self.then(arc)

    def only(self, row: int, count: int) -> Way:
        """One element, `count` times."""
        return Way(
            roads=self.roads,
            east_m=np.repeat(self.east_m[row], count),
            north_m=np.repeat(self.north_m[row], count),
            heading_rad=np.repeat(self.heading_rad[row], count),
            road=np.repeat(self.road[row], count),
            route_m=np.repeat(self.route_m[row], count),
            turn_deg=np.repeat(self.turn_deg[row], count),
            aside_m=np.repeat(self.aside_m[row], count),
            carried=np.repeat(self.carried[row], count),
        )

    def carried_on(self, length_m: int) -> Way:
        """This way and then a straight line on which the vehicle is carried and sees what it saw last."""
        heading, steps = self.heading_rad[-1], np.arange(1, length_m + 1)
        line = replace(
            self.only(-1, length_m),
            east_m=self.east_m[-1] + steps * np.sin(heading),
            north_m=self.north_m[-1] + steps * np.cos(heading),
            carried=np.ones(length_m, bool),
        )
        return self.then(line)

    def towed(self, start_m: int, end_m: int) -> Way:
        """The same, but carried from one meter to another."""
        carried = self.carried.copy()
        carried[start_m:end_m] = True
        return replace(self, carried=carried)

    def bent(self, *, to_the_left: bool = False) -> Way:
        """The same bent into one lap of a circle, to the right or to the left, from its start."""
        around = -2 * np.pi if to_the_left else 2 * np.pi
        turns = np.linspace(0.0, around, len(self.east_m) + 1)[:-1] + self.heading_rad[0]
        east_m = self.east_m[0] + np.cumsum(np.sin(turns)) - np.sin(turns[0])
        north_m = self.north_m[0] + np.cumsum(np.cos(turns)) - np.cos(turns[0])
        return replace(self, east_m=east_m, north_m=north_m, heading_rad=turns)

    def beside(self, left_m: Callable[[float], float]) -> Way:
        """A way along the same road, to the left of this one by what `left_m` gives for each meter of this one."""
        lefts_m = np.array([left_m(float(along_m)) for along_m in range(len(self.east_m))])
        points = np.array([self.at(float(m), aside_m)[:2] for m, aside_m in enumerate(lefts_m)])
        along_m = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
        meters = np.arange(along_m[-1])
        steps = np.gradient(points, axis=0)
        heading_rad = np.unwrap(np.arctan2(steps[:, 0], steps[:, 1]))
        heading_rad += 2 * np.pi * round((self.heading_rad[0] - heading_rad[0]) / (2 * np.pi))
        between = {
            name: np.interp(meters, along_m, values)
            for name, values in (
                ("east_m", points[:, 0]),
                ("north_m", points[:, 1]),
                ("heading_rad", heading_rad),
                ("route_m", self.route_m),
                ("turn_deg", self.turn_deg + np.degrees(heading_rad - self.heading_rad)),
                ("aside_m", self.aside_m + lefts_m),
            )
        }
        rows = np.searchsorted(along_m, meters).clip(0, len(along_m) - 1)
        return Way(roads=self.roads, road=self.road[rows], carried=self.carried[rows], **between)

    def shifted(self, east_m: float, north_m: float) -> Way:
        """The same elsewhere: what is seen stays."""
        return replace(self, east_m=self.east_m + east_m, north_m=self.north_m + north_m)


def along(scenario: Scenario, start_m: float, end_m: float) -> Way:
    """A road in its lane, from one arc length to another, in the direction of the scenario."""
    drive = scenario.drive()
    sign = 1.0 if scenario.direction == "forward" else -1.0
    route_m = np.arange(start_m, end_m + sign / 2, sign)
    points = np.array([drive.route.at(float(m), sign * scenario.lane_m) for m in route_m])
    heading_rad = np.unwrap(points[:, 2]) + (0.0 if sign > 0 else np.pi)
    count = len(route_m)
    return Way(
        (scenario,),
        points[:, 0],
        points[:, 1],
        heading_rad,
        np.zeros(count, np.int64),
        route_m,
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, bool),
    )
