"""Positions in degrees (WGS 84) and in local meters; every conversion of the vehicle's code is here, by pyproj."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod, Transformer

Origin = tuple[float, float]
"""Latitude and longitude in degrees that local meters are counted from."""

_EARTH = Geod(ellps="WGS84")
"""Shortest ways over the ellipsoid (Karney 2013): 0.7 us each on a desktop's core, and right on its far side, too."""
_RADIUS_M = 6_371_009.0
"""Mean radius of WGS 84. So many meters above the ellipsoid, ways are longer by one part of so many."""

PositionSource = Literal[
    "unknown",
    "gps",
    "dgps",
    "rtk_float",
    "rtk_fixed",
    "estimate",
    "dead_reckoning",
    "place_fixes",
    "survey",
    "ppp",
    "local",
]
"""What a position rests on: a receiver, by its kind of fix; an autopilot's estimate with GPS in use, whose kind of fix
is not known; an estimate without GPS; an estimate that rests on positions from Lookback; a better measurement; meters
from an origin of their own, indoors perhaps, which are written as degrees near 0, 0 and are never sent."""
POSITION_SOURCES: tuple[PositionSource, ...] = get_args(PositionSource)
WORST_FIRST: tuple[PositionSource, ...] = ("local", "place_fixes", "dead_reckoning", "unknown")


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

    def at(self, stamp_ns: int) -> Origin:
        """Latitude and longitude at another moment, by its velocity."""
        apart_s = (stamp_ns - self.stamp_ns) / 1e9
        return moved(self.lat_deg, self.lon_deg, self.east_mps * apart_s, self.north_mps * apart_s)


def worse_source(before: PositionSource, after: PositionSource) -> PositionSource:
    """What a position between two others rests on."""
    return next((source for source in WORST_FIRST if source in (before, after)), after)


def heading_between(before_deg: float, after_deg: float, share: float) -> float:
    """A heading at that share of the way from one to another, the shorter way round; past 1 as it went on turning."""
    return (before_deg + share * ((after_deg - before_deg + 180) % 360 - 180)) % 360


def first_known(lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]) -> Origin | None:
    """The first position of (N,) degrees, None if all are NaN."""
    known = np.flatnonzero(~np.isnan(lat_deg))
    return (float(lat_deg[known[0]]), float(lon_deg[known[0]])) if known.size else None


def east_north(
    lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64], origin: Origin | None = None
) -> NDArray[np.float64]:
    """Meters east and north of an origin, else of the first known position: (N,) degrees -> (N, 2), NaN if unknown.

    In the plane that touches the earth there, since that costs a sixth of the shortest ways of `east_north_of`; 10 km
    from the origin they differ by 4 mm, 50 km from it by 0.5 m.
    """
    origin = origin or first_known(lat_deg, lon_deg)
    if origin is None:
        return np.full((len(lat_deg), 2), np.nan)
    lat_0, lon_0 = origin
    plane = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84"
        f" +step +proj=topocentric +ellps=WGS84 +lat_0={lat_0!r} +lon_0={lon_0!r}"
    )
    east, north, _ = plane.transform(*_numbers(lon_deg, lat_deg, np.zeros(len(lat_deg))))
    return np.column_stack([east, north])


def east_north_of(lat_deg: float, lon_deg: float, origin: Origin, alt_m: float = 0.0) -> tuple[float, float]:
    """Meters east and north of an origin, of one position, along the shortest way; both at the same altitude."""
    azimuth_deg, _, way_m = _EARTH.inv(origin[1], origin[0], lon_deg, lat_deg)
    azimuth_rad, way_m = math.radians(azimuth_deg), way_m * (1 + alt_m / _RADIUS_M)
    return way_m * math.sin(azimuth_rad), way_m * math.cos(azimuth_rad)


def moved(lat_deg: float, lon_deg: float, east_m: float, north_m: float, alt_m: float = 0.0) -> tuple[float, float]:
    """Latitude and longitude of a position so far east and north of another one: `east_north_of` backwards."""
    azimuth_deg, way_m = math.degrees(math.atan2(east_m, north_m)), math.hypot(east_m, north_m)
    lon, lat, _ = _EARTH.fwd(lon_deg, lat_deg, azimuth_deg, way_m / (1 + alt_m / _RADIUS_M))
    return lat, lon


def all_moved(
    lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64], moves_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Latitudes and longitudes (N,) of positions that lie so far east and north (N, 2) of others (N,)."""
    east_m, north_m = moves_m.T
    azimuths_deg, ways_m = np.degrees(np.arctan2(east_m, north_m)), np.hypot(east_m, north_m)
    lon, lat, _ = _EARTH.fwd(*_numbers(lon_deg, lat_deg, azimuths_deg, ways_m))
    return np.atleast_1d(lat), np.atleast_1d(lon)


def along_and_across(east_north_m: tuple[float, float], heading_deg: float) -> tuple[float, float]:
    """Meters along a heading and to its right of meters east and north."""
    (east_m, north_m), heading_rad = east_north_m, math.radians(heading_deg)
    sin, cos = math.sin(heading_rad), math.cos(heading_rad)
    return east_m * sin + north_m * cos, east_m * cos - north_m * sin


def moved_left(lat_deg: float, lon_deg: float, heading_deg: float, left_m: float) -> tuple[float, float]:
    """Latitude and longitude `left_m` to the left of a position, for somebody who looks along the heading."""
    heading_rad = math.radians(heading_deg)
    return moved(lat_deg, lon_deg, -left_m * math.cos(heading_rad), left_m * math.sin(heading_rad))


def apart_m(
    lat_deg: float, lon_deg: float | NDArray[np.float64], lats_deg: NDArray[np.float64], lons_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Meters from a position to others (n,), along the shortest way."""
    here = np.broadcast_to(lon_deg, lats_deg.shape), np.broadcast_to(lat_deg, lats_deg.shape)
    return np.atleast_1d(_EARTH.inv(*_numbers(*here, lons_deg, lats_deg))[2])


def _numbers(*columns: NDArray[np.float64]) -> list[Any]:
    """Arrays (N,) as pyproj takes them: before 3.7.2, the last for Python 3.10, an array of one number is a number."""
    return [column.item() if column.size == 1 else column for column in columns]


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
