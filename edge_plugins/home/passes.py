"""Which pass of a drive the vehicle is on, where the drive comes by its position more than once.

A bridge over the way out, the next level of a ramp: on the ground plan they are as near as the road that the vehicle is
on. Two passes are one road if the later goes back beside the earlier, at its height; then the earlier is used, which is
nearer to home.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edge.reference_map.gps_motion import MOST_BIAS
from edge_plugins.home.drive_line import DriveLine, nearest_on

ROAD_M, SIGMAS = 8.0, 3.0
"""The vehicle may be on any pass that is no further away than the nearest by the greater of both: two lanes and what
GPS is wrong by, and so many standard deviations of its position. Two streets are rarely nearer than 12 m."""
TURN_M = 40.0
"""Along the drive: so little between two passes is the turn itself, where ROAD_M holds for both, or for the vehicle and
the earlier: 8 m behind a mapped U-turn of 3 m radius, for the latter alone."""
BACK = -math.cos(math.radians(30))
"""Cosine of the courses of two passes from which on the later goes back."""
LEVEL_M, LEVEL_SHARE, LEVEL_MOST_M = 0.5, 0.01, 4.0
"""By how much the heights of two passes of one road may differ, besides that share of the way between them, and at
most. A recorded PX4 rover's height wandered by 0.4 m in 5 s, 0.9 m in 20 s and 1.5 m in 60 s, ArduPilot's by 0.3 m in
60 s; a ramp rises by 0.05 to 0.15 of its length, and a bridge is 4.5 m higher."""


def first_row(
    line: DriveLine, here_m: NDArray[np.float64], sigma_m: float, route_m: float | None
) -> tuple[int, list[int]]:
    """The row of the line to begin with, before the vehicle, and all between which nothing decides: none, or more.

    here_m, sigma_m: the vehicle's position (2,) and its standard deviation. route_m: how far it has driven by the
    odometer of the drive, so that it cannot be on a pass too far back; None where not known.
    """
    reach_m, legs_m = max(ROAD_M, SIGMAS * sigma_m), np.diff(line.points_m, axis=0)
    at_m = nearest_on(here_m, line.points_m[:-1], line.points_m[1:])
    away_m = np.hypot(*(at_m - here_m).T)
    runs: list[list[int]] = []
    for row in np.flatnonzero(away_m <= away_m.min() + reach_m).tolist():
        if runs and row == runs[-1][-1] + 1 and legs_m[row] @ legs_m[runs[-1][0]] > 0:
            runs[-1].append(row)
        else:  # where the drive comes near, or turns back
            runs.append([row])
    rows = [run[int(away_m[run].argmin())] for run in runs]
    since_m = math.inf if route_m is None else max(0.0, route_m - line.driven_m[-1]) * (1 + MOST_BIAS)
    # NaN, where not known, may be.
    own = [row for row in rows if not line.driven_m[-1] - line.driven_m[row] > since_m + reach_m] or rows
    first, others = own[-1], list[int]()
    for row in reversed(rows[: rows.index(first)]):
        way_m = line.along_m[first] - line.along_m[row]
        is_turn = way_m < TURN_M
        apart_m = min(np.hypot(*(at_m[first] - at_m[row])), away_m[row] if is_turn else np.inf)
        if (
            apart_m <= ROAD_M
            and are_level(line.alt_m[first] - line.alt_m[row], way_m)
            and (is_turn or _goes_back(legs_m[[row, first]]))
        ):
            first = row
        elif row in own:
            others.insert(0, row)
    return first, [*others, own[-1]] if others else []


def are_level(rise_m: NDArray[np.float64], way_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether rows so far from each other by the way and in height are at one level, as far as the map knows."""
    level_m = np.minimum(LEVEL_M + LEVEL_SHARE * way_m, LEVEL_MOST_M)
    return np.asarray(~(np.abs(rise_m) > level_m))  # as NaN is


def _goes_back(legs_m: NDArray[np.float64]) -> bool:
    """Whether the second of two legs (2, 2) leads back: a later pass beside an earlier one is then the same road."""
    before, after = legs_m
    return bool(before @ after <= BACK * np.hypot(*before) * np.hypot(*after))
