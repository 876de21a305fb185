"""What each layer was good for, by the tallies of all drives: in which light it was recognized, and where no more."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Sequence

from edge.reference_map import MapHeader, ReferenceMap
from edge_plugins.layers.road import Stretch
from edge_plugins.layers.stored import keys_of
from edge_plugins.layers.tally import STRETCH_PLACES, Counts, Tally

HALF_LIFE = 20
"""Drives after which a count is worth half: a month of commuting, in which the season changes."""
Runs = defaultdict[tuple[int, int], dict[int, str]]
"""By drive and stretch of it: the light of each run of the daemon."""


class Use:
    """Counts of the tallies by drive and stretch (row // STRETCH_PLACES)."""

    def __init__(self, maps: Sequence[ReferenceMap], tallies: Sequence[Tally], stale_after: int) -> None:
        """tallies: the oldest first. stale_after: see `is_stale`."""
        self._stale_after, self._oldest = stale_after, len(tallies) - HALF_LIFE
        numbers = {key: number for number, one in enumerate(maps) for key in keys_of(one.header, one.path)}
        self._headers = [one.header for one in maps]
        self._frames: defaultdict[tuple[int, int], defaultdict[tuple[str, bool], float]]
        self._frames = defaultdict(lambda: defaultdict(float))
        self._seen: Runs = defaultdict(dict)
        self._missed: Runs = defaultdict(dict)
        self._newest: defaultdict[int, int] = defaultdict(lambda: -1)
        for run, tally in enumerate(tallies):
            weight = 0.5 ** ((len(tallies) - 1 - run) / HALF_LIFE)
            for place, view, direction, light, frames in _rows(tally.recognized, numbers):
                is_same_way = (view == self._view(place)) == (direction == "forward")
                self._frames[place][light, is_same_way] += weight * frames
                self._seen[place][run] = light
            for place, _, _, light, _ in _rows(tally.passed, numbers):
                self._missed[place][run] = light

    def shares(self, stretch: Stretch) -> dict[str, tuple[float, dict[int, float]]]:
        """By light of cameras that looked along a stretch: its share of the frames, and each drive's share of those."""
        found: defaultdict[str, dict[int, float]] = defaultdict(dict)
        for rows, is_same_way in ((stretch.rows, True), (stretch.opposed, False)):
            for number, row in rows.items():
                for (light, same), frames in self._frames.get((number, row // STRETCH_PLACES), {}).items():
                    if same == is_same_way:
                        found[light][number] = found[light].get(number, 0.0) + frames
        totals = {light: sum(frames.values()) for light, frames in found.items()}
        every = sum(totals.values())
        return {
            light: (totals[light] / every, {number: one / totals[light] for number, one in frames.items()})
            for light, frames in found.items()
        }

    def is_tried(self, stretch: Stretch, first_run: int) -> bool:
        """Whether anything was recognized on a stretch in a run from `first_run` on."""
        places = [*_places(stretch.rows), *_places(stretch.opposed)]
        return any(run >= first_run for place in places for run in self._seen.get(place, ()))

    def is_stale(self, stretch: Stretch, number: int) -> bool:
        """Whether what a drive shows of a stretch is no longer there.

        It was recognized, and in `stale_after` runs since then, in a light in which it was, the vehicle passed the
        stretch, and recognized places of one drive before and after it, but nothing on it. Such runs count for
        HALF_LIFE runs: then the stretch, which was not searched meanwhile, is tried again.
        """
        seen = self._seen.get((number, stretch.rows[number] // STRETCH_PLACES), {})
        if not seen:
            return False
        places = [*_places(stretch.rows), *_places(stretch.opposed)]
        by_any = {run for place in places for run in self._seen.get(place, ())}
        missed = {run: light for place in places for run, light in self._missed.get(place, {}).items()}
        lights = set(seen.values())
        first = max(max(seen) + 1, self._oldest)
        since = (run for run, light in missed.items() if run >= first and run not in by_any and light in lights)
        return sum(1 for _ in since) >= self._stale_after

    def _view(self, place: tuple[int, int]) -> str:
        header: MapHeader = self._headers[place[0]]
        starts = [segment.start for segment in header.segments]
        return header.segments[bisect_right(starts, place[1] * STRETCH_PLACES) - 1].view


def _places(rows: dict[int, int]) -> list[tuple[int, int]]:
    return [(number, row // STRETCH_PLACES) for number, row in rows.items()]


def _rows(counts: Counts, numbers: dict[str, int]) -> list[tuple[tuple[int, int], str, str, str, int]]:
    """Drive and stretch, view, direction, light, and how many, of the drives that are here."""
    return [
        ((numbers[key], stretch), *_context(context), many)
        for key, contexts in counts.items()
        if key in numbers
        for context, stretches in contexts.items()
        for stretch, many in stretches.items()
    ]


def _context(context: str) -> tuple[str, str, str]:
    view, direction, light = (*context.split(" ", 2), "", "")[:3]
    return view, direction, light
