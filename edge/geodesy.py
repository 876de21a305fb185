"""Positions in degrees (WGS 84) and in local meters; every conversion of the vehicle's code is here, by pymap3d."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import pymap3d
from numpy.typing import NDArray

Origin = tuple[float, float]
"""Latitude and longitude in degrees that local meters are counted from."""

PositionSource = Literal[
    "unknown", "gps", "dgps", "rtk_float", "rtk_fixed", "estimate", "dead_reckoning", "place_fixes", "survey", "ppp"
]
"""What a position rests on: a receiver, by its kind of fix; an autopilot's estimate with GPS in use, whose kind of fix
is not known; an estimate without GPS; an estimate that rests on positions from Lookback; a better measurement."""
POSITION_SOURCES: tuple[PositionSource, ...] = get_args(PositionSource)
WORST_FIRST: tuple[PositionSource, ...] = ("place_fixes", "dead_reckoning", "unknown")


@dataclass(frozen=True)
class VehiclePosition:
    """Where an autopilot estimates its vehicle to be.

    stamp_ns: CLOCK_MONOTONIC. Degrees (WGS 84), meters above mean sea level, heading clockwise from north. sigma_m: one
    standard deviation of the distance from the truth, None where not known.
    """

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    heading_deg: float | None
    speed_mps: float
    north_mps: float = 0.0
    east_mps: float = 0.0
    sigma_m: float | None = None
    source: PositionSource = "unknown"


def worse_source(before: PositionSource, after: PositionSource) -> PositionSource:
    """What a position between two others rests on."""
    return next((source for source in WORST_FIRST if source in (before, after)), after)


def first_known(lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]) -> Origin | None:
    """The first position of (N,) degrees, None if all are NaN."""
    known = np.flatnonzero(~np.isnan(lat_deg))
    return (float(lat_deg[known[0]]), float(lon_deg[known[0]])) if known.size else None


def east_north(
    lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64], origin: Origin | None = None
) -> NDArray[np.float64]:
    """Meters east and north of an origin, else of the first known position: (N,) degrees -> (N, 2), NaN if unknown."""
    origin = origin or first_known(lat_deg, lon_deg)
    if origin is None:
        return np.full((len(lat_deg), 2), np.nan)
    east, north, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, *origin, 0.0)
    return np.column_stack([east, north])


def east_north_of(lat_deg: float, lon_deg: float, origin: Origin, alt_m: float = 0.0) -> tuple[float, float]:
    """Meters east and north of an origin, of one position; both at the same altitude."""
    east_m, north_m, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, alt_m, *origin, alt_m)
    return float(east_m), float(north_m)


def moved(lat_deg: float, lon_deg: float, east_m: float, north_m: float, alt_m: float = 0.0) -> tuple[float, float]:
    """Latitude and longitude of a position that lies so far east and north of another one, in the plane through it."""
    lat, lon, _ = pymap3d.enu2geodetic(east_m, north_m, 0.0, lat_deg, lon_deg, alt_m)
    return float(lat), wrapped(float(lon))


def moved_left(lat_deg: float, lon_deg: float, heading_deg: float, left_m: float) -> tuple[float, float]:
    """Latitude and longitude `left_m` to the left of a position, for somebody who looks along the heading."""
    heading_rad = math.radians(heading_deg)
    return moved(lat_deg, lon_deg, -left_m * math.cos(heading_rad), left_m * math.sin(heading_rad))


def apart_m(
    lat_deg: float, lon_deg: float | NDArray[np.float64], lats_deg: NDArray[np.float64], lons_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Meters from a position to others (n,), in a straight line."""
    east, north, up = pymap3d.geodetic2enu(lats_deg, lons_deg, 0.0, lat_deg, lon_deg, 0.0)
    # With `up`, since on the other side of the earth the other two are small again.
    meters: NDArray[np.float64] = np.sqrt(np.square(east) + np.square(north) + np.square(up))
    return meters


def unwrapped(lon_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Longitudes (N,) of places close to each other without the jump at 180 degrees; unchanged where there is none.

    Across the antimeridian the western ones become more than 180.
    """
    if not np.ptp(lon_deg) > 180:  # NaN is not
        return lon_deg
    return np.where(lon_deg < 0, lon_deg + 360, lon_deg)


def wrapped(lon_deg: float) -> float:
    """A longitude between -180 and 180 degrees; unchanged where it is already."""
    return lon_deg if -180 <= lon_deg <= 180 else (lon_deg + 180) % 360 - 180
