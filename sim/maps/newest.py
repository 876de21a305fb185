"""Which drives of a folder of maps are searched: of one road the newest of each view and direction, at most so many.

Searched maps cost time with every frame, and a drive is worth most on the next one: it saw today's light and parked
cars. Drives are chosen one after another, first those without which a part of the road would have none that looks its
way, or none of that view and direction, then the newest. One that is not chosen gets a mark in its folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edge.errors import MapError, reason
from edge.reference_map import MapSet, open_map_set
from edge.reference_map.map_folder import RETIRED
from edge_plugins.layers.road import NEEDED, LayerRows, stretches
from edge_plugins.layers.stored import StoredMap, stored_maps

LAYERS = 4
"""Searched of one road, unless said otherwise: two views by two directions."""
MOST_UNPLACED = 0.2
"""Share of places without a position up to which a drive can be compared with others: a bridge, or the 80 m before a
drive without GPS recognizes the first place; not half a drive."""
LEAST_SHARE = 0.25
"""Of its stretches a drive is wanted on, or it is not searched at all: drives end some meters apart, nothing more."""
ROWS_APART = 5
"""Rows of a drive that are read, 10 m apart: a stretch is 25 m."""


@dataclass(frozen=True)
class Choice:
    """The drives of a folder, and why each of them is searched, by its number; the others are retired."""

    drives: tuple[StoredMap, ...]
    searched: Mapping[int, str]

    def mark(self) -> None:
        """Let it hold from the next opening on. MapError where a mark cannot be written.

        Marks are removed before any is made: whenever this is interrupted, too much is searched, and never too little.
        """
        file = None
        try:
            for number in self.searched:
                file = self.drives[number].path / RETIRED
                file.unlink(missing_ok=True)
            for number in set(range(len(self.drives))).difference(self.searched):
                file = self.drives[number].path / RETIRED
                file.touch()
        except OSError as error:
            raise MapError(f"{file}: cannot mark the map: {reason(error)}") from None


def choose(folder: Path, layers: int = LAYERS) -> Choice:
    """What to search of a folder of maps; nothing is changed. MapError.

    layers: at most so many of one road, unless a view would have none.
    """
    maps = open_map_set(folder, with_retired=True)
    if not maps.is_folder:
        raise MapError(f"{folder}: one map; name the folder that it lies in")
    if maps.excluded:
        raise MapError(f"{maps.excluded[0].why}; delete this map or copy it again first")
    by_path = {one.path: one for one in stored_maps(folder)}
    drives = tuple(by_path[one.path] for one in maps.maps)
    return Choice(drives, _searched(stretches(maps.maps, ROWS_APART), maps, drives, layers))


def _searched(road: Sequence[LayerRows], maps: MapSet, drives: Sequence[StoredMap], layers: int) -> dict[int, str]:
    """Why each drive is searched, by its number."""
    own: list[list[LayerRows]] = [[] for _ in drives]
    for stretch in road:
        for number in stretch.rows:
            own[number].append(stretch)
    views = [{segment.view for segment in header.segments} for header in maps.headers]
    searched = _kept(maps, drives) | {number: "passes no road" for number, of_it in enumerate(own) if not of_it}

    def is_unseen(stretch: LayerRows, number: int) -> bool:
        return not stretch.rows.keys() & searched.keys()

    def has_room(stretch: LayerRows, number: int) -> bool:
        return len(stretch.drives & searched.keys()) < layers

    def is_first_of_view(stretch: LayerRows, number: int) -> bool:
        others = stretch.rows.keys() & searched.keys()
        return has_room(stretch, number) and all(views[number] != views[other] for other in others)

    def needed(stretches: int) -> float:
        return min(NEEDED, stretches)

    def some(stretches: int) -> float:
        return LEAST_SHARE * stretches

    rules = (
        ("the only one that looks this way", is_unseen, needed),
        ("the newest of its view and direction", is_first_of_view, some),
        ("one of the newest", has_room, some),
    )
    newest_first = sorted(range(len(drives)), key=lambda number: -drives[number].made_unix_s)
    for why, wants, least in rules:
        for number in newest_first:
            if number not in searched:
                wanted = sum(wants(stretch, number) for stretch in own[number])
                if wanted >= least(len(own[number])):
                    searched[number] = why
    return searched


def _kept(maps: MapSet, drives: Sequence[StoredMap]) -> dict[int, str]:
    """Drives that are searched whatever others there are, and why."""
    found = {}
    for number, (one, drive) in enumerate(zip(maps.maps, drives, strict=True)):
        if drive.is_kept:
            found[number] = "marked by `map keep`"
        elif drive.is_signed:
            found[number] = "signed"
        elif one.header.tile is not None:
            found[number] = "a tile of a larger map"
        elif float(np.isnan(one.places["lat_deg"]).mean()) > MOST_UNPLACED:
            found[number] = "has places without a position"
    return found
