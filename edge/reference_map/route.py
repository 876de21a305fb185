"""Positions along the map's drives: at a place, and at an offset from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north, east_north_of, first_known, unwrapped, wrapped
from edge.reference_map.gps_motion import crept_m2
from edge.reference_map.map_set import MapSet
from edge.reference_map.place_index import PlaceIndex
from edge.reference_map.place_records import ASSUMED_SIGMA_M, sigmas_m
from edge.reference_map.store import MapHeader

BEYOND = 1024
"""Places of a drive that are read beyond the borders of a tile: more than any sequence is long."""
KEPT_DRIVES = 16
GAP = 2.0
"""Steps of more than so many times the median are gaps: places that were not mapped, for want of a picture."""
UNKNOWN_WHOLE_M = 8.0, 4.5
"""One standard deviation, along-track and cross-track, of what all positions of a drive are off by where nothing says
how well pictures and positions were laid over each other: a video that is 2 s off at 15 m/s is 30 m off, four of them.
With more, positions would not be certain enough (10 m) for an autopilot that drifts."""
NO_LAP_M = 1e12
"""Meters after which a drive that is not closed would go on at its beginning: never."""


@dataclass(frozen=True)
class Position:
    """WGS 84 position in degrees, and the heading (clockwise from north) of the drive that made the map there.

    heading_deg: None where the map does not know it, and there is no drive from which to compute it. sigma_m: one
    standard deviation of the map's distance from the truth there.
    """

    lat_deg: float
    lon_deg: float
    heading_deg: float | None
    sigma_m: float = ASSUMED_SIGMA_M


@dataclass(frozen=True)
class MapDrive:
    """What is known of a segment around a place: how far it goes along its route_m, and how far places are apart.

    NaN where the map knows no meters. segment: its number. recording: that it comes from, see `PlaceIndex`. checked_m:
    how far its positions lie apart, if they are known to have moved as the vehicle did; else 0. whole_sigma_m:
    along-track and cross-track, of what all its positions are off by together. Arrays: of the places with a position,
    in their order; lon_deg has no jump at 180 degrees, heading_deg is the course where the map has none. crept_m2: see
    `gps_motion`.
    """

    segment: int
    recording: str
    checked_m: float
    whole_sigma_m: tuple[float, float]
    places: int
    from_m: float
    to_m: float
    spacing_m: float
    route_m: NDArray[np.float64]
    lat_deg: NDArray[np.float64]
    lon_deg: NDArray[np.float64]
    heading_deg: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    crept_m2: NDArray[np.float64]

    def crept_at(self, along_m: float) -> float:
        """How far its positions have crept up to some meters of its route_m: a variance, square meters."""
        return float(np.interp(along_m, self.route_m, self.crept_m2)) if self.route_m.size else 0.0


@runtime_checkable
class MapPlaces(Protocol):
    """A set of maps, or what a recorded drive has of one."""

    @property
    def places(self) -> NDArray[np.void]:
        """(N,) records of PLACE."""

    @property
    def headers(self) -> tuple[MapHeader, ...]:
        """Of its maps, in their order."""

    @property
    def index(self) -> PlaceIndex:
        """Which map, row and segment a place belongs to."""


class Route:
    """The drives of a set of maps as lines on the ground."""

    def __init__(self, map_set: MapPlaces) -> None:
        self._places, self._index = map_set.places, map_set.index
        self._drives: dict[tuple[int, int], MapDrive] = {}  # those asked for, the one of longest ago first

    def grow(self, map_set: MapPlaces) -> None:
        """Follow a set from now on that has further places after those of the last one."""
        self._places, self._index = map_set.places, map_set.index
        self._drives.clear()

    def route_m(self, place_index: int) -> float:
        """Meters along the place's drive, NaN where unknown."""
        return float(self._places["route_m"][place_index])

    def map_row(self, place_index: int) -> int:
        """The row of the feed that a place was built from."""
        return int(self._places["row"][place_index])

    def faces_back(self, place_index: int) -> bool:
        """Whether the camera of a place faced back along its drive."""
        return self._index.view(self._index.segment_of(place_index)) == "rear"

    def reaches(self, place_index: int, along_m: float) -> bool:
        """Whether the drive of a place goes as far, and begins as early, as `along_m` of its route_m."""
        drive = self.drive(place_index)
        return drive.from_m <= along_m <= drive.to_m

    def position(self, place_index: int, offset_m: float) -> Position | None:
        """The position `offset_m` further along the drive than a place (negative: before it), None where unknown.

        Positions between places are interpolated; beyond the ends of a drive there is only its last place.
        """
        record = self._places[place_index]
        if math.isnan(record["lat_deg"]):
            return None
        sigma_m = float(np.nan_to_num(record["position_sigma_m"], nan=ASSUMED_SIGMA_M))
        knows_heading, knows_route = not math.isnan(record["heading_deg"]), not math.isnan(record["route_m"])
        if knows_heading and (offset_m == 0 or not knows_route):
            return Position(float(record["lat_deg"]), float(record["lon_deg"]), float(record["heading_deg"]), sigma_m)
        if not knows_route:
            return Position(float(record["lat_deg"]), float(record["lon_deg"]), None, sigma_m)
        drive = self.drive(place_index)
        target_m = float(record["route_m"]) + offset_m
        after = int(np.searchsorted(drive.route_m, target_m).clip(1, max(1, len(drive.route_m) - 1)))
        around = drive.route_m[after - 1 : after + 1]
        heading_deg = float(drive.heading_deg[after - 1 + int(np.abs(around - target_m).argmin())])
        return Position(
            float(np.interp(target_m, drive.route_m, drive.lat_deg)),
            wrapped(float(np.interp(target_m, drive.route_m, drive.lon_deg))),
            None if math.isnan(heading_deg) else heading_deg,
            _sigma_between_m(drive, target_m, after),
        )

    def drive(self, place_index: int) -> MapDrive:
        """The drive of a place as far as its map goes, and well into the tiles beside it."""
        key = self._index.segment_of(place_index), self._index.map_of(place_index)
        drive = self._drives.pop(key) if key in self._drives else self._extract(*key)
        self._drives[key] = drive
        if len(self._drives) > KEPT_DRIVES:
            self._drives.pop(next(iter(self._drives)))
        return drive

    def _extract(self, segment: int, map_index: int) -> MapDrive:
        first, last = self._index.rows[map_index]
        begin, end = self._index.segment(segment)
        records = self._places[max(begin, first - BEYOND) : min(end, last + BEYOND)]
        known = records[~(np.isnan(records["lat_deg"]) | np.isnan(records["route_m"]))]
        route_m, lat_deg, lon_deg, heading_deg = (
            np.ascontiguousarray(known[name]) for name in ("route_m", "lat_deg", "lon_deg", "heading_deg")
        )
        extent_m = float(np.fmin.reduce(records["route_m"])), float(np.fmax.reduce(records["route_m"]))
        if np.isnan(heading_deg).any():
            heading_deg = np.where(np.isnan(heading_deg), _course_deg(lat_deg, lon_deg), heading_deg)
        unwrapped_deg = unwrapped(lon_deg) if lon_deg.size else lon_deg
        sigma_m, points_m = sigmas_m(known), east_north(lat_deg, lon_deg)
        # An odometer that agrees shows the shape of a drive, and not when its pictures were taken.
        whole_m, is_checked = self._index.whole_sigma_m(segment), self._index.moved_as_driven(segment)
        checked_m = float(np.hypot(*points_m.T).max(initial=0.0)) if is_checked else 0.0
        whole_sigma_m = UNKNOWN_WHOLE_M if whole_m is None else (whole_m, 0.0)
        about = segment, self._index.recording(segment), checked_m, whole_sigma_m, len(records)
        lines = route_m, lat_deg, unwrapped_deg, heading_deg, sigma_m, crept_m2(points_m, sigma_m, route_m, heading_deg)
        return MapDrive(*about, *extent_m, _usual_step_m(records["route_m"]), *lines)


