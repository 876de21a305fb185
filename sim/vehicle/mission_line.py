"""An uploaded mission as a line that a simulated vehicle can follow: the `Line` of `sim.vehicle.driver`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG

NEAR_M = 15.0
"""How far from the last point along the line the vehicle is searched."""


class MissionLine:
    """The waypoints of a mission, joined by straight legs; a drive begins at the first."""

    def __init__(self, waypoints_deg: Sequence[tuple[float, float]]) -> None:
        """waypoints_deg: at least two, latitude and longitude, as `MissionStore.waypoints_deg` has them."""
        lat_deg, lon_deg = np.array(waypoints_deg, dtype=float).T
        corners_m = east_north(lat_deg, lon_deg, (ORIGIN_LAT_DEG, ORIGIN_LON_DEG))
        legs_m = np.diff(corners_m, axis=0)
        along_m = np.r_[0.0, np.cumsum(np.hypot(legs_m[:, 0], legs_m[:, 1]))]
        self.length_m = float(along_m[-1])
        self._meters = np.arange(math.ceil(self.length_m) + 1.0)
        self._points_m = np.column_stack([np.interp(self._meters, along_m, column) for column in corners_m.T])
        course = np.gradient(self._points_m, axis=0)
        self._heading_rad = np.unwrap(np.arctan2(course[:, 0], course[:, 1]))
        self.carried: NDArray[np.bool_] = np.zeros(len(self._meters), dtype=bool)

    def at(self, along_m: float, left_m: float = 0.0) -> tuple[float, float, float]:
        """East, north (m) and heading (rad) after so many meters, `left_m` to the left of the line."""
        east_m, north_m = (float(np.interp(along_m, self._meters, column)) for column in self._points_m.T)
        heading_rad = float(np.interp(along_m, self._meters, self._heading_rad))
        return east_m - left_m * math.cos(heading_rad), north_m + left_m * math.sin(heading_rad), heading_rad

    def project(self, east_m: float, north_m: float, near_m: float) -> tuple[float, float]:
        """Meters along the line, and to its left, of a position around `near_m` of it."""
        near = np.abs(self._meters - near_m) <= NEAR_M
        away_m = np.array([east_m, north_m]) - self._points_m
        row = int(np.where(near, np.hypot(away_m[:, 0], away_m[:, 1]), np.inf).argmin())
        sin, cos = math.sin(self._heading_rad[row]), math.cos(self._heading_rad[row])
        ahead_m = float(away_m[row, 0] * sin + away_m[row, 1] * cos)
        return row + ahead_m, float(away_m[row, 1] * sin - away_m[row, 0] * cos)
