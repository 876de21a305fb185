"""The records of `places.bin`: where each place is, how well that is known and by what, and its thumbnail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.geodesy import POSITION_SOURCES

ASSUMED_SIGMA_M = 5.0
"""Accuracy of a position that was recorded without one, as in maps of format 3: that of a GPS receiver without
corrections between houses and trees. In the open it is 1.5 to 3 m."""

PLACE = np.dtype(
    [
        ("lat_deg", "<f8"),  # NaN where the position is not known, as in all columns of floating-point numbers
        ("lon_deg", "<f8"),
        ("alt_m", "<f8"),
        ("heading_deg", "<f8"),  # of the vehicle, clockwise from north
        ("route_m", "<f8"),  # along the drive that made the segment
        ("row", "<i4"),  # of the feed
        ("norm_sq", "<i4"),  # squared length of the int8 descriptor
        ("thumbnail_at", "<i8"),  # where in thumbnails.jpgs, and how long
        ("thumbnail_bytes", "<i4"),
        ("position_sigma_m", "<f4"),  # one standard deviation of the position's distance from the truth
        ("position_source", "<i4"),  # what measured the position: index into POSITION_SOURCES
    ]
)
PLACE_OF_FORMAT_3 = np.dtype([(name, PLACE[name]) for name in (PLACE.names or ())[:-2]])

LIMITS = {"lat_deg": 90.0, "lon_deg": 360.0, "alt_m": 1e5, "heading_deg": 720.0, "route_m": 1e9}
MAX_SIGMA_M = 1e6
MOST_STEP_M = 100_000.0
"""Along a drive, from a place to the next: 60 s, the longest interval between frames, at 600 km/h. Lines, and what the
coverage of a map is made of, have room for a drive of that length: with a step of 1e9 m, for more than all memory."""


def read_places(file: Path, stored: np.dtype[np.void]) -> NDArray[np.void]:
    """Records (N,) of PLACE from those that the file has; what it does not have is unknown. MapError, OSError."""
    records = np.fromfile(file, dtype=stored)
    if stored != PLACE:
        places = np.zeros(len(records), dtype=PLACE)
        places["position_sigma_m"] = np.nan
        for name in stored.names or ():
            places[name] = records[name]
        records = places
    check_places(file, records)
    return records


def sigmas_m(places: NDArray[np.void]) -> NDArray[np.float64]:
    """One standard deviation (N,) of the positions of places, ASSUMED_SIGMA_M where a map does not say."""
    sigma_m: NDArray[np.float64] = np.nan_to_num(places["position_sigma_m"].astype(np.float64), nan=ASSUMED_SIGMA_M)
    return sigma_m


def check_places(file: Path, places: NDArray[np.void]) -> None:
    """What is known of a place must be possible, whatever its checksum says: positions are computed with it."""
    for name, most in LIMITS.items():
        _refuse(file, places, name, np.abs(places[name]) > most)  # of NaN, which is not known, this is False
    sigma_m, source = places["position_sigma_m"], places["position_source"]
    _refuse(file, places, "position_sigma_m", (sigma_m <= 0) | (sigma_m > MAX_SIGMA_M))
    _refuse(file, places, "position_source", (source < 0) | (source >= len(POSITION_SOURCES)))
    half = np.flatnonzero(np.isnan(places["lat_deg"]) != np.isnan(places["lon_deg"]))
    if half.size:
        raise MapError(f"{file}: place {half[0]} has half a position; build or copy the map again")


def check_steps(file: Path, places: NDArray[np.void], starts: list[int]) -> None:
    """Places (N,) that follow each other in a segment must be near each other along its drive. MapError.

    starts: of the segments.
    """
    step_m = np.abs(np.diff(places["route_m"], prepend=np.nan))
    step_m[starts] = np.nan
    _refuse(file, places, "route_m", step_m > MOST_STEP_M)


def _refuse(file: Path, places: NDArray[np.void], name: str, wrong: NDArray[np.bool_]) -> None:
    bad = np.flatnonzero(wrong)
    if bad.size:
        raise MapError(f"{file}: place {bad[0]} has {name} {places[name][bad[0]]:g}; build or copy the map again")
