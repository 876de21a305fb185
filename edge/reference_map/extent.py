"""Where the places of a map lie, and which larger map they were cut from: what a header says before a map is opened."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError


class Bounds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Degrees between which the places lie whose position is known; `east` is over 180 across the date line."""

    south: float
    west: float
    north: float
    east: float


class TileOf(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The larger map that a tile was cut from: its header's checksum, and where in it the tile begins.

    continues: the tile's first segment goes on with the drive that the tile before it ends with. origin: latitude and
    longitude of the larger map's local metres, which its tiles share; null where it knows no position.
    """

    map_sha256: str
    start: int
    continues: bool
    origin: tuple[float, float] | None


def bounds_of(places: NDArray[np.void]) -> Bounds | None:
    """The bounds of records of PLACE, None where no position is known."""
    known = places[~np.isnan(places["lat_deg"])]
    if not known.size:
        return None
    lat_deg, lon_deg = known["lat_deg"], known["lon_deg"]
    if np.ptp(lon_deg) > 180:
        lon_deg = np.where(lon_deg < 0, lon_deg + 360, lon_deg)
    return Bounds(float(lat_deg.min()), float(lon_deg.min()), float(lat_deg.max()), float(lon_deg.max()))


def check_extent(file: Path, bounds: Bounds | None, tile: TileOf | None) -> None:
    """Hold the claims of the header in `file` against what can be. MapError."""
    # A comparison with what is no number is False.
    if bounds is not None and not (
        -90 <= bounds.south <= bounds.north <= 90 and -180 <= bounds.west <= bounds.east <= bounds.west + 360 <= 720
    ):
        raise MapError(f"{file}: bounds: not south to north and west to east in degrees")
    if tile is not None and (tile.start < 0 or not _is_position(tile.origin or (0.0, 0.0))):
        raise MapError(f"{file}: tile: no map has such a place, or such an origin")


def _is_position(degrees: tuple[float, float]) -> bool:
    return math.isfinite(sum(degrees)) and abs(degrees[0]) <= 90 and abs(degrees[1]) <= 360
