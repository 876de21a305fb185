"""The drives of journals that were written beside GPS, each as arrays over its records."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError
from edge.geodesy import east_north_of
from edge.localization import CORRELATION_M
from edge.telemetry.shadow import ShadowPosition
from sim.journal import read_journal
from sim.output import refusing

Array = NDArray[np.float64]
LIGHTS = ("day", "dusk", "night")
DUSK_DEG = 6.0
"""Above and below the horizon: from the end of the golden hour to the end of civil twilight."""
J2000_S = 946_728_000.0  # Unix time of its noon
CLOCK_SET_S = 1_577_836_800.0
"""2020: a computer without a battery for its clock starts long before."""


def elevation_deg(unix_s: Array, lat_deg: Array, lon_deg: Array) -> Array:
    """Of the sun (N,), to 0.1 degree from 1950 to 2050: the Astronomical Almanac's low precision formula, section C."""
    days = (unix_s - J2000_S) / 86_400
    mean_deg, anomaly = 280.460 + 0.9856474 * days, np.radians(357.528 + 0.9856003 * days)
    ecliptic = np.radians(mean_deg + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    tilt = np.radians(23.439 - 4e-7 * days)
    ascension = np.arctan2(np.cos(tilt) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(tilt) * np.sin(ecliptic))
    sidereal_deg = 280.46062 + 360.98564737 * days
    hour_angle, lat = np.radians(sidereal_deg + lon_deg) - ascension, np.radians(lat_deg)
    height = np.sin(lat) * np.sin(declination) + np.cos(lat) * np.cos(declination) * np.cos(hour_angle)
    return np.asarray(np.degrees(np.arcsin(height)))


def lights(unix_s: Array, lat_deg: Array, lon_deg: Array) -> NDArray[np.intp]:
    """Rows (N,) of LIGHTS, -1 where the clock was not set or the place is not known."""
    height_deg = elevation_deg(unix_s, lat_deg, lon_deg)
    found = np.where(height_deg > DUSK_DEG, 0, np.where(height_deg >= -DUSK_DEG, 1, 2))
    return np.where((unix_s < CLOCK_SET_S) | np.isnan(height_deg), -1, found)


PAUSE_S = 600.0
"""A longer silence, in which the vehicle stood or the program was off, begins a new drive."""
SHORTEST_M = 50.0
MOST_GPS_M = 5.0
"""By its own word, one standard deviation: beyond, GPS judges nothing."""
JUDGED_SHARE = 0.8
"""Of a drive's meters that GPS has to judge, else it judges none: such a receiver may be wrong elsewhere too."""
START_M = 250.0
"""From where a drive begins, nothing is recognized for 20 to so many meters (docs/mapping.md)."""
SOURCES = ("gps", "dgps", "rtk_float", "rtk_fixed", "ppp")
LATE_S = 0.05
"""By how much GPS may be of another time than the autopilot takes it for, one standard deviation: half of what
receivers of one make differ by (0.12 and 0.22 s in ArduPilot's driver for u-blox)."""


@dataclass(frozen=True)
class ShadowDrive:
    """Arrays (N,) over its records, in order.

    at_deg: (N, 2) latitude and longitude by GPS, NaN where it says nothing. driven_m: since the record before. gps_m:
    one standard deviation of GPS in each direction, NaN where it is no judge. light: see `lights`. off_m: (N, 2) ahead
    of GPS and to the left of it, NaN where no position would have been published. sigma_m: (N, 2) along and across.
    late_m: what GPS may be late by, along. way: direction and order, an index into WAYS. silent_m: driven without a
    position, up to this record.
    """

    name: str
    unix_s: Array
    at_deg: Array
    driven_m: Array
    gps_m: Array
    light: NDArray[np.intp]
    off_m: Array
    sigma_m: Array
    late_m: Array
    way: NDArray[np.intp]

    def where(self, rows: NDArray[np.bool_]) -> ShadowDrive:
        """Some of its records, each with what was driven since the one before it."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ARRAYS})

    @property
    def is_published(self) -> NDArray[np.bool_]:
        """Whether a position would have been."""
        return ~np.isnan(self.sigma_m[:, 0])

    @property
    def is_compared(self) -> NDArray[np.bool_]:
        """Whether GPS judges a position there."""
        return self.is_published & ~np.isnan(self.gps_m) & ~np.isnan(self.off_m[:, 0])

    @property
    def judged_share(self) -> float:
        """Share of its meters that GPS can judge."""
        return float(self.driven_m[~np.isnan(self.gps_m)].sum() / max(self.driven_m.sum(), 1e-9))

    @property
    def is_judge(self) -> bool:
        """Whether its GPS was good enough to judge anything."""
        return self.judged_share >= JUDGED_SHARE

    @property
    def silent_m(self) -> Array:
        """Meters without a position before each record."""
        at_m = np.cumsum(self.driven_m)
        last_m = np.maximum.accumulate(np.where(self.is_published, at_m, 0.0))
        return np.asarray(at_m - np.r_[0.0, last_m[:-1]])

    @property
    def is_beyond_start(self) -> NDArray[np.bool_]:
        """Where a position may be expected: one has come, or the vehicle has driven long enough for it."""
        return (np.cumsum(self.is_published) > 0) | (np.cumsum(self.driven_m) > START_M)

    @property
    def weight(self) -> Array:
        """Of each comparison: those within CORRELATION_M of driving have about one error, and count as one."""
        block = np.floor(np.cumsum(self.driven_m) / CORRELATION_M).astype(np.intp)
        counts = np.bincount(block, self.is_compared)
        return np.where(self.is_compared, 1 / np.maximum(counts[block], 1), 0.0)


ARRAYS = [one.name for one in fields(ShadowDrive) if one.name != "name"]
WAYS = tuple(f"{direction}_{order}" for direction in ("forward", "reverse") for order in ("same", "swapped"))


def read_drives(paths: Sequence[Path], since_s: float = -math.inf) -> list[ShadowDrive]:
    """The drives of some journals, by time. FeedError where none has a record of this kind."""
    found: list[ShadowDrive] = []
    for path in paths:
        with refusing(FeedError, f"{path}: cannot read it"):
            records = [
                (at or 0.0, one) for at, one in read_journal(path, ShadowPosition) if isinstance(one, ShadowPosition)
            ]
        if not records:
            raise FeedError(f'{path}: nothing to compare in it; drive with [telemetry] emit = "report" and GPS')
        drives = (_drive(part) for part in _parts(records) if part[-1][0] >= since_s)
        found += [one for one in drives if one.driven_m.sum() >= SHORTEST_M]
    return sorted(found, key=lambda one: float(one.unix_s[0]))


Records = list[tuple[float, ShadowPosition]]


def _parts(records: Records) -> Iterator[Records]:
    """Cut where the vehicle stood for long, or the program started anew."""
    begin = 0
    for row in range(1, len(records)):
        (before_s, before), (at_s, one) = records[row - 1], records[row]
        is_less = one.driven_m is not None and before.driven_m is not None and one.driven_m < before.driven_m
        if at_s - before_s > PAUSE_S or one.stamp_ns < before.stamp_ns or is_less:
            yield records[begin:row]
            begin = row
    yield records[begin:]


def _drive(records: Records) -> ShadowDrive:
    unix_s = np.array([at for at, _ in records])
    ones = [one for _, one in records]
    stamp_s = np.array([one.stamp_ns / 1e9 for one in ones])
    speed_mps = np.array([one.speed_mps for one in ones])
    total_m = np.array([_known(one.driven_m) for one in ones])
    driven_m = np.diff(total_m, prepend=total_m[:1])
    by_speed_m = speed_mps * np.clip(np.diff(stamp_s, prepend=stamp_s[:1]), 0, PAUSE_S)
    at_deg = np.array([(_known(one.gps_lat_deg), _known(one.gps_lon_deg)) for one in ones])
    is_gps = [one.gps_source in SOURCES and 0 < _known(one.gps_sigma_m) <= MOST_GPS_M for one in ones]
    gps_m = np.array([_known(one.gps_sigma_m) / math.sqrt(2) for one in ones])
    return ShadowDrive(
        name=datetime.fromtimestamp(unix_s[0]).strftime("%Y-%m-%d %H:%M"),  # by the clock of this computer
        unix_s=unix_s,
        at_deg=at_deg,
        driven_m=np.where(np.isnan(driven_m), by_speed_m, driven_m),
        gps_m=np.where(is_gps, gps_m, np.nan),
        light=lights(unix_s, *at_deg.T),
        off_m=np.array([_off_m(one) for one in ones]),
        sigma_m=np.array([(_known(one.sigma_along_m), _known(one.sigma_cross_track_m)) for one in ones]),
        late_m=LATE_S * speed_mps,
        way=np.array([_way(one) for one in ones]),
    )


def _known(value: float | None) -> float:
    return math.nan if value is None else value


def _way(one: ShadowPosition) -> int:
    return WAYS.index(f"{one.direction}_{one.order}") if one.direction and one.order else -1


def _off_m(one: ShadowPosition) -> tuple[float, float]:
    """Ahead of where GPS has the vehicle, and to the left of it."""
    if one.lat_deg is None or one.lon_deg is None or one.gps_lat_deg is None or one.gps_lon_deg is None:
        return math.nan, math.nan
    east_m, north_m = east_north_of(one.lat_deg, one.lon_deg, (one.gps_lat_deg, one.gps_lon_deg))
    sin, cos = math.sin(math.radians(one.heading_deg or 0.0)), math.cos(math.radians(one.heading_deg or 0.0))
    return east_m * sin + north_m * cos, north_m * sin - east_m * cos
