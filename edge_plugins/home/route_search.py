"""From place to place along the drives of a map, and from one drive onto another where they meet.

A place is DRIVE:METERS, counted from 1 and from the start of that drive (`end` is its last), or LAT,LON in degrees: of
the nearest drive. The user says which drives, in which order: a map knows no fences, gates and one-way roads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edge.errors import ConfigError, MapError
from edge.geodesy import east_north
from edge.reference_map import MapSet
from edge_plugins.home.checks import SHARPEST_RAD
from edge_plugins.home.drive_line import DriveLine, drive_lines
from edge_plugins.home.passes import ROAD_M, are_level


@dataclass(frozen=True)
class Stretch:
    """Rows (N,) of one drive that follow each other, in the order in which they are driven."""

    line: DriveLine
    rows: NDArray[np.int64]

    @property
    def is_back(self) -> bool:
        """Whether it is driven against the drive."""
        return bool(self.rows[-1] < self.rows[0])


def degrees_of(text: str) -> tuple[float, float]:
    """LAT,LON as numbers; ValueError."""
    lat_deg, lon_deg = map(float, text.split(","))
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180):
        raise ValueError
    return lat_deg, lon_deg


def find_stretches(maps: MapSet, places: Sequence[str], reach_m: float) -> list[Stretch]:
    """The way through two places or more. reach_m: of LAT,LON from a drive, at most.

    ConfigError for a text that is no place, or where no drive comes by; MapError where two drives do not meet.
    """
    lines, found = drive_lines(maps) if places else [], list[Stretch]()
    for (line, row), (onto, end) in pairwise([_row_at(lines, place, reach_m) for place in places]):
        if line is onto:
            found.append(Stretch(line, _rows(row, end)))
            continue
        meeting = _meeting(line, row, onto, end)
        if meeting is None:
            raise MapError(f"{maps.path}: {line.name} does not come within {ROAD_M:g} m of {onto.name} as it is driven")
        found += [Stretch(line, _rows(row, meeting[0])), Stretch(onto, _rows(meeting[1], end))]
    if places and sum(len(one.rows) for one in found) < 2:
        raise ConfigError(f"{' '.join(places)}: all of it is one place")
    return found


def _rows(first: int, last: int) -> NDArray[np.int64]:
    step = 1 if last >= first else -1
    return np.arange(first, last + step, step)


def _row_at(lines: Sequence[DriveLine], place: str, reach_m: float) -> tuple[DriveLine, int]:
    """The drive of a place, and its nearest row."""
    try:
        if "," in place:
            lat_deg, lon_deg = np.array([degrees_of(place)]).T
            point_m = east_north(lat_deg, lon_deg, lines[0].origin)[0]
            away_m = [np.hypot(*(line.points_m - point_m).T) for line in lines]
            line, from_m = min(zip(lines, away_m, strict=True), key=lambda one: float(one[1].min()))
            if from_m.min() > reach_m:
                raise ConfigError(f"{place}: {from_m.min():.0f} m from the nearest drive; max_start_m is {reach_m:g}")
            return line, int(from_m.argmin())
        number, _, text = place.partition(":")
        line = lines[[one.number for one in lines].index(int(number))]
        meters = float(line.along_m[-1]) if text == "end" else float(text)
    except ValueError:
        known = ", ".join(str(line.number) for line in lines)
        raise ConfigError(f"{place}: no DRIVE:METERS, DRIVE:end or LAT,LON; drives: {known}") from None
    if not 0 <= meters <= line.along_m[-1]:
        raise ConfigError(f"{place}: {line.name} is {line.along_m[-1]:.0f} m long")
    return line, int(np.abs(line.along_m - meters).argmin())


def _meeting(line: DriveLine, start: int, onto: DriveLine, end: int) -> tuple[int, int] | None:
    """The rows of two drives where the way from a row of one to a row of the other is shortest; None if they are apart.

    Further apart counts twice. From one onto the other it may turn by SHARPEST_RAD.
    """
    courses = [np.gradient(one.points_m, axis=0) for one in (line, onto)]
    ahead, on = (one / np.maximum(np.hypot(*one.T), 1e-9)[:, None] for one in courses)
    on *= np.where(np.arange(len(on)) <= end, 1, -1)[:, None]
    on_m, best = np.abs(onto.along_m - onto.along_m[end]), (math.inf, 0, 0)
    for row in range(len(ahead)):
        apart_m = np.hypot(*(onto.points_m - line.points_m[row]).T)
        turn = on @ ahead[row] * (1 if row >= start else -1)
        fits = (apart_m <= ROAD_M) & (turn > math.cos(SHARPEST_RAD))
        fits &= are_level(onto.alt_m - line.alt_m[row], np.full(len(on), math.inf))
        way_m = abs(line.along_m[row] - line.along_m[start]) + np.where(fits, 2 * apart_m + on_m, math.inf)
        best = min(best, (float(way_m.min()), row, int(way_m.argmin())))
    return best[1:] if best[0] < math.inf else None
