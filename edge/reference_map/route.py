"""Positions along the map's drives: in local metres, and at an offset from a place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from edge.reference_map.store import ReferenceMap


@dataclass(frozen=True)
class Position:
    """WGS 84 position in degrees, and the heading (clockwise from north) of the drive that made the map there."""

    lat_deg: float
    lon_deg: float
    heading_deg: float


@dataclass(frozen=True)
class _Drive:
    """One segment: how far it goes along its route_m, and its places with a position, in their order."""

    from_m: float
    to_m: float
    route_m: NDArray[np.float64]
    lat_deg: NDArray[np.float64]
    lon_deg: NDArray[np.float64]
    heading_deg: NDArray[np.float64]


class Route:
    """The drives of a map as lines on the ground."""

    def __init__(self, reference_map: ReferenceMap) -> None:
        places = reference_map.places
        self._places = places
        self.route_m: NDArray[np.float64] = np.ascontiguousarray(places["route_m"])
        self.segment_of = np.repeat(
            np.arange(len(reference_map.header.segments), dtype=np.int32),
            [segment.end - segment.start for segment in reference_map.header.segments],
        )
        self.east_north_m = east_north(places["lat_deg"], places["lon_deg"])
        self._origin = first_known(places["lat_deg"], places["lon_deg"])
        self._drives: dict[int, _Drive] = {}  # those that have been asked for

    def east_north(self, lat_deg: float, lon_deg: float) -> NDArray[np.float64]:
        """A position in the metres of `east_north_m`, (2,); NaN where no place of the map has a position."""
        if self._origin is None:
            return np.full(2, np.nan)
        east, north, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, *self._origin, 0.0)
        return np.array([east, north])

    def reaches(self, place: int, along_m: float) -> bool:
        """Whether the drive of `place` goes as far, and begins as early, as `along_m` of its route_m."""
        drive = self._drive_of(place)
        return drive.from_m <= along_m <= drive.to_m

    def position(self, place: int, offset_m: float) -> Position | None:
        """The position `offset_m` further along the drive than `place` (negative: before it), None where unknown.

        Positions between places are interpolated; beyond the ends of a drive there is only its last place.
        """
        record = self._places[place]
        if math.isnan(record["lat_deg"]):
            return None
        if offset_m == 0 or math.isnan(record["route_m"]):
            return Position(float(record["lat_deg"]), float(record["lon_deg"]), float(record["heading_deg"]))
        drive = self._drive_of(place)
        target_m = float(record["route_m"]) + offset_m
        after = int(np.searchsorted(drive.route_m, target_m).clip(1, max(1, len(drive.route_m) - 1)))
        around = drive.route_m[after - 1 : after + 1]
        nearest = after - 1 + int(np.abs(around - target_m).argmin())
        return Position(
            float(np.interp(target_m, drive.route_m, drive.lat_deg)),
            float(np.interp(target_m, drive.route_m, drive.lon_deg)),
            float(drive.heading_deg[nearest]),
        )

    def _drive_of(self, place: int) -> _Drive:
        """The drive of a place, taken out of the map once."""
        segment = int(self.segment_of[place])
        if segment not in self._drives:
            first, end = np.searchsorted(self.segment_of, [segment, segment + 1])
            drive = self._places[first:end]
            known = drive[~(np.isnan(drive["lat_deg"]) | np.isnan(drive["route_m"]))]
            columns = (np.ascontiguousarray(known[name]) for name in ("route_m", "lat_deg", "lon_deg", "heading_deg"))
            extent_m = float(np.fmin.reduce(drive["route_m"])), float(np.fmax.reduce(drive["route_m"]))
            self._drives[segment] = _Drive(*extent_m, *columns)
        return self._drives[segment]


def first_known(lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]) -> tuple[float, float] | None:
    """The first position of (N,) degrees, None if all are NaN."""
    known = np.flatnonzero(~np.isnan(lat_deg))
    return (float(lat_deg[known[0]]), float(lon_deg[known[0]])) if known.size else None


def east_north(lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres east and north of the first known position: (N,) degrees -> (N, 2), NaN where unknown."""
    origin = first_known(lat_deg, lon_deg)
    if origin is None:
        return np.full((len(lat_deg), 2), np.nan)
    east, north, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, *origin, 0.0)
    return np.column_stack([east, north])