def _sigma_between_m(drive: MapDrive, target_m: float, after: int) -> float:
    """Of a position interpolated before the drive's place number `after`; the road may bend between places far apart.

    Then a straight line is wrong by at most the distance to the nearer place.
    """
    sigma_m = float(np.interp(target_m, drive.route_m, drive.sigma_m))
    around_m = drive.route_m[after - 1 : after + 1]
    if not around_m[0] <= target_m <= around_m[-1]:
        return sigma_m
    nearest_m = float(np.abs(around_m - target_m).min())
    return math.hypot(sigma_m, max(0.0, nearest_m - drive.spacing_m))


class Drives:
    """How far the places of a set of maps lie along their drives; a drive is a segment, by its number.

    is_metric: whether along is in meters, as every place's route_m; else each place counts as `spacing_m`.
    spacing_m: mean distance between places that follow each other.
    """

    def __init__(self, map_set: MapSet, spacing_m: float) -> None:
        """spacing_m: what a place counts as where the maps know no meters."""
        self._index, self._places, self._laps = map_set.index, map_set.places, map_set.laps
        self._route_m = map_set.places["route_m"]
        self._origin: tuple[float, float] | None = None
        self._lines: dict[int, tuple[NDArray[np.float64], float]] = {}
        self._grounds: dict[int, NDArray[np.float64]] = {}
        steps_m = [abs(self._route_m[end - 1] - self._route_m[start]) for start, end in self._index.segments]
        gaps = self._index.places - len(steps_m)
        mean_m = float(np.sum(steps_m)) / gaps if gaps else np.nan
        self.is_metric = bool(mean_m > 0 and not np.isnan(self._route_m).any())
        self.spacing_m = mean_m if self.is_metric else spacing_m

    def along_m(self, place_index: int) -> float:
        """How far along its drive a place lies."""
        if self.is_metric:
            return float(self._route_m[place_index])
        return (place_index - self._index.segment(self._index.segment_of(place_index))[0]) * self.spacing_m

    def positions_m(self, drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters east and north (n, 2) of points along some drives; NaN where the map knows no positions."""
        found = np.full((len(drives), 2), np.nan)
        if self.is_metric:
            for drive in set(drives.tolist()):
                here, route_m = drives == drive, self.line(drive)[0]
                for axis, line in enumerate(self._ground(drive)):
                    found[here, axis] = np.interp(along_m[here], route_m, line)
        return found

    def away_m(
        self, drives: NDArray[np.int64], along_m: NDArray[np.float64], from_deg: tuple[float, float]
    ) -> NDArray[np.float64]:
        """Meters (n,) from a latitude and longitude to points along some drives; NaN where the map has no positions."""
        spots_m = self.positions_m(drives, along_m)
        if self._origin is None:
            return np.full(len(drives), np.nan)
        return np.asarray(np.hypot(*(spots_m - east_north_of(*from_deg, self._origin)).T))

    def apart_m(self, place_index: int, other: int) -> float:
        """Meters between two places: along their drive where the map has no positions; NaN where that is not known."""
        drives = np.array([self.drive_of(place_index), self.drive_of(other)])
        along_m = np.array([self.along_m(place_index), self.along_m(other)])
        apart_m = float(np.hypot(*np.diff(self.positions_m(drives, along_m), axis=0)[0]))
        if math.isnan(apart_m) and drives[0] == drives[1]:
            return abs(math.remainder(along_m[1] - along_m[0], self.lap_m(int(drives[0]))))
        return apart_m

    def line(self, drive: int) -> tuple[NDArray[np.float64], float]:
        """A drive's route_m (n,), and by how much neighboring places usually differ in it; NaN if one is unknown."""
        if drive not in self._lines:
            route_m = np.ascontiguousarray(self._route_m[slice(*self._index.segment(drive))])
            self._lines[drive] = route_m, math.nan if np.isnan(route_m).any() else _usual_step_m(route_m)
        return self._lines[drive]

    def _ground(self, drive: int) -> NDArray[np.float64]:
        """A drive's meters east and north (2, n)."""
        if drive not in self._grounds:
            places = self._places[slice(*self._index.segment(drive))]
            self._origin = self._origin or first_known(places["lat_deg"], places["lon_deg"])
            east_north_m = east_north(places["lat_deg"], places["lon_deg"], self._origin)
            self._grounds[drive] = np.ascontiguousarray(east_north_m.T)
        return self._grounds[drive]

    def drive_of(self, place_index: int) -> int:
        """The number of a place's drive."""
        return self._index.segment_of(place_index)

    def extent_m(self, drive: int) -> tuple[float, float]:
        """Where the first and the last place of a drive lie along it."""
        start, end = self._index.segment(drive)
        return self.along_m(start), self.along_m(end - 1)

    def spacing_of(self, drive: int) -> float:
        """Mean distance between places of a drive that follow each other."""
        (start, end), (first_m, last_m) = self._index.segment(drive), self.extent_m(drive)
        return abs(last_m - first_m) / (end - 1 - start) if end - 1 > start else self.spacing_m

    def lap_m(self, drive: int) -> float:
        """After how much of a drive it goes on at its beginning, NO_LAP_M where it does not."""
        lap = self._laps[drive]
        start, end = self._index.segment(drive)
        if lap is None:
            return NO_LAP_M
        last = min(start + lap, end - 1)
        return abs(self.along_m(last) - self.along_m(start)) + (start + lap - last) * self.spacing_m

    def nearest(self, drive: int, along_m: float) -> int:
        """The place of a drive that is nearest to a point along it."""
        first, end = self.places_within(drive, along_m, 2 * self.spacing_m)
        start, stop = self._index.segment(drive)
        around = range(max(start, first - 1), min(stop, end + 1))
        return min(around, key=lambda place: abs(self.along_m(place) - along_m))

    def places_within(self, drive: int, along_m: float, reach_m: float) -> tuple[int, int]:
        """Places [first, end) of a drive that lie within `reach_m` of a point along it."""
        start, end = self._index.segment(drive)
        low_m, high_m = along_m - reach_m, along_m + reach_m
        if not self.is_metric:
            rows = np.ceil(low_m / self.spacing_m), np.floor(high_m / self.spacing_m) + 1
            return start + int(np.clip(rows[0], 0, end - start)), start + int(np.clip(rows[1], 0, end - start))
        first, last = np.searchsorted(self.line(drive)[0], [low_m, np.nextafter(high_m, np.inf)])
        return start + int(first), start + int(last)


def _usual_step_m(route_m: NDArray[np.float64]) -> float:
    """By how many meters places that follow each other differ on average, without gaps; NaN where that is not known.

    The average, since a line of 80 places is 79 times as long, and its middle 39 times as far back: where steps are
    uneven, as of a video, the median is 3 % more (2.06 m of 2.00), which is 2 m.
    """
    steps_m = np.abs(np.diff(route_m))
    steps_m = steps_m[~np.isnan(steps_m)]
    return float(np.mean(steps_m[steps_m <= GAP * np.median(steps_m)])) if steps_m.size else math.nan


def _course_deg(lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Course over ground (n,) from each position's neighbors, clockwise from north; NaN where they are at one spot."""
    if len(lat_deg) < 2:
        return np.full(len(lat_deg), np.nan)
    east_m, north_m = np.gradient(east_north(lat_deg, lon_deg), axis=0).T
    course_deg: NDArray[np.float64] = np.degrees(np.arctan2(east_m, north_m)) % 360
    course_deg[(east_m == 0) & (north_m == 0)] = np.nan
    return course_deg
