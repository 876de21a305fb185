"""How far a vehicle is beside the map's drive: its left and its right region match different places.

Both cameras look the same way. To a vehicle that is further left than the one that made the map, what stands on the
left is nearer, so that the left region shows what the map's camera saw from further back, and the right region what it
saw from further ahead. The places of the two regions are then apart by a distance that is proportional to how far the
vehicle is beside the map's drive; [rig] parallax is the factor, which `lookback calibrate` measures. In the simulator
it is 2.4 to 2.6 m for each meter, over the lights and roads that were tried: a few meters show as several places.

The paper matches both regions together. Here the line that it found is matched again with each region alone, moved
along the map. Where the vehicle was at each frame of the line, `edge.localization.region_lines` makes of that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from edge.reference_map import MapSet
from edge.sequence import Parallax, PlaceMatch

PARALLAX_ROWS = 40
"""Rows of a line, the newest, that are matched with each region alone. Of 24 rows the best places were wrong beyond 1 m
on the far side of the lane; of 40, half of them are within 1.5 m up to 4 m from it."""
REACH = 20
"""Places by which each row of a line is moved along the map, in each direction."""

_STEPS = np.arange(-REACH, REACH + 1)


def parallax_of(match: PlaceMatch, newest: Callable[[int], NDArray[np.float32]], map_set: MapSet) -> Parallax | None:
    """Of a match; None where its line is beyond the map.

    newest: the newest so many rows of its ring (n, R, D), oldest first. Its cameras look the same way, or the two
    regions do not see the same side of the road.
    """
    rows = newest(PARALLAX_ROWS)
    ages = np.flatnonzero(~np.isnan(rows[::-1, 0, 0]))  # a place without a frame is NaN throughout
    sign = 1 if match.direction == "forward" else -1
    places = rows_of_line(match.place_index, match.slope, sign, ages)
    segment = map_set.index.segment(map_set.index.segment_of(match.place_index))
    own = map_set.index.rows[map_set.index.map_of(match.place_index)]
    first = max(segment[0], own[0], int(places.min()) - REACH)
    end = min(segment[1], own[1], int(places.max()) + REACH + 1)
    if first >= end:
        return None
    return Parallax(ages, along_line(map_set.region_costs(rows[::-1][ages], first, end), places, first, sign))


def rows_of_line(place: int, slope: float, sign: int, rows: Sequence[int] | NDArray[np.intp]) -> NDArray[np.intp]:
    """The places (n,) of a line that ends at a place, at some ages in frames; sign: -1 for the way back."""
    return place - sign * np.rint(np.asarray(rows) * slope).astype(np.intp)


def along_line(costs: NDArray[np.float64], places: NDArray[np.intp], first: int, sign: int) -> NDArray[np.float64]:
    """Costs (2, n, 2 * REACH + 1) of each row of a line, moved along the map in the direction of travel.

    costs: (2, n, W) of the left and of the right region alone, of n frames against the places from `first` on. places:
    (n,) of the line. sign: 1 if places were passed in the map's order, -1 on the way back. Beyond those places: NaN.
    """
    moved = places[:, np.newaxis] - first + sign * _STEPS
    is_known = (moved >= 0) & (moved < costs.shape[2])
    at = np.broadcast_to(moved.clip(0, costs.shape[2] - 1), (2, *moved.shape))
    found: NDArray[np.float64] = np.where(is_known, np.take_along_axis(costs, at, axis=2), np.nan)
    return found
