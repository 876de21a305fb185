"""Whether drives of a map that passed over one road agree about where it is.

Of each drive, windows of places are searched in the other drives that passed nearby, as a vehicle's frames are: the
line through the descriptors says which places show the same, and their positions should be the same as well. Where
windows in a row find the same displacement and it is more than the accuracy of both drives explains, one of them is
wrong, and nobody knows which.

Only drives whose cameras looked the same way are compared: with one view in one direction, or with opposed views in
opposite directions. Otherwise what is seen lies ahead, by a distance that the map does not know. Over simulated drives
of 800 m (day, dusk, night) the displacement of right positions was at most 0.6 m, and 8 m in opposite directions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north, first_known
from edge.localization.place_fix import heads_along
from edge.reference_map import MapSet, sigmas_m
from edge.sequence import Alignment
from edge.sequence.search import NO_LINE, SequenceSearch, slopes_around_diagonal

LENGTH, STEP = 20, 20
"""Places in a window, and from one window to the next."""
SEARCHED_M = 150.0
"""Drives that disagree by more are not recognized as being of one road."""
ELSEWHERE = 15
"""Places from the best line at which another line is elsewhere."""
UNIQUE = 1.05
"""A window counts if the best line elsewhere costs so many times as much."""
WINDOWS = 3
"""So many windows in a row whose displacements are alike are believed."""
EXPLAINED_SIGMAS = 2.0
"""Displacement that accuracy explains, in standard deviations of both drives together."""
SLOPES = slopes_around_diagonal(0.1, 5)
Rows = tuple[Path, int, int]


class _Pairing(NamedTuple):
    """How one drive lies against the other, how much lanes and lines explain, and what two windows may differ by."""

    alignment: Alignment
    explained_m: float
    alike_m: float


ONE_VIEW = _Pairing(("forward", "same"), 3.0, 5.0)
OPPOSED_VIEWS = _Pairing(("reverse", "same"), 12.0, 10.0)


@dataclass(frozen=True)
class MapDisagreement:
    """Two stretches, each a map and its rows [first, end), that show the same road `apart_m` from each other."""

    stretches: tuple[Rows, Rows]
    apart_m: float

    def __str__(self) -> str:
        """For people."""
        (first, a, b), (second, c, d) = self.stretches
        return (
            f"places {a} to {b - 1} of {first.name} and {c} to {d - 1} of {second.name} show the same road"
            f" {self.apart_m:.0f} m apart"
        )


@dataclass(frozen=True)
class WindowMatch:
    """A window of one drive and where an earlier one shows the same: by number, the earlier one first; middle places.

    apart_m: east and north (2,) from the earlier drive's place to the other's. explained_m: by accuracy and lanes.
    """

    drives: tuple[int, int]
    places: tuple[int, int]
    apart_m: NDArray[np.float64]
    explained_m: float
    alike_m: float


def disagreements(maps: MapSet) -> list[MapDisagreement]:
    """All that are found."""
    found = []
    for _, of_pair in groupby(_compared(maps), key=lambda one: one.drives):
        found += [_spelled(maps, run) for run in _runs(list(of_pair))]
    return found


def _compared(maps: MapSet) -> list[WindowMatch]:
    """Windows of which another drive shows the same; by the pair of drives, then by where."""
    places = maps.places
    origin = first_known(places["lat_deg"], places["lon_deg"])
    if origin is None or len(maps.index.segments) < 2:
        return []
    ground_m, sigma_m = east_north(places["lat_deg"], places["lon_deg"], origin), sigmas_m(places)
    found = (_compare(maps, ground_m, sigma_m, *window) for window in _windows(maps))
    return sorted((one for one in found if one is not None), key=lambda one: (one.drives, one.places))


def _windows(maps: MapSet) -> Iterator[tuple[int, int, tuple[int, int]]]:
    """The first place of each window, its drive, and places [start, end) of an earlier drive that passed nearby."""
    index, places = maps.index, maps.places
    for drive, (start, end) in enumerate(index.segments):
        for first in range(start, end - LENGTH + 1, STEP):
            middle = places[first + LENGTH // 2]
            if math.isnan(middle["lat_deg"]) or index.map_of(first) != index.map_of(first + LENGTH - 1):
                continue
            near = maps.blocks.within(float(middle["lat_deg"]), float(middle["lon_deg"]), SEARCHED_M)
            for other, low, high in index.by_segment(near):
                if other < drive and high - low >= 2 * LENGTH:
                    yield first, drive, (low, high)


def _compare(
    maps: MapSet,
    ground_m: NDArray[np.float64],
    sigma_m: NDArray[np.float64],
    first: int,
    drive: int,
    near: tuple[int, int],
) -> WindowMatch | None:
    """The window of a drive against places [start, end) of another; None where it shows nothing unique there."""
    rows = _encoded(maps, first)
    other, other_map = maps.index.segment_of(near[0]), maps.index.map_of(near[0])
    if maps.headers[other_map].shrunk_by != maps.headers[maps.index.map_of(first)].shrunk_by:
        return None
    start = maps.index.starts[other_map]
    near = near[0], min(near[1], maps.index.starts[other_map + 1])
    costs = maps.matchers[other_map].costs_of_encoded(rows, [(near[0] - start, near[1] - start)])
    pairing = ONE_VIEW if maps.index.view(drive) == maps.index.view(other) else OPPOSED_VIEWS
    search = SequenceSearch([(0, near[1] - near[0])], [pairing.alignment], LENGTH, SLOPES)
    search.refill(costs)
    lines = search.lines()
    if lines is None:
        return None
    best = int(lines.costs.argmin())
    elsewhere = np.abs(np.arange(len(lines.costs)) - best) > ELSEWHERE
    second = int(lines.costs[elsewhere].min(initial=NO_LINE))
    if second < UNIQUE * lines.costs[best]:
        return None
    middle = first + (LENGTH - 1) / 2
    back = float(search.passed(0, best)[-1]) / 2
    there = near[0] + best + (-back if pairing is ONE_VIEW else back)
    apart_m = _at(ground_m, middle) - _at(ground_m, there)
    ends = there + (LENGTH - 1) / 2, there - (LENGTH - 1) / 2
    after, before = (min(max(end, near[0]), near[1] - 1) for end in (ends if pairing is ONE_VIEW else ends[::-1]))
    ways = _at(ground_m, first + LENGTH - 1) - _at(ground_m, first), _at(ground_m, after) - _at(ground_m, before)
    # Unknown positions compare as False.
    if not heads_along(*(math.atan2(*way) for way in ways)) or np.isnan(apart_m).any():
        return None
    places = round(middle), round(there)
    explained_m = pairing.explained_m + EXPLAINED_SIGMAS * math.hypot(*sigma_m[list(places)])
    pair = other, drive
    return WindowMatch(pair, (places[1], places[0]), apart_m, explained_m, pairing.alike_m)


def _encoded(maps: MapSet, first: int) -> NDArray[np.int8]:
    """The descriptors (R, LENGTH, D) of a window as its map has them."""
    number = maps.index.map_of(first)
    row = first - maps.index.starts[number]
    return np.ascontiguousarray(maps.maps[number].descriptors[:, row : row + LENGTH])


def _at(ground_m: NDArray[np.float64], place: float) -> NDArray[np.float64]:
    """Meters (2,) between two places."""
    before, after = math.floor(place), min(math.ceil(place), len(ground_m) - 1)
    meters: NDArray[np.float64] = ground_m[before] + (place - before) * (ground_m[after] - ground_m[before])
    return meters


def _runs(windows: Sequence[WindowMatch]) -> Iterator[list[WindowMatch]]:
    """Windows in a row of one pair of drives that agree with each other that the drives do not."""
    run: list[WindowMatch] = []
    for before, one in pairwise([None, *windows, None]):
        if run and (one is None or before is None or np.hypot(*(one.apart_m - before.apart_m)) > before.alike_m):
            yield from _beyond(run)
            run = []
        if one is not None:
            run.append(one)


def _beyond(run: list[WindowMatch]) -> Iterator[list[WindowMatch]]:
    if len(run) >= WINDOWS:
        for is_beyond, part in groupby(run, key=lambda one: np.hypot(*one.apart_m) > one.explained_m):
            if is_beyond:
                yield list(part)


def _spelled(maps: MapSet, run: Sequence[WindowMatch]) -> MapDisagreement:
    stretches = []
    for which in (0, 1):
        places = [one.places[which] for one in run]
        number = maps.index.map_of(min(places))
        start, end = maps.index.rows[number]
        drive_start, drive_end = maps.index.segment(run[0].drives[which])
        margin = max(STEP, int(np.abs(np.diff(places)).max(initial=0)))
        first = max(min(places) - margin, start, drive_start)
        last = min(max(places) + margin + 1, end, drive_end)
        stretches.append((maps.maps[number].path, first - start, last - start))
    return MapDisagreement((stretches[0], stretches[1]), max(float(np.hypot(*one.apart_m)) for one in run))
