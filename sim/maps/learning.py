"""`lookback map learn`: what is chosen for a folder of maps, as one table and one file that is replaced whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.map_agreement import compared, disagreements_of
from edge.reference_map import MapSet, ReferenceMap, open_map_set
from edge.reference_map.learned import Learned, LearnedFolder, Newer, checksum
from edge_plugins.layers.road import Stretch, stretches
from edge_plugins.layers.stored import StoredMap, stored_maps
from edge_plugins.layers.tally import STRETCH_PLACES, Tally, read_tallies
from sim.maps.choice import Choice, choose
from sim.maps.outvoted import outvoted
from sim.maps.placing import moved, newer_positions
from sim.maps.use import Use

MOST_COMPARED, LEAST_WINDOWS = 2000, 100
"""Windows of drives that are compared with those of others, of all drives and at least: about 10 s, see `AT_START`."""
LAYERS = 4
"""Searched of one road, unless said otherwise: a light of the day and one of the night for each way of looking."""
STALE_AFTER = 3
"""Drives: one may pass a lorry that hides a house front, or meet a low sun; three in a light that used to do do not."""
MOST_UNPLACED = 0.2
"""Share of places without a position up to which a drive can be compared with others: a bridge, or the 80 m before a
drive without GPS recognizes the first place; not half a drive."""


@dataclass(frozen=True)
class Lesson:
    """The drives of a folder, which are searched from now on, each with its reason, and what that changes."""

    drives: tuple[StoredMap, ...]
    choice: Choice
    learned: Learned
    positions: Mapping[str, NDArray[np.float64]]

    def keep(self, folder: LearnedFolder) -> None:
        """Let it hold from now on, unless it does already. MapError."""
        if self.learned != folder.newest:
            folder.add(self.learned, self.positions)


def learn(
    folder: Path,
    layers: int = LAYERS,
    stale_after: int = STALE_AFTER,
    is_ours: Callable[[Path], bool] = lambda path: False,
) -> Lesson:
    """What to search of a folder of maps; nothing is changed. MapError.

    is_ours: whether a signed map may be retired, or changed otherwise.
    """
    tallies = read_tallies(folder)
    maps, drives = _opened(folder, tallies)
    windows = compared(maps, max(LEAST_WINDOWS, MOST_COMPARED // max(1, len(maps.maps))))
    found = disagreements_of(maps, windows)
    far = outvoted(maps, found)
    far_m = {number: far[one.path] for number, one in enumerate(maps.maps) if one.path in far}
    changed = {number for number, one in enumerate(drives) if not one.is_signed or is_ours(one.path)}
    newer = newer_positions(maps, windows, found, far_m.keys(), changed)
    maps = moved(maps, newer)
    road, use = stretches(maps.maps), Use(maps.maps, tallies, stale_after)
    forced = _forced(maps.maps, drives, is_ours)
    wrong = {
        number: f"{m:.0f} m from where two or more other drives were"
        for number, m in far_m.items()
        if number not in forced
    }
    stale = _stale(road, use, maps)
    road = [stretch.without(wrong) for stretch in road]
    forced.update(_new(road, use, drives, tallies, forced))
    choice = choose(road, maps.maps, use, layers, forced)
    choice = replace(choice, retired={**choice.retired, **wrong})
    sha256 = [one.header_sha256 for one in maps.headers]
    learned = Learned(
        retired={drives[number].path.name: sha256[number] for number in sorted(choice.retired)},
        stale={sha256[number]: stale[number] for number in sorted(changed & stale.keys())},
        newer={sha256[number]: Newer(checksum(one.rows), one.recording) for number, one in sorted(newer.items())},
    )
    return Lesson(tuple(drives), choice, learned, {sha256[number]: one.rows for number, one in newer.items()})


def _stale(road: Sequence[Stretch], use: Use, maps: MapSet) -> dict[int, list[tuple[int, int]]]:
    """Places [start, end) of each drive that are no longer there, see `Use.is_stale`; neighbors in one piece."""
    found = {
        (number, row // STRETCH_PLACES)
        for stretch in road
        for number, row in stretch.rows.items()
        if use.is_stale(stretch, number)
    }
    pieces: dict[int, list[tuple[int, int]]] = {}
    for number, first in sorted(found):
        if (number, first - 1) not in found:
            end = next(end for end in count(first) if (number, end) not in found)
            rows = first * STRETCH_PLACES, min(end * STRETCH_PLACES, maps.headers[number].places)
            pieces.setdefault(number, []).append(rows)
    return pieces


def _opened(folder: Path, tallies: Sequence[Tally]) -> tuple[MapSet, list[StoredMap]]:
    """All maps of a folder, those that are retired included, in one order. MapError if one cannot be used."""
    maps = open_map_set(folder, as_recorded=True)
    if not maps.is_folder:
        raise MapError(f"{folder}: one map; name the folder that it lies in")
    if maps.excluded:
        raise MapError(f"{maps.excluded[0].why}; delete this map or copy it again first")
    by_path = {one.path: one for one in stored_maps(folder, tallies)}
    return maps, [by_path[one.path] for one in maps.maps]


def _forced(
    maps: Sequence[ReferenceMap], drives: Sequence[StoredMap], is_ours: Callable[[Path], bool]
) -> dict[int, str]:
    """Drives that stay searched, and why."""
    found = {}
    for number, (one, drive) in enumerate(zip(maps, drives, strict=True)):
        if drive.is_kept:
            found[number] = "marked by `map keep`"
        elif drive.is_signed and not is_ours(one.path):
            found[number] = "signed; retired only with its --key"
        elif one.header.tile is not None:
            found[number] = "a tile of a larger map"
        elif float(np.isnan(one.places["lat_deg"]).mean()) > MOST_UNPLACED:
            found[number] = "has places without a position"
    return found


def _new(
    road: Sequence[Stretch], use: Use, drives: Sequence[StoredMap], tallies: Sequence[Tally], forced: Mapping[int, str]
) -> dict[int, str]:
    """Drives that no run could recognize yet, unless on half of their road a newer one is as new."""
    runs = [sum(1 for tally in tallies if tally.began_unix_s < drive.made_unix_s) for drive in drives]
    own: dict[int, list[Stretch]] = {number: [] for number in range(len(drives)) if number not in forced}
    for stretch in road:
        for number in stretch.rows:
            if number in own:
                own[number].append(stretch)
    new = {
        number
        for number, of_it in own.items()
        if of_it and not any(use.is_tried(stretch, runs[number]) for stretch in of_it)
    }
    found = {}
    for number in new:
        newer = {other for other in new if drives[other].made_unix_s > drives[number].made_unix_s}
        covered = sum(1 for stretch in own[number] if newer & stretch.drives)
        if covered < len(own[number]) / 2:
            found[number] = "new: not driven on yet"
    return found
