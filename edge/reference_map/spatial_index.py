"""Which places a known position allows, without looking at every place: blocks of neighbours, and maps, by bounds."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np
import pymap3d
from numpy.typing import NDArray

from edge.reference_map.extent import Bounds

BLOCK = 64
STEEPEST = 2.0  # places a frame, above the steepest slope of the default limits
MARGIN_SHARE, MARGIN_M = 1e-3, 1.0
"""So much nearer than it seems may a map be: its bounds are no straight lines on the ground."""
Ranges = list[tuple[int, int]]


class SpatialIndex:
    """The map in blocks of BLOCK places, each with the rectangle that its places lie in."""

    def __init__(self, east_north_m: NDArray[np.float64]) -> None:
        """east_north_m: (N, 2); NaN where unknown. A block with unknown places is allowed everywhere."""
        self._places = len(east_north_m)
        starts = np.arange(0, self._places, BLOCK)
        # A comparison with NaN is False below, so bounds that are NaN exclude nothing.
        self._low_m = np.minimum.reduceat(east_north_m, starts, axis=0)
        self._high_m = np.maximum.reduceat(east_north_m, starts, axis=0)

    def within(self, east_north_m: NDArray[np.float64], radius_m: float) -> Ranges:
        """[start, end) ranges of places that hold all places within `radius_m` of a point (2,), and some more."""
        outside_m = np.maximum(self._low_m - east_north_m, east_north_m - self._high_m).clip(min=0)
        far = np.square(outside_m).sum(axis=1) > radius_m**2
        return self._merged(~far)

    def _merged(self, wanted: NDArray[np.bool_]) -> Ranges:
        """Runs of wanted blocks as ranges of places."""
        edges = np.flatnonzero(np.diff(wanted.astype(np.int8), prepend=0, append=0))
        return [
            (int(start) * BLOCK, min(int(end) * BLOCK, self._places))
            for start, end in zip(edges[::2], edges[1::2], strict=True)
        ]


class MapBounds:
    """The bounds of many maps, from their headers."""

    def __init__(self, bounds: Sequence[Bounds | None]) -> None:
        """None of a map without positions, which no position allows."""
        nowhere = (math.nan,) * 4
        edges = [(one.south, one.west, one.north, one.east) if one else nowhere for one in bounds]
        self._south, self._west, self._north, self._east = np.array(edges).T
        self.are_known = any(one is not None for one in bounds)

    def within(self, lat_deg: float, lon_deg: float, radius_m: float) -> NDArray[np.intp]:
        """The maps of which some place may lie within `radius_m`."""
        middle_deg = (self._west + self._east) / 2
        lon_deg = lon_deg + 360 * np.round((middle_deg - lon_deg) / 360)
        nearest = np.clip(lat_deg, self._south, self._north), np.clip(lon_deg, self._west, self._east)
        near = apart_m(lat_deg, lon_deg, *nearest) <= radius_m * (1 + MARGIN_SHARE) + MARGIN_M
        return np.flatnonzero(near)

    def inside(self, lat_deg: float, lon_deg: float, radius_m: float) -> NDArray[np.intp]:
        """The maps all places of which lie within `radius_m`, as far as their bounds show it."""
        corners = [(lat, lon) for lat in (self._south, self._north) for lon in (self._west, self._east)]
        furthest_m = np.max([apart_m(lat_deg, lon_deg, *corner) for corner in corners], axis=0)
        return np.flatnonzero(furthest_m <= radius_m)


def apart_m(
    lat_deg: float, lon_deg: float | NDArray[np.float64], lats_deg: NDArray[np.float64], lons_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Metres from a position to others (n,), in a straight line."""
    east, north, up = pymap3d.geodetic2enu(lats_deg, lons_deg, 0.0, lat_deg, lon_deg, 0.0)
    # With `up`, since on the other side of the earth the other two are small again.
    metres: NDArray[np.float64] = np.sqrt(np.square(east) + np.square(north) + np.square(up))
    return metres


def widened(ranges: Ranges, sequence_length: int, breaks: Sequence[int]) -> Ranges:
    """The ranges with the places that a sequence ending in them may have passed before; merged where they touch.

    breaks: 0, the number of places, and in between what no sequence runs across.
    """
    margin = math.ceil(STEEPEST * sequence_length)
    out: Ranges = []
    for start, end in ranges:
        floor, ceiling = breaks[bisect_right(breaks, start) - 1], breaks[bisect_left(breaks, end)]
        first, last = max(floor, start - margin), min(ceiling, end + margin)
        if out and first <= out[-1][1]:
            out[-1] = (out[-1][0], last)
        else:
            out.append((first, last))
    return out
