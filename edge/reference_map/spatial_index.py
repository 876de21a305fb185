"""Which places a known position allows, without looking at every place: blocks of neighbors, by their bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.geodesy import apart_m, unwrapped

BLOCK_PLACES = 64
MARGIN_SHARE, MARGIN_M = 1e-3, 1.0
"""By how much the bounds of a block may look farther away than they are: they are no straight lines on the ground."""
LEAST_M_PER_DEG = 110_000.0
"""Meters in a degree of latitude; nowhere on Earth are there fewer."""
Ranges = list[tuple[int, int]]


class Bounds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Degrees between which the places lie whose position is known; `east` is over 180 across the date line."""

    south: float
    west: float
    north: float
    east: float


def bounds_of(places: NDArray[np.void]) -> Bounds | None:
    """The bounds of records of PLACE, None where no position is known."""
    known = places[~np.isnan(places["lat_deg"])]
    if not known.size:
        return None
    lat_deg, lon_deg = known["lat_deg"], unwrapped(known["lon_deg"])
    return Bounds(float(lat_deg.min()), float(lon_deg.min()), float(lat_deg.max()), float(lon_deg.max()))


class SpatialIndex:
    """The maps of a set in blocks of at most BLOCK_PLACES places, each with the bounds of its places."""

    def __init__(self, places: NDArray[np.void], maps: Sequence[tuple[int, int, Bounds | None]]) -> None:
        """places: (N,) records of PLACE. maps: places [start, end) of each map, and its bounds. 8 ms for a million.

        A block with unknown positions is allowed wherever its map is; a map without any is allowed nowhere.
        """
        starts = [np.arange(start, end, BLOCK_PLACES) for start, end, _ in maps]
        self._starts = np.concatenate(starts)
        self._ends = np.append(self._starts[1:], maps[-1][1])[: len(self._starts)]
        self._edges = _block_bounds(places, self._starts)
        of_maps = np.repeat([_edges(bounds) for _, _, bounds in maps], [*map(len, starts)], axis=0).T
        unknown = np.isnan(self._edges).any(axis=0) | np.isnan(of_maps).any(axis=0)
        self._edges[:, unknown] = of_maps[:, unknown]
        self.is_known = not np.isnan(self._edges).all()
        """Whether any place has a position."""

    def within(self, lat_deg: float, lon_deg: float, radius_m: float) -> Ranges:
        """[start, end) ranges of places that hold all places within `radius_m` of a position, and some more."""
        reach_m = radius_m * (1 + MARGIN_SHARE) + MARGIN_M
        south, _, north, _ = self._edges
        reach_deg = reach_m / LEAST_M_PER_DEG
        # A comparison with NaN is False. This one is much cheaper than the next, and excludes nearly all.
        band = np.flatnonzero((south <= lat_deg + reach_deg) & (north >= lat_deg - reach_deg))
        south, west, north, east = self._edges[:, band]
        lon_near_deg = lon_deg + 360 * np.round(((west + east) / 2 - lon_deg) / 360)
        nearest_lat_deg, nearest_lon_deg = np.clip(lat_deg, south, north), np.clip(lon_near_deg, west, east)
        # No meridian within reach is further away than reach_deg where meridians are closest, nearer to the pole.
        closest = max(0.0, math.cos(math.radians(min(90.0, abs(lat_deg) + reach_deg))))
        beside = np.flatnonzero(np.abs(nearest_lon_deg - lon_near_deg) * closest <= reach_deg)
        away_m = apart_m(lat_deg, lon_near_deg[beside], nearest_lat_deg[beside], nearest_lon_deg[beside])
        return self._merged(band[beside[away_m <= reach_m]])

    def _merged(self, blocks: NDArray[np.intp]) -> Ranges:
        """Runs of blocks as ranges of places."""
        out: Ranges = []
        for start, end in zip(self._starts[blocks].tolist(), self._ends[blocks].tolist(), strict=True):
            if out and out[-1][1] == start:
                out[-1] = (out[-1][0], end)
            else:
                out.append((start, end))
        return out


def _block_bounds(places: NDArray[np.void], starts: NDArray[np.intp]) -> NDArray[np.float64]:
    """South, west, north and east (4, blocks) in degrees; NaN where a place of the block has no position."""
    lat_deg, lon_deg = np.ascontiguousarray(places["lat_deg"]), np.ascontiguousarray(places["lon_deg"])
    edges = _extremes(lat_deg, lon_deg, starts)
    across = edges[3] - edges[1] > 180
    if across.any():
        edges[:, across] = _extremes(lat_deg, np.where(lon_deg < 0, lon_deg + 360, lon_deg), starts)[:, across]
    return edges


def _extremes(
    lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64], starts: NDArray[np.intp]
) -> NDArray[np.float64]:
    lowest = [np.minimum.reduceat(degrees, starts) for degrees in (lat_deg, lon_deg)]
    return np.stack([*lowest, *(np.maximum.reduceat(degrees, starts) for degrees in (lat_deg, lon_deg))])


def _edges(bounds: Bounds | None) -> tuple[float, float, float, float]:
    return (bounds.south, bounds.west, bounds.north, bounds.east) if bounds else (math.nan,) * 4
