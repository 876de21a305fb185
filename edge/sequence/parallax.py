"""How far a vehicle is beside the map's drive: its left and its right region match different places.

Both cameras look the same way. To a vehicle that is further left than the one that made the map, what stands on the
left is nearer, so that the left region shows what the map's camera saw from further back, and the right region what it
saw from further ahead. The places of the two regions are then apart by a distance that is proportional to how far the
vehicle is beside the map's drive; [rig] parallax is the factor, which `lookback calibrate` measures. In the simulator
it is 2.4 to 2.6 m for each meter, over the lights and roads that were tried: a few meters show as several places.

The paper matches both regions together. Here the line that it found is matched again with each region alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from edge.reference_map import MapSet
from edge.sequence import PARALLAX_ROWS, Parallax, PlaceMatch

REACH = 10
"""Places by which the line of one region is moved along the map, in each direction."""
MIDDLE = 4
"""Places by which the middle of both lines may differ from the line of both regions together."""
APART = 8
"""Places that the two lines may be apart."""
ELSEWHERE = 4
"""Places from which on another distance between the two lines is another answer, and not the same one inexactly."""
CONTRAST = 0.02
"""Share by which every other answer must cost more: on views beside the lane, 0 to 6 % were then off by over 4 m."""
LEAST_ROWS = 0.6
"""Share of the rows of a line that must be on the map wherever it is moved to."""

_STEPS = np.arange(-REACH, REACH + 1)
_LEFT, _RIGHT = np.meshgrid(_STEPS, _STEPS, indexing="ij")
_POSSIBLE = (np.abs(_LEFT + _RIGHT) <= 2 * MIDDLE) & (np.abs(_LEFT - _RIGHT) <= APART)


def parallax_of(match: PlaceMatch, newest: Callable[[int], NDArray[np.float32]], map_set: MapSet) -> Parallax | None:
    """Of a match; None where the costs do not say. newest: the newest so many rows of its ring (n, R, D), oldest first.

    Its cameras look the same way, or the two regions do not see the same side of the road.
    """
    rows = newest(PARALLAX_ROWS)
    ages = np.flatnonzero(~np.isnan(rows[::-1, 0, 0]))  # a place without a frame is NaN throughout
    sign = 1 if match.direction == "forward" else -1
    places = rows_of_line(match.place_index, match.slope, sign, ages)
    segment = map_set.index.segment(map_set.index.segment_of(match.place_index))
    own = map_set.index.rows[map_set.index.map_of(match.place_index)]
    first = max(segment[0], own[0], int(places.min()) - REACH)
    end = min(segment[1], own[1], int(places.max()) + REACH + 1)
    return regions_apart(map_set.region_costs(rows[::-1][ages], first, end), places, first, sign)


def rows_of_line(place: int, slope: float, sign: int, rows: Sequence[int] | NDArray[np.intp]) -> NDArray[np.intp]:
    """The places (n,) of a line that ends at a place, at some ages in frames; sign: -1 for the way back."""
    return place - sign * np.rint(np.asarray(rows) * slope).astype(np.intp)


def regions_apart(costs: NDArray[np.float64], places: NDArray[np.intp], first: int, sign: int) -> Parallax | None:
    """Where the lines of the two regions are; None where the costs do not say.

    costs: (2, n, W) of the left and of the right region alone, of n frames against the places from `first` on. places:
    (n,) of the line of both together. sign: 1 if places were passed in the map's order, -1 on the way back.
    """
    moved = places[:, np.newaxis] - first + _STEPS
    is_known = ((moved >= 0) & (moved < costs.shape[2])).all(axis=1)
    if is_known.sum() < LEAST_ROWS * len(places):
        return None
    at = moved[is_known]
    lines = np.take_along_axis(costs[:, is_known], np.broadcast_to(at, (2, *at.shape)), axis=2).mean(axis=1)
    both = np.where(_POSSIBLE, lines[0][:, np.newaxis] + lines[1], np.inf)
    left, right = np.unravel_index(int(both.argmin()), both.shape)
    is_other = np.abs((_LEFT - _RIGHT) - (_STEPS[left] - _STEPS[right])) >= ELSEWHERE
    if both[is_other].min() < (1 + CONTRAST) * both[left, right]:
        return None
    at_left, at_right = _lowest(lines[0], int(left)), _lowest(lines[1], int(right))
    if math.isnan(at_left + at_right):
        return None
    return Parallax(round(sign * (at_right - at_left), 3), round((at_left + at_right) / 2, 3))


def _lowest(costs: NDArray[np.float64], at: int) -> float:
    """Where the parabola through the costs around a step is lowest, in steps; NaN where it has no bottom there."""
    if not 0 < at < len(costs) - 1:
        return float("nan")
    before, here, after = costs[at - 1 : at + 2]
    curvature = before - 2 * here + after
    if curvature <= 0:
        return float("nan")
    return float(_STEPS[at] + np.clip((before - after) / (2 * curvature), -1.0, 1.0))
