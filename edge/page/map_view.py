"""What the live page shows of the maps: their drives as lines, and a small image of each place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.reference_map import Bounds, MapSet

DRIVE_POINTS = 2000
Line = tuple[tuple[float, float], ...]
"""(latitude, longitude) in degrees (WGS 84)."""


@dataclass(frozen=True)
class MapView:
    """What the page shows of the map.

    places: how many there are in all. starts: how many places come before each map of a folder, by the map's name.
    drives: lists of (latitude, longitude), empty where unknown. thumbnail: the small JPEG of a place, counted through
    all maps (any thread may ask); b"" where there is none. path: of the map, or of the folder.
    """

    places: int
    starts: dict[str, int]
    drives: tuple[Line, ...]
    thumbnail: Callable[[int], bytes]
    path: Path

    def as_json(self) -> bytes:
        """All but the thumbnails."""
        return msgspec.json.encode({"places": self.places, "starts": self.starts, "drives": self.drives})


def map_view(maps: MapSet) -> MapView:
    """What is shown of these maps."""
    starts = dict(zip(maps.names, maps.index.starts, strict=False)) if maps.is_folder else {}
    return MapView(maps.index.places, starts, _outline(maps), maps.thumbnail, maps.path)


def _outline(maps: MapSet) -> tuple[Line, ...]:
    """The drives of a map, thinned out where they are long; of maps in a folder, their bounds."""
    if maps.is_folder:
        return tuple(_rectangle(header.bounds) for header in maps.headers if header.bounds)
    index = maps.index
    drives = [maps.places[start:end] for _, start, end in index.by_segment([(0, index.places)])]
    return tuple(_line(drive[:: max(1, len(drive) // DRIVE_POINTS)]) for drive in drives)


def _line(drive: NDArray[np.void]) -> Line:
    known = drive[~np.isnan(drive["lat_deg"])]
    return tuple(zip(known["lat_deg"].tolist(), known["lon_deg"].tolist(), strict=True))


def _rectangle(bounds: Bounds) -> Line:
    south, west, north, east = bounds.south, bounds.west, bounds.north, bounds.east
    return (south, west), (south, east), (north, east), (north, west), (south, west)
