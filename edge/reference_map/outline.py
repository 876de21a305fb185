"""A set of maps as lines to be drawn for people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.reference_map.map_set import MapSet
from edge.reference_map.spatial_index import Bounds

DRIVE_POINTS = 2000
Line = tuple[tuple[float, float], ...]
"""(latitude, longitude) in degrees (WGS 84)."""


def outline(map_set: MapSet) -> tuple[Line, ...]:
    """The drives of a map, thinned out where they are long; of maps in a folder, their bounds."""
    if map_set.is_folder:
        return tuple(_rectangle(header.bounds) for header in map_set.headers if header.bounds)
    index = map_set.index
    drives = [map_set.places[start:end] for _, start, end in index.by_segment([(0, index.places)])]
    return tuple(_line(drive[:: max(1, len(drive) // DRIVE_POINTS)]) for drive in drives)


def _line(drive: NDArray[np.void]) -> Line:
    known = drive[~np.isnan(drive["lat_deg"])]
    return tuple(zip(known["lat_deg"].tolist(), known["lon_deg"].tolist(), strict=True))


def _rectangle(bounds: Bounds) -> Line:
    south, west, north, east = bounds.south, bounds.west, bounds.north, bounds.east
    return (south, west), (south, east), (north, east), (north, west), (south, west)
