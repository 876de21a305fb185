"""A lane beside the map's drive: the left and the right region of a frame show different places there.

Both cameras face the same way. To a vehicle that is further left than the one that made the map, what stands on the
left is nearer, so that the left region shows what the map's camera saw from further back, and the right region what it
saw from further ahead. The paper matches both regions of a frame together. In a lane whose distance from the map's
drive is known (`[rig] left_reverse_m`, `left_forward_m`), the left region of one frame and the right one of some frames
before show the same place, and are matched together. On five simulated roads, 3.5 m beside the map's drive, uniqueness
so rose from 1.22 to 1.29 at night, and from 1.32 to 1.45 at dusk. On the recorded drive ardupilot_a971, 245 of 445
sequence matches were then sharp enough for a position, and 146 of 435 without.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.reference_map import MapSet, Ranges

PARALLAX = 2.4
"""Meters by which the left region shows a place later for each meter to the left of the map's drive: 2.4 to 2.6 over
the lights and roads that were tried."""


class Lags(NamedTuple):
    """Places, an even number, by which the left region shows a place later than the right one; below 0: earlier.

    alike, opposed: on drives of the map whose camera faced as this one does, and on those where it faced back.
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
    """Of the lanes that [rig] has. spacing_m: of the map's places."""
    # With views alike, regions in the same order are seen on the way out, with opposed ones on the way back.
    lanes_m = config.rig.left_forward_m, config.rig.left_reverse_m
    alike, opposed = (2 * round(PARALLAX * lane_m / spacing_m / 2) for lane_m in lanes_m)
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
    faces_alike = [map_set.index.view(number) == view for number, _, _ in pieces]
    of_pieces = [lags.alike if is_alike else lags.opposed for is_alike in faces_alike]
    used, newest_first = sorted({lag for lag in of_pieces if lag}), ring[::-1]
    paired = [_paired(newest_first, now, _rows_before(since, now, lag), lag) for lag in (0, *used)]
    found = map_set.costs(np.concatenate(paired), ranges)
    by_lag = found.reshape(1 + len(used), len(ages), *found.shape[1:])
    costs: NDArray[np.int32] = by_lag[0]
    at = 0
    for (_, start, end), is_alike, lag in zip(pieces, faces_alike, of_pieces, strict=True):
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
