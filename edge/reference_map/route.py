"""Positions along the map's drives: in local metres, and at an offset from a place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pymap3d
from numpy.typing import NDArray

if TYPE_CHECKING:
    from edge.reference_map.map_set import MapSet

BEYOND = 1024
"""Places of a drive that are looked at beyond the borders of a tile: more than any line is long."""
KEPT_DRIVES = 16


@dataclass(frozen=True)
class Position:
    """WGS 84 position in degrees, and the heading (clockwise from north) of the drive that made the map there."""

    lat_deg: float
    lon_deg: float
    heading_deg: float


@dataclass(frozen=True)
class Drive:
    """What is known of a segment around a place: how far it goes along its route_m, and how far places are apart.

    NaN where the map knows no metres. segment: its number. Arrays: of the places with a position, in their order.
    """

    segment: int
    places: int
    from_m: float
    to_m: float
    spacing_m: float
    route_m: NDArray[np.float64]
    lat_deg: NDArray[np.float64]
    lon_deg: NDArray[np.float64]
    heading_deg: NDArray[np.float64]


class Route:
    """The drives of an atlas as lines on the ground."""

    def __init__(self, atlas: MapSet) -> None:
        self._atlas = atlas
        self._drives: dict[tuple[int, int], Drive] = {}  # those asked for, the one of longest ago first

    def route_m(self, place: int) -> float:
        """Metres along the place's drive, NaN where unknown or where its map cannot be opened."""
        record = self._record(place)
        return math.nan if record is None else float(record["route_m"])

    def map_row(self, place: int) -> int | None:
        """The row of the feed that a place was made of; None where its map cannot be opened."""
        record = self._record(place)
        return None if record is None else int(record["row"])

    def reaches(self, place: int, along_m: float) -> bool:
        """Whether the drive of `place` goes as far, and begins as early, as `along_m` of its route_m."""
        drive = self.drive(place)
        return drive is not None and drive.from_m <= along_m <= drive.to_m

    def position(self, place: int, offset_m: float) -> Position | None:
        """The position `offset_m` further along the drive than `place` (negative: before it), None where unknown.

        Positions between places are interpolated; beyond the ends of a drive there is only its last place.
        """
        record = self._record(place)
        if record is None or math.isnan(record["lat_deg"]):
            return None
        if offset_m == 0 or math.isnan(record["route_m"]):
            return Position(float(record["lat_deg"]), float(record["lon_deg"]), float(record["heading_deg"]))
        drive = self.drive(place)
        if drive is None:
            return None
        target_m = float(record["route_m"]) + offset_m
        after = int(np.searchsorted(drive.route_m, target_m).clip(1, max(1, len(drive.route_m) - 1)))
        around = drive.route_m[after - 1 : after + 1]
        nearest = after - 1 + int(np.abs(around - target_m).argmin())
        return Position(
            float(np.interp(target_m, drive.route_m, drive.lat_deg)),
            float(np.interp(target_m, drive.route_m, drive.lon_deg)),
            float(drive.heading_deg[nearest]),
        )

    def drive(self, place: int) -> Drive | None:
        """The drive of a place as far as its map goes, and well into the tiles beside it; None if it cannot be read."""
        numbering = self._atlas.numbering
        key = numbering.segment_of(place), numbering.map_of(place)
        drive = self._drives.pop(key, None) or self._take_out(place, *key)
        if drive is not None:
            self._drives[key] = drive
        if len(self._drives) > KEPT_DRIVES:
            self._drives.pop(next(iter(self._drives)))
        return drive

    def _take_out(self, place: int, segment: int, index: int) -> Drive | None:
        numbering = self._atlas.numbering
        first, last = numbering.starts[index : index + 2]
        begin, end = numbering.segment(segment)
        around = [(max(begin, first - BEYOND), min(end, last + BEYOND))]
        found = next((one for one in self._atlas.opened(around) or [] if one[0] <= place < one[1]), None)
        if found is None:
            return None
        records = self._atlas.records(*found)
        known = records[~(np.isnan(records["lat_deg"]) | np.isnan(records["route_m"]))]
        columns = (np.ascontiguousarray(known[name]) for name in ("route_m", "lat_deg", "lon_deg", "heading_deg"))
        route_m = records["route_m"]
        extent_m = float(np.fmin.reduce(route_m)), float(np.fmax.reduce(route_m))
        steps_m = np.abs(np.diff(route_m))
        steps_m = steps_m[~np.isnan(steps_m)]
        spacing_m = float(np.median(steps_m)) if steps_m.size else math.nan
        return Drive(segment, len(records), *extent_m, spacing_m, *columns)

    def _record(self, place: int) -> np.void | None:
        if not self._atlas.opened([(place, place + 1)]):
            return None
        record: np.void = self._atlas.records(place, place + 1)[0]
        return record


def first_known(lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]) -> tuple[float, float] | None:
    """The first position of (N,) degrees, None if all are NaN."""
    known = np.flatnonzero(~np.isnan(lat_deg))
    return (float(lat_deg[known[0]]), float(lon_deg[known[0]])) if known.size else None


def east_north(
    lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64], origin: tuple[float, float] | None = None
) -> NDArray[np.float64]:
    """Metres east and north of an origin, else of the first known position: (N,) degrees -> (N, 2), NaN if unknown."""
    origin = origin or first_known(lat_deg, lon_deg)
    if origin is None:
        return np.full((len(lat_deg), 2), np.nan)
    east, north, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, *origin, 0.0)
    return np.column_stack([east, north])


def east_north_of(lat_deg: float, lon_deg: float, origin: tuple[float, float]) -> NDArray[np.float64]:
    """One position in metres east and north of an origin, (2,)."""
    east, north, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, *origin, 0.0)
    return np.array([east, north])
