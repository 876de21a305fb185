"""Which pass of a drive the vehicle is on, where the drive comes by its position more than once.

A bridge over the way out, a street beside it, the next level of a ramp: on the ground plan they are as near as the road
that the vehicle is on. They differ in how far the vehicle can have driven since the last place. Two passes
are one road if the later goes back along the earlier; then the earlier is used, which is nearer to home.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.reference_map.gps_motion import MOST_BIAS
from edge_plugins.home.drive_line import DriveLine, nearest_on

SAME_PASS_M, SIGMAS = 5.0, 3.0
"""The vehicle may be on any pass that is no further away than the nearest by the greater of both: a lane, and so many
standard deviations of its position, by which that is rarely wrong."""
ROAD_M = 8.0
"""Between two passes of one road: two lanes and what GPS is wrong by. Two streets are rarely nearer than 12 m. After a
turn, the other lane is a pass although the vehicle cannot be on it."""
BACK_M = 100.0
"""For so long two passes have to lie side by side, unless the drive turned round before."""
TURN_M = 40.0
"""Along the drive: so little between two passes is the turn itself, which is wider than a road."""
LEVEL_M, LEVEL_SHARE, LEVEL_MOST_M = 0.5, 0.01, 4.0
"""By how much the heights of two passes of one road may differ, besides that share of the way between them, and at
most. A recorded PX4 rover's height wandered by 0.4 m in 5 s, 0.9 m in 20 s and 1.5 m in 60 s, ArduPilot's by 0.3 m in
60 s; a ramp rises by 0.05 to 0.15 of its length, and a bridge is 4.5 m higher."""


@dataclass(frozen=True)
class Pass:
    """Where a drive comes by: the row of the line before it, the point (2,) of the line, and how far away that is."""

    row: int
    point_m: NDArray[np.float64]
    away_m: float


def passes_by(line: DriveLine, here_m: NDArray[np.float64], sigma_m: float) -> list[Pass]:
    """All passes on the vehicle's road, or that it may be on, in the order of the drive. sigma_m: of its position."""
    nearest_m = nearest_on(here_m, line.points_m[:-1], line.points_m[1:])
    away_m, legs_m = np.hypot(*(nearest_m - here_m).T), np.diff(line.points_m, axis=0)
    runs: list[list[int]] = []
    for row in np.flatnonzero(away_m <= away_m.min() + max(ROAD_M, SIGMAS * sigma_m)).tolist():
        if runs and row == runs[-1][-1] + 1 and legs_m[row] @ legs_m[runs[-1][0]] > 0:
            runs[-1].append(row)
        else:  # where the drive comes near, or turns back
            runs.append([row])
    best = [run[int(away_m[run].argmin())] for run in runs]
    return [Pass(row, nearest_m[row], float(away_m[row])) for row in best]


def chosen(
    line: DriveLine, passes: Sequence[Pass], route_m: float | None, reach_m: float
) -> tuple[Pass, Sequence[Pass]]:
    """The pass to begin with, and all between which nothing decides: none, or more than one.

    route_m: how far the vehicle has driven by the odometer of the drive; None where not known. reach_m: by how much its
    position may be wrong.
    """
    nearest_m = min(one.away_m for one in passes)
    near = [one for one in passes if one.away_m <= nearest_m + reach_m]
    own = [one for one in near if _can_be_at(line, one, route_m, reach_m)] or near
    first = own[-1]
    unsure = []
    for one in reversed(passes[: passes.index(first)]):
        if is_one_road(line, one.row, first.row):
            first = one
        elif one in own:
            unsure.append(one)
    return first, [*reversed(unsure), own[-1]] if unsure else []


def _can_be_at(line: DriveLine, one: Pass, route_m: float | None, reach_m: float) -> bool:
    """Whether the vehicle can have driven back along the drive from its last place to a pass, or not left it."""
    if route_m is None:
        return True
    since_m = max(0.0, route_m - line.driven_m[-1]) * (1 + MOST_BIAS)
    back_m = line.driven_m[-1] - line.driven_m[one.row]
    return not bool(back_m > since_m + reach_m)  # NaN, where not known, may be


def is_one_road(line: DriveLine, earlier: int, later: int) -> bool:
    """Whether from the later row of a line backwards it lies beside the earlier one, until both meet."""
    along_m, points_m, alt_m = line.along_m, line.points_m, line.alt_m
    between_m = along_m[later] - along_m[earlier]
    for back_m in np.arange(0.0, min(BACK_M, max(0.0, (between_m - TURN_M) / 2)) + 1.0):
        row = int(np.searchsorted(along_m, along_m[later] - back_m, side="right")) - 1
        # Lanes side by side differ in length where the road bends.
        first, last = along_m[earlier] + 0.8 * back_m - ROAD_M, along_m[earlier] + 1.2 * back_m + ROAD_M
        beside = np.arange(*np.searchsorted(along_m, (first, min(last, along_m[row] - 1e-9))))
        if not beside.size:
            return bool(back_m > 0)
        away_m = np.hypot(*(points_m[beside] - points_m[row]).T)
        nearest = beside[away_m.argmin()]
        way_m = along_m[row] - along_m[nearest]
        level_m = min(LEVEL_M + LEVEL_SHARE * way_m, LEVEL_MOST_M)
        if away_m.min() > ROAD_M or abs(alt_m[row] - alt_m[nearest]) > level_m:
            return False
    return True
