"""Sequence search: running sums against eq. 2 computed directly for every frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from edge.sequence import VIEWS_OPPOSED
from edge.sequence.search import NO_LINE, Lines, SequenceSearch, slopes_around_diagonal
from sim.bench.timing import race
from sim.research.bench.rows import Row, Section, Target, against, at_most

LENGTHS = (10, 40, 80)
GATHERED = 40
SLOPES = slopes_around_diagonal(0.2, 21)


def measure(places: Sequence[int], rounds: int) -> Section:
    """Two lines of planes (directions with their region order), 21 slopes, as the daemon searches."""
    rows: list[Row] = []
    targets: list[Target] = []
    for count in places:
        ours: dict[int, Callable[[], object]] = {length: running(count, length) for length in LENGTHS}
        steady = race({str(length): ours[length] for length in LENGTHS}, rounds)
        size = f"{count:,} places"
        for length in LENGTHS:
            ratio = steady[str(length)].ratio(steady["10"])
            rows.append(Row(f"L = {length}: ours", steady[str(length)], "L = 10", ratio, size=size))
        line = f"L = {GATHERED}"
        times = race({"ours": ours[GATHERED], "direct gather": direct(count, GATHERED)}, max(2, rounds // 5))
        rows.append(against(f"{line}: direct gather", "direct gather", times, "ours", size))
        if count == max(places):
            faster = times["direct gather"].ratio(times["ours"])
            what = f"search, {size}, {line}, against the direct gather"
            targets.append(Target(what, "100x faster", f"{faster:.0f}x faster", faster >= 100))
            targets.append(at_most(f"search, {size}, L = 80 against L = 10", 1.1, steady["80"].ratio(steady["10"])))
    return Section("Sequence search, one frame", rows, targets)


def _rows(places: int, count: int) -> NDArray[np.int32]:
    return np.random.default_rng(places).integers(10_000, 20_000, (count, 2, places), dtype=np.int32)


def running(places: int, length: int) -> Callable[[], Lines | None]:
    """One frame of the daemon's search: a row in, and the best line that ends at each place."""
    search = SequenceSearch([(0, places)], VIEWS_OPPOSED, length, SLOPES)
    *before, newest = _rows(places, length)
    for row in before:
        search.push(row)

    def step() -> Lines | None:
        search.push(newest)
        return search.lines()

    return step


def direct(places: int, length: int) -> Callable[[], NDArray[np.int32]]:
    """Equation 2 as it stands, vectorized over places: for each slope the L costs along each line, gathered, summed."""
    rows = _rows(places, length)
    at = np.arange(places)
    # Rounded as in the frame in which the running sums are full for the first time, so that the two can be compared.
    marks = [np.array([math.floor(slope * frame + 0.5) for frame in range(1, length + 1)]) for slope in SLOPES]

    def step() -> NDArray[np.int32]:
        best = np.full(places, NO_LINE, dtype=np.int32)
        for order, sign in ((1, 1), (0, -1)):
            for passed in marks:
                lines = at - sign * (passed[-1] - passed)[:, np.newaxis]
                inside = ((lines >= 0) & (lines < places)).all(axis=0)
                sums = rows[np.arange(length)[:, np.newaxis], order, lines.clip(0, places - 1)].sum(axis=0)
                np.minimum(best, np.where(inside, sums, NO_LINE), out=best)
        return best

    return step
