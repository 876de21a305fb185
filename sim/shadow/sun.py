"""The light of a moment, by how high the sun stands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
