"""A seeded route: a road that bends but never crosses itself, through a series of districts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

DistrictKind = Literal["town", "shops", "suburb", "wood", "open"]
KINDS: tuple[DistrictKind, ...] = ("town", "shops", "suburb", "wood", "open")
BUILT: tuple[DistrictKind, ...] = ("town", "shops", "suburb")

LEAD_M = 120.0
"""The road goes on this far before 0 and after the length, so that no camera sees where the world ends."""
STEP_M = 1.0
MAX_TURN_RAD = 1.2
"""Largest angle between the road and its main direction; below a right angle the road cannot meet itself."""


@dataclass(frozen=True)
class District:
    """A stretch of one kind, from `start_m` up to `end_m` along the route."""

    kind: DistrictKind
    start_m: float
    end_m: float


@dataclass(frozen=True)
class WorldRoute:
    """A center line with arc length; `at` gives a position on it or beside it.

    repeats_m: after which a street is built alike, 0 where it is not.
    Arrays hold one element each STEP_M from -LEAD_M: points (N, 2) east and north, headings (N,) radians.
    """

    seed: int
    length_m: float
    districts: tuple[District, ...]
    points_m: NDArray[np.float64]
    headings_rad: NDArray[np.float64]
    repeats_m: float = 0.0

    def at(self, route_m: float, left_m: float = 0.0) -> tuple[float, float, float]:
        """East, north (m) and heading (rad) at arc length `route_m`, shifted `left_m` to the left of the road."""
        row = min(max((route_m + LEAD_M) / STEP_M, 0.0), len(self.points_m) - 1.001)  # np.clip takes 20 times as long
        low, share = int(row), row - int(row)
        east, north = self.points_m[low] + share * (self.points_m[low + 1] - self.points_m[low])
        heading = self.headings_rad[low] + share * (self.headings_rad[low + 1] - self.headings_rad[low])
        return (float(east - left_m * np.cos(heading)), float(north + left_m * np.sin(heading)), float(heading))

    def district(self, route_m: float) -> DistrictKind:
        """Kind of district at an arc length; the first and the last go on over the lead-in and lead-out."""
        return next((d.kind for d in self.districts if route_m < d.end_m), self.districts[-1].kind)

    def clearance_m(self, points_m: NDArray[np.float64]) -> float:
        """Least distance from any of `points_m` (N, 2) to the center line."""
        offsets = self.points_m[None, ::2] - np.asarray(points_m)[:, None]
        return float(np.sqrt((offsets**2).sum(axis=-1).min()))


def generate_route(seed: int, length_m: float = 1200.0, repeats_m: float = 0.0) -> WorldRoute:
    """The route of a world; the same for the same seed and length. repeats_m: of a straight street, of one kind."""
    rng = np.random.default_rng([seed, 1])
    count = int(np.ceil((length_m + 2 * LEAD_M) / STEP_M)) + 2
    main_rad = rng.uniform(-np.pi, np.pi)
    headings = main_rad + (np.zeros(count) if repeats_m else _bends(rng, count))
    steps = STEP_M * np.stack([np.sin(headings), np.cos(headings)], axis=1)
    points = np.cumsum(steps, axis=0)
    points -= points[int(LEAD_M / STEP_M)]
    districts = _districts(rng, length_m)
    if repeats_m:
        districts = (District(next(one.kind for one in districts if one.kind in BUILT), 0.0, length_m),)
    return WorldRoute(seed, length_m, districts, points, headings, repeats_m)


def _bends(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Heading relative to the main direction at each step: straights and bends, (count,) radians."""
    curvature = np.zeros(count)
    turn, row = 0.0, 0
    while row < count:
        row += int(rng.uniform(35, 110) / STEP_M)
        target = rng.uniform(-MAX_TURN_RAD, MAX_TURN_RAD)
        radius_m = rng.uniform(45, 120)
        rows = max(1, int(abs(target - turn) * radius_m / STEP_M))
        if row + rows < count:
            curvature[row : row + rows] = (target - turn) / rows
            turn = target
        row += rows
    # A driver turns the wheel gradually: curvature ramps over 14 m.
    ramp = np.ones(14) / 14
    return np.cumsum(np.convolve(curvature, ramp, mode="same"))


def _districts(rng: np.random.Generator, length_m: float) -> tuple[District, ...]:
    """Districts of 70 to 160 m, no two neighbors alike, every kind once before any comes again."""
    districts: list[District] = []
    queue: list[DistrictKind] = []
    start_m = 0.0
    while start_m < length_m:
        if not queue:
            queue = [KINDS[i] for i in rng.permutation(len(KINDS))]
            if districts and queue[0] == districts[-1].kind:
                queue.append(queue.pop(0))
        end_m = start_m + rng.uniform(70, 160)
        districts.append(District(queue.pop(0), start_m, end_m))
        start_m = end_m
    return tuple(districts)
