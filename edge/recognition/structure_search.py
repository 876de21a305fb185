"""Where along all drives of some maps, whose cameras faced the other way, what stands along a vehicle's path fits best.

By how much better than anywhere else is what that place has for itself: a vote, beside those of sequences.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.reference_map import MapSet
from edge.sequence import Direction
from edge.structure.cells import CELL_M, SIDEWAYS_M, WIDE_M, DriveCells, cells_of, scores_of

LONGEST_M, SHORTEST_M = 60.0, 30.0
"""Of the window. By 60 m right places have 3.4 standard deviations of all scores or more (.95), and .999 of others at
most 4.0; by 40 m 2.9 and 4.5."""
MOST_PLACES, FEWEST_M = 2500, 100.0
"""Places that are searched at most, whose cells take 1.7 MB a kilometer; and how long their drives are at least, or
nothing shows what is usual."""
READ_AT_ONCE = 40
"""Places with a frame until all are read: 0.5 ms each."""
ELSEWHERE_M = 30.0
PARTIAL = 0.5
"""Share of the usual energy that a window counts as having where it is partly beyond its drive."""

Floats = NDArray[np.float64]


class BestFit(NamedTuple):
    """Where a vehicle fits best: drive, and meters along it. margin: standard deviations of all scores to the next."""

    drive: int
    direction: Direction
    along_m: float
    margin: float


class _Drive(NamedTuple):
    """One that is searched: its cells, with half a window of nothing at both ends; first_m: where they begin."""

    number: int
    direction: Direction
    first_m: float
    cells: DriveCells


class StructureSearch:
    """The cells of all drives that are passed in opposite views, read a few places at a time."""

    def __init__(self, map_set: MapSet, config: Config, points_of: Callable[[int], Floats]) -> None:
        """points_of: a place's, along its drive, to the left of it, and up (n, 3)."""
        self._points_of = points_of
        index, self._unread = map_set.index, list[tuple[int, Direction, range]]()
        for number, (first, end) in enumerate(index.segments):
            direction: Direction = "reverse" if index.view(number) == config.camera.view else "forward"
            route_m = map_set.places["route_m"][first:end]
            has_points = map_set.headers[index.map_of(first)].keypoints_key is not None
            if has_points and config.sequence.directions in ("both", direction) and np.isfinite(route_m).all():
                self._unread.append((number, direction, range(first, end)))
        if sum(len(places) for _, _, places in self._unread) > MOST_PLACES:
            self._unread.clear()
        self._route_m = map_set.places["route_m"]
        self._read: list[Floats] = []
        self._drives: list[_Drive] = []

    def read_on(self) -> bool:
        """Whether all is read; until then some more places are."""
        if not self._unread:
            return bool(self._drives)
        number, direction, places = self._unread[0]
        some = places[len(self._read) : len(self._read) + READ_AT_ONCE]
        self._read += [self._points_of(place) for place in some]
        if len(self._read) == len(places):
            first_m, last_m = np.floor(self._route_m[places[0]]), np.ceil(self._route_m[places[-1]])
            cells = DriveCells.of(cells_of(np.concatenate(self._read), first_m, last_m, WIDE_M + SIDEWAYS_M))
            beyond = ((round(LONGEST_M / 2), round(LONGEST_M / 2)), (0, 0), (0, 0))
            padded = cells._replace(cells=np.pad(cells.cells.astype(np.float32), beyond))
            self._drives.append(_Drive(number, direction, float(first_m), padded))
            self._unread, self._read = self._unread[1:], []
        return False

    def best(self, points: Floats, window_m: float) -> BestFit | None:
        """Where the middle of a window is, by its points (n, 3) about it: along the vehicle's path, to its left, up."""
        scores = [self._scores(points, window_m, drive) for drive in self._drives]
        every = np.concatenate(scores)
        if len(every) * CELL_M < FEWEST_M:
            return None
        which = int(np.argmax([one.max() for one in scores]))
        at = int(scores[which].argmax())
        best, near = float(scores[which][at]), round(ELSEWHERE_M / CELL_M)
        scores[which][max(0, at - near) : at + near + 1] = -1.0
        margin = (best - max(float(one.max()) for one in scores)) / float(every.std())
        drive = self._drives[which]
        return BestFit(drive.number, drive.direction, drive.first_m + at * CELL_M, margin)

    def _scores(self, points: Floats, window_m: float, drive: _Drive) -> Floats:
        """The best cosine (n,) of those sideways, with the middle of the window at each meter of a drive."""
        sides = (1.0, 1.0, 1.0) if drive.direction == "forward" else (-1.0, -1.0, 1.0)
        window = cells_of(points * sides, -window_m / 2, window_m / 2)
        beyond = round(LONGEST_M / 2)
        places = len(drive.cells.cells) - 2 * beyond
        scores = scores_of(window, drive.cells, beyond - len(window) // 2, places, PARTIAL)
        return np.asarray(scores.max(axis=1))
