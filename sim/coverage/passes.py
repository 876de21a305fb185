"""Drives over a map, frame by frame: where each frame was, and whether it was believed.

The frames of a journal that were believed say where the vehicle was; those between them lie between them, and those
before the first and after the last as far away as the frames are apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.geodesy import east_north, east_north_of
from edge.journal.records import FrameUsed
from edge.reference_map import Drives, MapSet
from sim.shadow.drives import ShadowDrive

SPARE_M = 1e-6
NEAR_M = 20.0
"""Of a drive beside GPS from the map's drive: another lane, and the errors of both."""
APART_M = 1000.0
"""Segments that are closer follow each other on one drive, with an unmapped road between them."""


@dataclass(frozen=True)
class Pass:
    """The frames of one drive over one segment of the map, in order: meters along it, and which are believed."""

    segment: int
    along_m: NDArray[np.float64]
    believed: NDArray[np.bool_]

    def is_inside(self, segment: int, from_m: float, to_m: float) -> bool:
        """Whether it has a frame in [from_m, to_m) of a segment."""
        return segment == self.segment and bool(np.any((self.along_m >= from_m) & (self.along_m < to_m)))

    def until_believed_m(self, from_m: float, to_m: float) -> float:
        """Meters from where the drive enters [from_m, to_m) to the next believed frame; NaN where it does not pass."""
        inside = np.flatnonzero((self.along_m >= from_m) & (self.along_m < to_m))
        if not inside.size:
            return float("nan")
        after = np.flatnonzero(self.believed[inside[0] :])
        return abs(float(self.along_m[inside[0] + after[0]] - self.along_m[inside[0]])) if after.size else float("inf")


def passes(frames: Sequence[FrameUsed], maps: MapSet, drives: Drives) -> Iterator[Pass]:
    """The passes of one drive, in order. MapError where the maps do not have its places."""
    at = np.cumsum([1 + (frame.missed or 0) for frame in frames])
    known = [index for index, frame in enumerate(frames) if frame.accepted and frame.place is not None]
    places = [_place_index(frames[index], maps) for index in known]
    segments = [drives.drive_of(place) for place in places]
    begin = 0
    for end in range(1, len(known) + 1):
        if end < len(known) and segments[end] == segments[begin]:
            continue
        # Between two segments, half of the frames belong to each.
        first = 0 if begin == 0 else (known[begin - 1] + known[begin] + 1) // 2
        last = len(frames) if end == len(known) else (known[end - 1] + known[end] + 1) // 2
        anchors = np.array(known[begin:end])
        along_m = np.array([drives.along_m(place) for place in places[begin:end]])
        signs = [1.0 if frames[index].direction == "forward" else -1.0 for index in (known[begin], known[end - 1])]
        rows = np.arange(first, last)
        found_m = np.interp(at[rows], at[anchors], along_m)
        found_m -= signs[0] * drives.spacing_m * np.maximum(0, at[anchors[0]] - at[rows])
        found_m += signs[1] * drives.spacing_m * np.maximum(0, at[rows] - at[anchors[-1]])
        low_m, high_m = drives.extent_m(segments[begin])
        inside = (found_m >= low_m - SPARE_M) & (found_m <= high_m + SPARE_M)
        yield Pass(segments[begin], found_m[inside], np.isin(rows, anchors)[inside])
        begin = end


def shadow_passes(drive: ShadowDrive, maps: MapSet, drives: Drives, way: Literal["home", "again"]) -> Iterator[Pass]:
    """The passes of a drive beside GPS that went that way, by where GPS had it; believed is what would be published."""
    places = np.flatnonzero(~np.isnan(maps.places["lat_deg"]))
    known = np.flatnonzero(~np.isnan(drive.gps_m) & ~np.isnan(drive.at_deg[:, 0]))
    if not (places.size and known.size):
        return
    origin = float(drive.at_deg[known[0], 0]), float(drive.at_deg[known[0], 1])
    at_m = east_north(drive.at_deg[known, 0], drive.at_deg[known, 1], origin)
    map_m = east_north(maps.places["lat_deg"][places], maps.places["lon_deg"][places], origin)
    nearest = [int(np.argmin(np.sum((map_m - one) ** 2, axis=1))) for one in at_m]
    is_near = np.hypot(*(map_m[nearest] - at_m).T) <= NEAR_M
    segments = np.where(is_near, [drives.drive_of(int(places[row])) for row in nearest], -1)
    along_m = np.array([drives.along_m(int(places[row])) for row in nearest])
    cuts = np.flatnonzero(np.diff(segments)) + 1
    for rows in np.split(np.arange(len(known)), cuts):
        turned = along_m[rows[-1]] < along_m[rows[0]]
        if segments[rows[0]] >= 0 and len(rows) > 1 and turned == (way == "home"):
            yield Pass(int(segments[rows[0]]), along_m[rows], drive.is_published[known[rows]])


def road_between_m(maps: MapSet, first: int, second: int) -> float:
    """Meters over the ground from the end of a segment to the beginning of a later one; infinite where not known."""
    first, second = sorted((first, second))
    here, there = maps.places[maps.index.segment(first)[1] - 1], maps.places[maps.index.segment(second)[0]]
    origin = float(here["lat_deg"]), float(here["lon_deg"])
    road_m = math.hypot(*east_north_of(float(there["lat_deg"]), float(there["lon_deg"]), origin))
    return road_m if math.isfinite(road_m) and road_m <= APART_M else math.inf


def _place_index(frame: FrameUsed, maps: MapSet) -> int:
    """The number of a frame's place through all maps. MapError where the maps do not have it."""
    name = None if frame.map is msgspec.UNSET else frame.map
    number = maps.names.index(str(name)) if name in maps.names else 0 if name is None and not maps.is_folder else None
    if number is None or frame.place is None or frame.place >= maps.headers[number].places:
        raise MapError(
            f"{maps.path}: it has no place {frame.place} of {name or 'a single map'}; name the map driven on"
        )
    return maps.index.starts[number] + frame.place
