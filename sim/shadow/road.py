"""The road that was driven, in directed stretches, by where GPS had the vehicle: no map is needed for it."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import Origin, east_north, moved
from sim.shadow.drives import ShadowDrive
from sim.shadow.sun import Array

NEAR_M = 15.0
"""Within it a drive is on the same road: lanes and the errors of GPS; beyond, the road beside."""
STEP_M = 5.0
LONGEST_STEP_M = 200.0
"""Between two positions: beyond, nobody knows which road lies between them."""
JUST_LAID = 10
"""Steps within which a drive does not come along the road that it began itself."""
TURNED_DEG = 60.0
COMPASS = ("north", "northeast", "east", "southeast", "south", "southwest", "west", "northwest")


@dataclass
class Span:
    """A stretch of road in one direction; points: (latitude, longitude) of the drive that was there first."""

    heading_deg: float
    points: list[Origin] = field(default_factory=list)
    length_m: float = 0.0

    @property
    def name(self) -> str:
        """Where it begins, and where it leads."""
        lat_deg, lon_deg = self.points[0]
        return f"from {lat_deg:.5f}, {lon_deg:.5f} {COMPASS[round(self.heading_deg / 45) % 8]}"


class Road:
    """The stretches so far; a drive that comes along one belongs to it, and one where nobody was begins others."""

    def __init__(self, length_m: float) -> None:
        self._length_m = length_m
        self.spans: list[Span] = []
        self._origin: Origin | None = None
        # By cells of NEAR_M: east and north in meters, heading in degrees, stretch and step of the points on the road.
        self._points: defaultdict[tuple[int, int], list[tuple[float, float, float, int, int]]] = defaultdict(list)
        self._step = 0

    def follow(self, drive: ShadowDrive) -> NDArray[np.intp]:
        """The stretch (N,) of each record of a drive, -1 where GPS did not say where it is."""
        found = np.full(len(drive.at_deg), -1, dtype=np.intp)
        known = np.flatnonzero(~np.isnan(drive.gps_m) & ~np.isnan(drive.at_deg[:, 0]))
        if not known.size:
            return found
        self._origin = self._origin or (float(drive.at_deg[known[0], 0]), float(drive.at_deg[known[0], 1]))
        self._step += JUST_LAID
        at_m = east_north(drive.at_deg[:, 0], drive.at_deg[:, 1], self._origin)
        current = -1
        for before, row in zip(known[:-1].tolist(), known[1:].tolist(), strict=True):
            step_m = at_m[row] - at_m[before]
            if not STEP_M / 10 < float(np.hypot(*step_m)) <= LONGEST_STEP_M:
                found[row] = found[before]
                continue
            heading_deg = math.degrees(math.atan2(step_m[0], step_m[1])) % 360
            points_m = _between(at_m[before], at_m[row])
            for point_m in points_m:
                current = self._at(point_m, heading_deg, current, float(np.hypot(*step_m)) / len(points_m))
            found[row] = current
            if found[before] < 0:
                found[before] = current
        return found

    def _at(self, point_m: Array, heading_deg: float, current: int, length_m: float) -> int:
        """The stretch of a point of a drive, which stands for so many meters; a new one where there is none."""
        east_m, north_m = float(point_m[0]), float(point_m[1])
        self._step += 1
        cell = math.floor(east_m / NEAR_M), math.floor(north_m / NEAR_M)
        near = [
            (math.hypot(east_m - one[0], north_m - one[1]), one[3])
            for east in (-1, 0, 1)
            for north in (-1, 0, 1)
            for one in self._points.get((cell[0] + east, cell[1] + north), ())
            if self._step - one[4] > JUST_LAID and abs((one[2] - heading_deg + 180) % 360 - 180) <= TURNED_DEG
        ]
        apart_m, known = min(near, default=(math.inf, -1))
        if apart_m <= NEAR_M:
            return known
        newest = self.spans[-1] if self.spans else None
        if newest is None or current != len(self.spans) - 1 or newest.length_m >= self._length_m:
            newest = Span(heading_deg)
            self.spans.append(newest)
        assert self._origin is not None
        newest.points.append(moved(*self._origin, east_m, north_m))
        newest.length_m += length_m
        self._points[cell].append((east_m, north_m, heading_deg, len(self.spans) - 1, self._step))
        return len(self.spans) - 1


def _between(before_m: Array, now_m: Array) -> list[Array]:
    """Points STEP_M apart, up to the second."""
    count = max(1, round(float(np.hypot(*(now_m - before_m))) / STEP_M))
    return [before_m + (now_m - before_m) * step / count for step in range(1, count + 1)]
