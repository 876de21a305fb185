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
from edge.reference_map import Drives, MapSet, Ranges
from edge.sequence import Parallax, PlaceMatch

PARALLAX_ROWS = 40
"""Rows of a line, the newest, that are matched with each region alone. Of 24 rows the best places were wrong beyond 1 m
on the far side of the lane; of 40, half of them are within 1.5 m up to 4 m from it."""
REACH = 20
"""Places by which each row of a line is moved along the map, in each direction."""

_STEPS = np.arange(-REACH, REACH + 1)  # in places


class Lags(NamedTuple):
    """Places, an even number, by which the left region shows a place later than the right one; below 0: earlier.

    alike, opposed: on drives of the map whose camera looked as this one does, and on those where it looked back.
    """

    alike: int = 0
    opposed: int = 0


NO_LAGS = Lags()


class Lanes(NamedTuple):
    """Lags, and what is needed to find rows so far apart.

    view: of the camera. driven: places, at each row of the ring or more, the oldest first.
    """

    lags: Lags
    view: str
    driven: Sequence[float]


def lags_of(config: Config, spacing_m: float) -> Lags:
    """Of the lanes that [rig] has; none where the image has no regions, or their order is not that of the rig.

    spacing_m: of the map's places.
    """
    if config.descriptor.regions != "left-right" or config.sequence.region_order != "rig":
        return NO_LAGS
    # With views alike, regions in the same order are seen on the way out, with opposed ones on the way back.
    lanes_m = config.rig.left_forward_m, config.rig.left_reverse_m
    alike, opposed = (2 * round(config.rig.parallax * lane_m / spacing_m / 2) for lane_m in lanes_m)
    return Lags(alike, opposed)


def lane_costs(
    map_set: MapSet, ring: NDArray[np.float32], ages: Sequence[int], ranges: Ranges, lanes: Lanes
) -> NDArray[np.int32]:
    """Costs (n, orders, places) of some rows of the ring against some places, as `MapSet.costs` has them.

    ring: (rows, R, D), oldest first. ages: of the n rows, in frames. Order "same" is that of the lane; for the oldest
    rows, and within half a lag of where a drive ends, it is that of one frame alone.
    """
    lags, view, driven = lanes
    since = driven[-1] - np.array(driven[: -1 - len(ring) : -1])  # places, of each row, the newest first
    now = np.array(ages)
    pieces = list(map_set.index.by_segment(ranges))
    looks_alike = [map_set.index.view(number) == view for number, _, _ in pieces]
    of_pieces = [lags.alike if is_alike else lags.opposed for is_alike in looks_alike]
    used, newest_first = sorted({lag for lag in of_pieces if lag}), ring[::-1]
    paired = [_paired(newest_first, now, _rows_before(since, now, lag), lag) for lag in (0, *used)]
    found = map_set.costs(np.concatenate(paired), ranges)
    by_lag = found.reshape(1 + len(used), len(ages), *found.shape[1:])
    costs: NDArray[np.int32] = by_lag[0]
    at = 0
    for (_, start, end), is_alike, lag in zip(pieces, looks_alike, of_pieces, strict=True):
        stop, half = at + end - start, abs(lag) // 2
        if 0 < half < end - start:
            # Half a lag ago the vehicle was further back: on the way home along the drive, at a later place.
            into, of = (slice(at + half, stop), slice(at, stop - half))[:: 1 if is_alike else -1]
            has_earlier = since[now] + abs(lag) <= since[-1]
            costs[has_earlier, 0, into] = by_lag[1 + used.index(lag)][has_earlier, 0, of]
        at = stop
    return costs


def _rows_before(since: NDArray[np.float64], ages: NDArray[np.intp], lag: int) -> NDArray[np.intp]:
    """The ages (n,) of the rows that are nearest to `lag` places before those of some ages."""
    found: NDArray[np.intp] = np.abs(since[:, np.newaxis] - since[ages] - abs(lag)).argmin(axis=0)
    return found


def _paired(
    newest_first: NDArray[np.float32], now: NDArray[np.intp], before: NDArray[np.intp], lag: int
) -> NDArray[np.float32]:
    """Rows (n, R, D), of which the region that shows a place later is of now, and the other one of before."""
    of_regions = (now, before) if lag > 0 else (before, now)
    return np.stack([newest_first[of, region] for region, of in enumerate(of_regions[: newest_first.shape[1]])], axis=1)


def parallax_of(
    match: PlaceMatch, newest: Callable[[int], NDArray[np.float32]], map_set: MapSet, drives: Drives
) -> Parallax | None:
    """Of a match; None where the map knows no meters, and of a map with a single place of the drive.

    newest: the newest so many rows of its ring (n, R, D), oldest first. Its cameras look the same way, or the two
    regions do not see the same side of the road. drives: of the same maps.
    """
    drive = drives.drive_of(match.place_index)
    (begin, stop), own = map_set.index.segment(drive), map_set.index.rows[map_set.index.map_of(match.place_index)]
    route_m, spacing_m = drives.line(drive)
    if not spacing_m > 0:
        return None
    rows = newest(PARALLAX_ROWS)
    ages = np.arange(len(rows))
    sign = 1 if match.direction == "forward" else -1
    lie_m = route_m[match.place_index - begin] - sign * np.array(match.passed[: len(rows)]) * spacing_m
    reach_m = REACH * spacing_m
    around = begin + np.searchsorted(route_m, [lie_m.min() - reach_m, lie_m.max() + reach_m])
    first, end = max(begin, own[0], int(around[0]) - 1), min(stop, own[1], int(around[1]) + 1)
    if end - first < 2:
        return None
    costs = map_set.region_costs(rows[::-1], first, end)
    return Parallax(ages, along_line(costs, lie_m, route_m[first - begin : end - begin], spacing_m, sign))


def along_line(
    costs: NDArray[np.float64], lie_m: NDArray[np.float64], route_m: NDArray[np.float64], spacing_m: float, sign: int
) -> NDArray[np.float64]:
    """Costs (2, n, 2 * REACH + 1) of each row of a line, moved along the map in the direction of travel.

    costs: (2, n, W) of the left and of the right region alone, of n frames against the places at `route_m` (W,),
    between which they are interpolated, since places need not be regularly spaced. lie_m: (n,) of the line. A step is
    spacing_m; sign: 1 if places were passed in the map's order, -1 on the way back. Beyond those places: NaN.
    """
    moved_m = lie_m[:, np.newaxis] + sign * _STEPS * spacing_m
    at = np.interp(moved_m, route_m, np.arange(len(route_m)), left=np.nan, right=np.nan)
    before = np.nan_to_num(at).astype(np.intp).clip(0, len(route_m) - 2)
    share = at - before
    here, after = (np.take_along_axis(costs, np.broadcast_to(i, (2, *i.shape)), axis=2) for i in (before, before + 1))
    found: NDArray[np.float64] = here + share * (after - here)
    return found
