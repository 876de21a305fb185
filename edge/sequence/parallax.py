"""How far a vehicle is beside the map's drive: its left and its right region match different places.

Both cameras look the same way. To a vehicle that is further left than the one that made the map, what stands on the
left is nearer, so that the left region shows what the map's camera saw from further back, and the right region what it
saw from further ahead. The places of the two regions are then apart by a distance that is proportional to how far the
vehicle is beside the map's drive; [rig] parallax is the factor, which `lookback calibrate` measures. In the simulator
it is 2.4 to 2.6 m for each meter, over the lights and roads that were tried: a few meters show as several places.

The paper matches both regions of a frame together; so does this where no parallax was measured. In a lane whose
distance from the map's drive is known, the left region of one frame and the right one of some frames before show the
same place, and are matched together (`lane_costs`). On five simulated roads, 3.5 m beside the map's drive, uniqueness
so rose from 1.22 to 1.29 at night, and from 1.32 to 1.45 at dusk. The line that is found is matched again with each
region alone, moved along the map (`parallax_of`): `edge.localization.region_lines` makes of that how far the vehicle is
beside its lane.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.reference_map import MapSet, Ranges
from edge.sequence import Parallax, PlaceMatch

PARALLAX_ROWS = 40
"""Rows of a line, the newest, that are matched with each region alone. Of 24 rows the best places were wrong beyond 1 m
on the far side of the lane; of 40, half of them are within 1.5 m up to 4 m from it."""
REACH = 20
"""Places by which each row of a line is moved along the map, in each direction."""

_STEPS = np.arange(-REACH, REACH + 1)


class Lags(NamedTuple):
    """Frames, an even number, by which the left region shows a place later than the right one; below 0: earlier.

    alike, opposed: on drives of the map whose camera looked as this one does, and on those where it looked back.
    """

    alike: int = 0
    opposed: int = 0


NO_LAGS = Lags()


def lags_of(config: Config) -> Lags:
    """Of the lanes that [rig] has; none where the image has no regions, or their order is not that of the rig."""
    if config.descriptor.regions != "left-right" or config.sequence.region_order != "rig":
        return NO_LAGS
    # With views alike, regions in the same order are seen on the way out, with opposed ones on the way back.
    lanes_m = config.rig.left_forward_m, config.rig.left_reverse_m
    alike, opposed = (2 * round(config.rig.parallax * lane_m / config.sampling.spacing_m / 2) for lane_m in lanes_m)
    return Lags(alike, opposed)


def lane_costs(
    map_set: MapSet, ring: NDArray[np.float32], ages: Sequence[int], ranges: Ranges, lags: Lags, view: str
) -> NDArray[np.int32]:
    """Costs (n, orders, places) of some rows of the ring against some places, as `MapSet.costs` has them.

    ring: (rows, R, D), oldest first. ages: of the n rows, in frames. view: of the camera. Order "same" is that of the
    lane; for the oldest rows, and within half a lag of where a drive ends, it is that of one frame alone.
    """
    pieces = list(map_set.index.by_segment(ranges))
    looks_alike = [map_set.index.view(number) == view for number, _, _ in pieces]
    of_pieces = [lags.alike if is_alike else lags.opposed for is_alike in looks_alike]
    used, newest_first = sorted({lag for lag in of_pieces if lag}), ring[::-1]
    found = map_set.costs(np.concatenate([_paired(newest_first, ages, lag) for lag in (0, *used)]), ranges)
    by_lag = found.reshape(1 + len(used), len(ages), *found.shape[1:])
    costs: NDArray[np.int32] = by_lag[0]
    at = 0
    for (_, start, end), is_alike, lag in zip(pieces, looks_alike, of_pieces, strict=True):
        stop, half = at + end - start, abs(lag) // 2
        if 0 < half < end - start:
            # Half a lag ago the vehicle was further back: on the way home along the drive, at a later place.
            into, of = (slice(at + half, stop), slice(at, stop - half))[:: 1 if is_alike else -1]
            has_earlier = np.array(ages) + abs(lag) < len(ring)
            costs[has_earlier, 0, into] = by_lag[1 + used.index(lag)][has_earlier, 0, of]
        at = stop
    return costs


def _paired(newest_first: NDArray[np.float32], ages: Sequence[int], lag: int) -> NDArray[np.float32]:
    """Rows (n, R, D) of some ages, one of whose regions is of `lag` frames before, if there were so many."""
    now = np.array(ages)
    before = np.minimum(now + abs(lag), len(newest_first) - 1)
    of_regions = (now, before) if lag > 0 else (before, now)
    return np.stack([newest_first[of, region] for region, of in enumerate(of_regions[: newest_first.shape[1]])], axis=1)


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
