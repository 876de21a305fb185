"""Whether a vehicle can drive a way: each check is one function, and each finding one line that names the place.

A finding either refuses the way or warns. The positions are those of a drive, so a vehicle has been there; the checks
find where it may not have driven from one position to the next, or cannot drive back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.reference_map.gps_motion import disagreements
from edge_plugins.home import HomeConfig
from edge_plugins.home.drive_line import DriveLine

SHARPEST_RAD = math.radians(95)
"""Of a single corner: an arc that joins its legs would cut too far across it."""
SLACK = 4.0
"""Tolerances by which a leg of the waypoints may be shorter than that of the drive."""
SHORTEST_M = 5.0
PAST_IT = "drive past it and ask again, or end the way there"
BRIEF = 27
"""A line of STATUSTEXT has 50 characters, and begins with "Lookback: no way home: "."""
MOST_WAYPOINTS = 700
"""ArduPilot stores about 720 items on most boards, PX4 2000 where it has a memory card."""


@dataclass(frozen=True)
class RouteFinding:
    """What a check found. refuses: the way must not be driven like this; else it is a warning.

    brief: the same in at most BRIEF characters, as a pilot reads it while driving.
    """

    refuses: bool
    text: str
    brief: str

    def __str__(self) -> str:
        return f"{'refused' if self.refuses else 'warning'}: {self.text}"


def length_check(way_m: NDArray[np.float64], waypoints: int, config: HomeConfig) -> Iterator[RouteFinding]:
    """The length of the way (N,), in meters along it, and the number of its waypoints."""
    if way_m[-1] > config.max_length_m:
        text = f"the way is {way_m[-1]:.0f} m long; max_length_m is {config.max_length_m:g}"
        yield RouteFinding(True, text, f"{way_m[-1]:.0f} m is too long")
    if way_m[-1] < SHORTEST_M:
        yield RouteFinding(True, "the vehicle is at the end of the way", "you are there")
    if waypoints > MOST_WAYPOINTS:
        text = f"{waypoints} waypoints are more than autopilots store ({MOST_WAYPOINTS}); use a larger tolerance_m"
        yield RouteFinding(True, text, f"{waypoints} waypoints, too many")


def short_check(short_m: float, length_m: float, config: HomeConfig, *, is_named: bool) -> Iterator[RouteFinding]:
    """A way that ends where the map was interrupted, so far from where its recording began. is_named: by the user."""
    if short_m > config.max_gap_m:
        text = f"the way ends {short_m:.0f} m short of where the recording began: its map was interrupted there"
        refuses = short_m > length_m and not is_named
        yield RouteFinding(refuses, f"{text}; name an earlier drive", f"ends {short_m:.0f} m short of home")


def gap_check(way_m: NDArray[np.float64], config: HomeConfig) -> Iterator[RouteFinding]:
    """Stretches between places, at (N,) meters of the way, without a position."""
    apart_m = np.diff(way_m)
    for run in _runs(apart_m > config.max_gap_m):
        text = f"no position for {apart_m[run].max():.0f} m; max_gap_m is {config.max_gap_m:g}"
        brief = f"gap of {apart_m[run].max():.0f} m at {way_m[run[0]]:.0f} m"
        yield RouteFinding(True, f"{_stretch(way_m[run[0]], way_m[run[-1] + 1])}: {text}", brief)


def change_check(
    stretch: NDArray[np.int64], way_m: NDArray[np.float64], drives: Sequence[str]
) -> Iterator[RouteFinding]:
    """Where the way goes on along another drive; stretch: whose number each row (N,) has. The map knows no fences."""
    for row in np.flatnonzero(np.diff(stretch)).tolist():
        before, onto = drives[stretch[row]], drives[stretch[row + 1]]
        if before != onto:
            text = f"{_stretch(way_m[row], way_m[row + 1])}: from {before} onto {onto}, which no drive shows"
            yield RouteFinding(False, text, f"changes drives at {way_m[row]:.0f} m")


def motion_check(
    lines: Sequence[DriveLine], stretch: NDArray[np.int64], row: NDArray[np.int64], way_m: NDArray[np.float64]
) -> Iterator[RouteFinding]:
    """Where the positions of drives do not move as its vehicle did; (N,): which line, its row, meters of the way."""
    for number in np.unique(stretch).tolist():
        line, order = lines[number], np.flatnonzero(stretch == number)
        order = order[row[order].argsort()]
        end, was_off = int(row[order[-1]]) + 1, False
        columns = line.points_m[:end], line.sigma_m[:end], line.driven_m[:end], line.heading_deg[:end]
        for at, found in enumerate(disagreements(*columns)):
            if at < row[order[0]]:
                continue
            if found is not None and not was_off:
                first_m, last_m = np.sort(np.interp([at, at - found.since], row[order], way_m[order]))
                yield RouteFinding(True, f"{_stretch(first_m, last_m)}: {found}", f"GPS was off at {first_m:.0f} m")
            was_off = found is not None


def accuracy_check(
    way_m: NDArray[np.float64], sigma_m: NDArray[np.float64], config: HomeConfig
) -> Iterator[RouteFinding]:
    """Stretches whose positions, at (N,) meters of the way, were not measured well: one standard deviation (N,)."""
    for run in _runs(sigma_m > config.max_sigma_m):
        text = f"the positions are only known to {sigma_m[run].max():.0f} m; max_sigma_m is {config.max_sigma_m:g}"
        brief = f"GPS was poor at {way_m[run[0]]:.0f} m"
        yield RouteFinding(True, f"{_stretch(way_m[run[0]], way_m[run[-1]])}: {text}", brief)


def turn_check(points_m: NDArray[np.float64], way_m: NDArray[np.float64], config: HomeConfig) -> Iterator[RouteFinding]:
    """Turns at the waypoints (N, 2), at (N,) meters of the way, that need a smaller radius than the vehicle's.

    An arc of radius R joins two legs that differ by an angle a, and touches them R tan(a / 2) from the corner: the arcs
    at both ends of a leg must fit on it, but for what the tolerance of the waypoints leaves.
    """
    legs_m = np.diff(points_m, axis=0)
    course_rad = np.arctan2(legs_m[:, 0], legs_m[:, 1])
    turn_rad = np.abs((np.diff(course_rad) + np.pi) % (2 * np.pi) - np.pi)
    tangents = np.tan(np.r_[0.0, np.minimum(turn_rad, 0.99 * np.pi), 0.0] / 2)
    for row in np.flatnonzero(turn_rad > SHARPEST_RAD) + 1:
        text = f"at {way_m[row]:.0f} m: a turn of {math.degrees(turn_rad[row - 1]):.0f} degrees on the spot"
        yield RouteFinding(True, f"{text}: {PAST_IT}", f"turn at {way_m[row]:.0f} m, drive past")
    both = np.maximum(tangents[:-1] + tangents[1:], 1e-9)
    radius_m = (np.hypot(*legs_m.T) + SLACK * config.tolerance_m) / both
    for row in np.flatnonzero(radius_m < config.turning_radius_m):
        yield RouteFinding(
            True,
            f"{_stretch(way_m[row], way_m[row + 1])}: needs a turning radius of {radius_m[row]:.1f} m;"
            f" turning_radius_m is {config.turning_radius_m:g}: {PAST_IT}",
            f"bend at {way_m[row]:.0f} m, drive past",
        )


def pass_check(along_m: Sequence[float]) -> Iterator[RouteFinding]:
    """Passes of the drive, in meters from its start, between which nothing decides: none, or more than one."""
    if along_m:
        places = " and ".join(f"{meters:.0f} m" for meters in along_m)
        yield RouteFinding(
            True,
            f"the vehicle may be where the drive was at {places} from its start, which are not one road: drive on to"
            " where it passed once",
            "which pass? drive on",
        )


def start_check(
    away_m: float, sigma_m: float | None, turn_rad: float | None, config: HomeConfig
) -> Iterator[RouteFinding]:
    """Where the vehicle is: its distance from the way, how well that is known, and the turn to the way home."""
    if away_m > config.max_start_m:
        text = f"the vehicle is {away_m:.0f} m from where the way begins; max_start_m is {config.max_start_m:g}"
        yield RouteFinding(True, text, f"{away_m:.0f} m off, drive nearer")
    if sigma_m is not None and sigma_m > config.max_start_m:
        text = f"the vehicle's position is only known to {sigma_m:.0f} m; max_start_m is {config.max_start_m:g}"
        yield RouteFinding(True, text, f"position known to {sigma_m:.0f} m")
    if turn_rad is None or turn_rad < math.pi / 2:
        return
    needs_m = config.turning_radius_m * (1 - math.cos(turn_rad))
    degrees = math.degrees(turn_rad)
    yield RouteFinding(
        needs_m > config.max_start_m,
        f"the vehicle points {degrees:.0f} degrees away from the way: it needs {needs_m:.0f} m beside it to turn, or"
        " turn it first",
        f"turn first, {degrees:.0f} degrees off",
    )


def _runs(is_bad: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """The rows of each run that is bad throughout."""
    rows = np.flatnonzero(is_bad)
    return np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if rows.size else []


def _stretch(start_m: float, end_m: float) -> str:
    return f"from {start_m:.0f} m to {end_m:.0f} m"
