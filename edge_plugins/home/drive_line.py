"""The positions of one drive of a map, as a line on the ground, and fewer points of such a line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.geodesy import Origin, east_north, first_known
from edge.reference_map import MapSet, sigmas_m

MOVED_M = 0.01
"""Places nearer to the one before are the same position."""


@dataclass(frozen=True)
class DriveLine:
    """The places of a drive that have a position, in its order.

    number, name: of the drive, for people. points_m: (N, 2) meters east and north of `origin`. along_m: (N,) meters
    along them. driven_m, heading_deg, alt_m: (N,) by the odometer of the drive, of the vehicle, and above sea level;
    NaN where the map has none. sigma_m: (N,) one standard deviation of each position, assumed where the map has none.
    short_m: from where its recording began, of which an interruption made several drives, to its own start.
    """

    number: int
    name: str
    origin: Origin
    points_m: NDArray[np.float64]
    along_m: NDArray[np.float64]
    driven_m: NDArray[np.float64]
    heading_deg: NDArray[np.float64]
    alt_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    short_m: float


def drive_lines(maps: MapSet) -> list[DriveLine]:
    """All drives that have positions, in meters from one origin; MapError where none has."""
    origin, lines = first_known(maps.places["lat_deg"], maps.places["lon_deg"]), []
    for number, (start, end, _) in enumerate(_drives(maps), start=1):
        if np.count_nonzero(~np.isnan(maps.places["lat_deg"][start:end])) > 1:
            lines.append(drive_line(maps, number, origin))
    return lines or [drive_line(maps)]


def drive_line(maps: MapSet, number: int | None = None, origin: Origin | None = None) -> DriveLine:
    """A drive by its number, counted from 1 through all maps, or the newest: the last of the map written last.

    MapError where there is no such drive, it has fewer than two positions, or their file is damaged.
    """
    drives = _drives(maps)
    if not drives or not (number is None or 1 <= number <= len(drives)):
        raise MapError(f"{maps.path}: no drive {1 if number is None else number}; it has {len(drives)}")
    index = _newest(maps, drives) if number is None else number - 1
    start, end, source = drives[index]
    maps.check_places([(start, end)])
    places = maps.places[start:end]
    places = places[~np.isnan(places["lat_deg"])]
    origin = origin or first_known(places["lat_deg"], places["lon_deg"])
    name = f"drive {index + 1} ({source})"
    if origin is None or len(places) < 2:
        raise MapError(f"{maps.path}: {name} has {len(places)} positions; a route needs a map made with positions")
    points_m = east_north(places["lat_deg"], places["lon_deg"], origin)
    moves = np.r_[True, np.hypot(*np.diff(points_m, axis=0).T) > MOVED_M]
    places, points_m = places[moves], points_m[moves]
    of_map = maps.index.map_of(start)
    began = next(first for first, _, of in drives if (maps.index.map_of(first), of) == (of_map, source))
    began_m = east_north(maps.places["lat_deg"][[began]], maps.places["lon_deg"][[began]], origin)[0]
    short_m = float(np.hypot(*np.nan_to_num(began_m - points_m[0])))
    driven_m, heading_deg, alt_m = (np.ascontiguousarray(places[key]) for key in ("route_m", "heading_deg", "alt_m"))
    columns = driven_m, heading_deg, alt_m, sigmas_m(places)
    return DriveLine(index + 1, name, origin, points_m, along(points_m), *columns, short_m)


def along(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Meters (N,) along a line (N, 2)."""
    legs_m = np.diff(points_m, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.hypot(legs_m[:, 0], legs_m[:, 1]))])


def _drives(maps: MapSet) -> list[tuple[int, int, str]]:
    """Places [start, end) of each drive, and what it was recorded as.

    Segments that follow each other in one recording are one drive, which was interrupted.
    """
    drives: list[tuple[int, int, str]] = []
    route_m = maps.places["route_m"]
    for start, end in maps.index.segments:
        source = _source(maps, start)
        if drives:
            before, last, its_source = drives[-1]
            is_same = maps.index.map_of(before) == maps.index.map_of(start) and source == its_source
            if is_same and route_m[start] >= route_m[last - 1]:
                drives[-1] = before, end, source
                continue
        drives.append((start, end, source))
    return drives


def _newest(maps: MapSet, drives: list[tuple[int, int, str]]) -> int:
    """The last drive of the map whose header was written last; one that is still being made has none yet."""
    written_s = []
    for one in maps.maps:
        header = one.path / "map.json"
        written_s.append(header.stat().st_mtime if header.exists() else math.inf)
    return max(range(len(drives)), key=lambda drive: (written_s[maps.index.map_of(drives[drive][1] - 1)], drive))


def _source(maps: MapSet, place: int) -> str:
    map_index = maps.index.map_of(place)
    row = place - maps.index.starts[map_index]
    return next(part.source for part in maps.maps[map_index].header.segments if part.start <= row < part.end)


def simplified(points_m: NDArray[np.float64], tolerance_m: float) -> NDArray[np.int64]:
    """Indices of the points (N, 2) to keep, in order, both ends among them (Douglas and Peucker, 1973).

    No other point is further than the tolerance from the line through those that are kept.
    """
    keep = np.zeros(len(points_m), dtype=bool)
    keep[[0, -1]] = True
    pieces = [(0, len(points_m) - 1)]
    while pieces:
        first, last = pieces.pop()
        if last - first < 2:
            continue
        away_m = distances_m(points_m[first + 1 : last], points_m[first], points_m[last])
        furthest = int(away_m.argmax())
        if away_m[furthest] > tolerance_m:
            middle = first + 1 + furthest
            keep[middle] = True
            pieces += [(first, middle), (middle, last)]
    return np.flatnonzero(keep)


def distances_m(
    points_m: NDArray[np.float64], start_m: NDArray[np.float64], end_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance (N,) of points (N, 2) from a straight piece; not from the line that goes on beyond its ends."""
    away_m = points_m - nearest_on(points_m, start_m, end_m)
    return np.hypot(away_m[:, 0], away_m[:, 1])


def nearest_on(
    points_m: NDArray[np.float64], starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The nearest point of a straight piece to a point; arrays (..., 2), which are broadcast."""
    along_m = ends_m - starts_m
    length_sq = np.maximum((along_m**2).sum(axis=-1), 1e-12)
    share = (((points_m - starts_m) * along_m).sum(axis=-1) / length_sq).clip(0.0, 1.0)
    nearest: NDArray[np.float64] = starts_m + share[..., None] * along_m
    return nearest
