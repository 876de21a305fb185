"""A drive's path, and points beside it: how far along it they lie, how far to the left, and how high. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.keypoints import MapPoints

Floats = NDArray[np.float64]
NEAREST_M, FARTHEST_M = 2.0, 40.0
"""Of points from their camera."""
MOST_OFF, MOST_OFF_M = 0.15, 3.0
"""Standard deviation of their distance, as a share of it and in meters."""
REACH_M = 45.0
"""Along the path, from a row to what its camera sees."""


@dataclass(frozen=True, eq=False)
class DrivePath:
    """Where a drive's rows were: meters driven (n,), meters east and north (n, 2), headings clockwise in radians."""

    along_m: Floats
    ground_m: Floats
    heading: Floats

    def points_of(self, row: int, points: MapPoints, *, faces_back: bool) -> Floats:
        """Points of a row's camera (k, 3): along the path, to the left of it, and above the camera, in meters.

        Of known distance, which are fewer. Beyond its ends the path goes on straight.
        """
        inverse = points.places[:, 2]
        with np.errstate(invalid="ignore", divide="ignore"):
            depth_m, off = 1 / inverse, points.sigma / inverse
            near = (depth_m > NEAREST_M) & (depth_m < FARTHEST_M) & (off < MOST_OFF) & (off * depth_m < MOST_OFF_M)
        depth_m, places = depth_m[near], points.places[near]
        heading = self.heading[row] + np.pi * faces_back
        sin, cos, right_m = np.sin(heading), np.cos(heading), places[:, 0] * depth_m
        ground_m = self.ground_m[row] + np.column_stack([depth_m * sin + right_m * cos, depth_m * cos - right_m * sin])
        along_m, left_m = self.beside(row, ground_m)
        return np.column_stack([along_m, left_m, -places[:, 1] * depth_m])

    def beside(self, row: int, ground_m: Floats) -> tuple[Floats, Floats]:
        """Along and left (k,) of spots (k, 2) by the nearest of the steps around a row."""
        first, last = np.searchsorted(self.along_m, self.along_m[row] + np.array([-REACH_M, REACH_M]))
        first, last = max(0, min(int(first), row - 1)), min(len(self.along_m), max(int(last) + 1, row + 2))
        at_m, starts = self.along_m[first:last], self.ground_m[first:last]
        steps = np.diff(starts, axis=0)
        starts, length_m = starts[:-1], np.hypot(*steps.T)
        ways = steps / np.maximum(length_m, 1e-9)[:, np.newaxis]
        off = ground_m[:, np.newaxis] - starts
        ahead_m = (off * ways).sum(axis=-1)
        low, high = np.zeros(len(ways)), length_m.copy()
        low[0] = -np.inf if first == 0 else 0.0
        high[-1] = np.inf if last == len(self.along_m) else high[-1]
        ahead_m = ahead_m.clip(low, high)
        rest = off - ahead_m[..., np.newaxis] * ways
        nearest = np.where(length_m > 0, np.square(rest).sum(axis=-1), np.inf).argmin(axis=1)
        each = np.arange(len(ground_m))
        rest, way = rest[each, nearest], ways[nearest]
        side = np.where(rest[:, 0] * way[:, 1] - rest[:, 1] * way[:, 0] > 0, -1.0, 1.0)
        return at_m[nearest] + ahead_m[each, nearest], side * np.hypot(*rest.T)
