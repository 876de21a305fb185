"""Sequence search in a ring buffer of cost rows: equations 2 and 3, exact, in O(N K) a frame whatever the length.

Frame t was exposed when as much had been driven as x(t) places of the map lie apart; x(t) = t where frames and places
are equally far apart, or nobody knows. A line of slope v that ends at place i in frame T lies, in frame t, at place
i - (r(T) - r(t)) with r(t) = floor(v x(t) + 1/2). Because the rounding hangs on what was driven and not on the line's
end, a line and its predecessor share all frames but two, and with d = r(T) - r(T-1), D = r(T) - r(T-L):

    S(T, i) = S(T-1, i - d) + cost(T, i) - cost(T-L, i - D)

Costs are integers, so the running sums equal the direct ones to the bit for ever. The way back along the map is the
same search in mirrored rows. Places before the first count as cost 0 in the sums; lines that would need them, or would
cross from one map segment into the next, are excluded in the end. That is the paper's search. With `open_ends` lines
may also begin before their segment does and before the first frame: each place and frame of which nothing is known
costs COST_ONE, as a place with nothing in common would. Shorter lines have running sums of their own in the same ring,
as long as they are asked for after each row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.reference_map import COST_ONE
from edge.sequence import ORDERS, Alignment, Direction

NO_LINE = np.iinfo(np.int32).max
"""Cost of a place at which no whole line ends."""
FIRST_FRAMES = 16
"""Frames before the first answer with open ends: the deviations of the normalization are not known with fewer."""


def slopes_around_diagonal(limit_rad: float, count: int) -> tuple[float, ...]:
    """`count` slopes (places a frame) at even angles within +-limit_rad of the diagonal (section III-C)."""
    if count == 1:
        return (1.0,)
    return tuple(math.tan(math.pi / 4 + limit_rad * (2 * k / (count - 1) - 1)) for k in range(count))


@dataclass(frozen=True)
class SequenceCosts:
    """The lowest line sum that ends at each place: costs (N,) int32 over `length` frames, NO_LINE where none is whole.

    by_plane: the same of the lines of each of `SequenceSearch.planes` alone.
    """

    costs: NDArray[np.int32]
    by_plane: tuple[NDArray[np.int32], ...]
    length: int

    def plane(self, place: int) -> int:
        """Which plane, that is, which direction and region order, the best line that ends at a place has."""
        return int(np.argmin([costs[place] for costs in self.by_plane]))


class _Sums:
    """The running sums of every slope, each (planes, places) int32. Moving them on moves only where they begin."""

    def __init__(self, slopes: int, planes: int, places: int) -> None:
        self._places = places
        self._slack = max(1024, places // 4)
        self._memory = np.zeros((slopes, planes, self._slack + places), dtype=np.int32)
        self._starts = [self._slack] * slopes

    def fill(self, value: int) -> None:
        """Begin again with sums that are all alike."""
        self._memory[:] = value
        self._starts = [self._slack] * len(self._starts)

    def of(self, slope: int) -> NDArray[np.int32]:
        """The sums of one slope, a view that is good until the next shift."""
        start = self._starts[slope]
        return self._memory[slope, :, start : start + self._places]

    def shift(self, slope: int, step: int) -> NDArray[np.int32]:
        """Sums of which i is what i - step was, 0 before the first."""
        if step > self._starts[slope]:
            # Once in a quarter of the map, so that it hardly counts.
            self._memory[slope, :, self._slack :] = self.of(slope).copy()
            self._starts[slope] = self._slack
        start = self._starts[slope]
        self._memory[slope, :, start - step : start] = 0
        self._starts[slope] = start - step
        return self.of(slope)

    def at(self, planes: NDArray[np.intp], places: NDArray[np.intp]) -> NDArray[np.int32]:
        """Sums at some places of some planes (n,), of every slope: (slopes, n)."""
        slopes, count, width = self._memory.shape
        begins = np.arange(slopes) * (count * width) + self._starts
        return self._memory.reshape(-1).take(begins[:, np.newaxis] + (planes * width + places))


class SequenceSearch:
    """The ring of the last `length` cost rows, and the running sum of every line through all or `shorter` of them."""

    def __init__(
        self,
        segments: Sequence[tuple[int, int]],
        planes: Sequence[Alignment],
        length: int,
        slopes: Sequence[float],
        possible: NDArray[np.bool_] | None = None,
        *,
        span: float | None = None,
        open_ends: bool = False,
        laps: Sequence[int | None] = (),
        shorter: int | None = None,
    ) -> None:
        """`segments` are the map's [start, end) in order; a line of a plane has its direction and region order.

        possible: (planes, N), whether a line of that plane may end at that place; everywhere if None. span: the most
        places that are driven in `length` rows, which open ends must have room for; so many as rows if None. laps: with
        open ends, after how many places each segment goes on at its first one; None where it does not. shorter: rows of
        shorter lines, that are searched as well.
        """
        self.length = length
        self.planes = tuple(planes)
        self._slopes = np.array(slopes)
        self._impossible = None if possible is None or possible.all() else ~possible
        self._span = length if span is None else span
        reach = math.ceil(max(slopes) * self._span) + 1
        self._margin = reach if open_ends else 0
        self._nothing = COST_ONE if open_ends else 0  # cost of a row before the first
        self._open_ends = open_ends
        self._at = np.arange(segments[-1][1])
        for number, (start, end) in enumerate(segments):
            self._at[start:end] += self._margin * (2 * number + 1)
        bounds = [
            (start + self._margin * 2 * number, end + self._margin * (2 * number + 2))
            for number, (start, end) in enumerate(segments)
        ]
        self._places = bounds[-1][1]
        self._laps = laps or [None] * len(segments)
        self._cost_at = self._costs_of_planes(self._known_places(segments, bounds), segments[-1][1])
        self._room = np.stack([_room(bounds)[direction] for direction, _ in self.planes])
        # Only at these, (planes, near) each, do some slopes have a whole line and others not.
        self._near_start = np.nonzero((self._room < reach) & (not open_ends))
        self._ring = np.zeros((length, len(self.planes), self._places), dtype=np.int32)
        lengths = [length, *([shorter] if shorter else [])]
        self._sums = {rows: _Sums(len(slopes), len(self.planes), self._places) for rows in lengths}
        self._kept: set[int] = set()
        """Lengths of which the sums are those of the ring."""
        self._asked_for: set[int] = set()
        """Lengths of which lines were asked for since the last row."""
        self._drive([0.0] * (length + 1))
        self._newest = 0  # slot of the ring
        self.clear()

    def clear(self) -> None:
        """Discard all rows: the next line begins with the next row."""
        self.rows = 0  # in the ring
        # All rows before the first are alike everywhere, so that it does not matter where they were.
        self._drive([self._driven[-1]] * (self.length + 1))
        self._ring[:] = self._nothing
        self._sums[self.length].fill(self._nothing * self.length)
        self._kept = {self.length}

    def _drive(self, driven: list[float]) -> None:
        """Note the places driven at each row of the ring and the one before, (length + 1,), the oldest first.

        _offsets: (length + 1, slopes), how many places lines have passed since the row pushed so many rows ago.
        """
        self._driven = driven
        passed = np.floor(np.outer(driven[::-1], self._slopes) + 0.5).astype(np.intp)
        self._offsets: NDArray[np.intp] = passed[0] - passed

    def _sum_up(self, length: int) -> None:
        """Keep the sums of lines of this length from now on."""
        self._kept.add(length)
        self._sums[length].fill(0)
        for age in range(length):
            self._add(self._sums[length], age, self._ring[(self._newest - age) % self.length])

    def _add(self, sums: _Sums, age: int, row: NDArray[np.int32]) -> None:
        """Add a row (planes, padded N) to the lines through that which was pushed `age` rows ago."""
        for k, offset in enumerate(self._offsets[age].tolist()):
            if offset < self._places:
                sums.of(k)[:, offset:] += row[:, : self._places - offset]

    def push(self, costs: NDArray[np.int32], driven: float | None = None) -> None:
        """Add the newest cost row (orders, N) and move every running sum on by one frame.

        driven: x of it, in all; a place further than the last if None.
        """
        self._newest = (self._newest + 1) % self.length
        self._drive([*self._driven[1:], self._driven[-1] + 1 if driven is None else driven])
        self._kept &= {self.length, *self._asked_for}
        self._asked_for.clear()
        entering, steps = self._by_plane(costs), self._offsets[1].tolist()
        for length in self._kept:
            # The row of frame T-L, all zero while the ring is filling; that of the longest is replaced below.
            leaving = self._ring[(self._newest - length) % self.length]
            for k, (step, span) in enumerate(zip(steps, self._offsets[length].tolist(), strict=True)):
                sums = self._sums[length].shift(k, step)
                sums += entering
                if span < self._places:
                    sums[:, span:] -= leaving[:, : self._places - span]
        self._ring[self._newest] = entering
        self.rows = min(self.rows + 1, self.length)

    def refill(self, rows: NDArray[np.int32], driven: Sequence[float] | None = None) -> None:
        """Replace the whole ring by rows (n <= length, orders, N), oldest first, the last being a new frame's.

        driven: x of each, a place further than the last one's if None.
        """
        known = np.arange(len(rows)) + (self._driven[-1] + 2 - len(rows)) if driven is None else driven
        self._drive([*[float(known[0])] * (self.length + 1 - len(rows)), *(float(x) for x in known)])
        self._ring[:] = self._nothing
        for age, costs in enumerate(rows[::-1]):
            self._ring[(self._newest - age) % self.length] = self._by_plane(costs)
        self.rows, self._kept = len(rows), set()
        self._sum_up(self.length)

    def replace(self, age: int, costs: NDArray[np.int32]) -> None:
        """Replace the cost row (orders, N) that was pushed `age` rows ago, and correct every running sum by it."""
        row = self._ring[(self._newest - age) % self.length]
        change = self._by_plane(costs) - row
        row += change
        for length in self._kept:
            if age < length:
                self._add(self._sums[length], age, change)

    def take_over(self, before: SequenceSearch, costs: NDArray[np.int32]) -> None:
        """Go on from a search with the same planes, of which these places are the first; its rows become these.

        costs (rows, orders, further places): of the rows in its ring, oldest first.
        """
        rows = np.zeros((*costs.shape[:2], len(before._at)), dtype=np.int32)
        for plane in before.planes:
            rows[:, ORDERS.index(plane[1])] = before.recent(plane)
        self.refill(np.concatenate([rows, costs], axis=2), before._driven[len(before._driven) - len(costs) :])

    def lines(
        self, against: Mapping[Direction, NDArray[np.bool_]] = MappingProxyType({}), length: int | None = None
    ) -> SequenceCosts | None:
        """The best line that ends at each place (eq. 2); None until there are enough rows: all, or some with open ends.

        against: places (N,) at which none ends in a direction, by direction. length: rows, of the ring if None.
        """
        length = length or self.length
        if self.rows < (min(length, FIRST_FRAMES) if self._open_ends else length):
            return None
        if length not in self._kept:
            self._sum_up(length)
        self._asked_for.add(length)
        sums = self._sums[length]
        best = sums.of(0).copy()
        for k in range(1, len(self._slopes)):
            np.minimum(best, sums.of(k), out=best)
        if self._near_start[0].size:
            best[self._near_start] = self._whole_near_start(length)
        in_order = (self._mirror(*of) for of in zip(self.planes, best, strict=True))
        by_plane = tuple(row.take(self._at) for row in in_order)
        if self._impossible is not None:
            for row, impossible in zip(by_plane, self._impossible, strict=True):
                row[impossible] = NO_LINE
        for row, (direction, _) in zip(by_plane, self.planes, strict=True):
            if direction in against:
                row[against[direction]] = NO_LINE
        costs = by_plane[0] if len(by_plane) == 1 else np.minimum(*by_plane[:2])
        for other in by_plane[2:]:
            np.minimum(costs, other, out=costs)
        return SequenceCosts(costs, by_plane, length)

    def _whole_near_start(self, length: int) -> NDArray[np.int32]:
        """The best of those lines that do not begin before their segment, (near,), NO_LINE where there is none."""
        is_whole = self._room[self._near_start] >= self._reaches(length)[:, np.newaxis]
        best: NDArray[np.int32] = np.where(is_whole, self._sums[length].at(*self._near_start), NO_LINE).min(axis=0)
        return best

    def _reaches(self, length: int) -> NDArray[np.intp]:
        """How many places the line of each slope has passed within so many rows."""
        reaches: NDArray[np.intp] = self._offsets[length - 1]
        return reaches

    def recent(self, plane: Alignment) -> NDArray[np.int32]:
        """The rows in the ring as that plane's lines see them, (n <= length, N) in map order, oldest first; a copy."""
        slots = np.arange(self._newest - self.rows + 1, self._newest + 1) % self.length
        at = self._mirror(plane, np.arange(self._places))[self._at]
        rows: NDArray[np.int32] = self._ring[slots[:, np.newaxis], self.planes.index(plane), at]
        return rows

    @property
    def step(self) -> float:
        """Places driven from one row to the next, on average."""
        return (self._driven[-1] - self._driven[-self.rows]) / max(1, self.rows - 1)

    def passed(self, plane: int, place: int, length: int | None = None) -> NDArray[np.float64]:
        """Places that the best line of a plane and length that ends there has passed since each row, the newest first.

        That is k of eq. 2 times what was driven since.
        """
        at, length = int(self._at[place]), length or self.length
        at = at if self.planes[plane][0] == "forward" else self._places - 1 - at
        sums = self._sums[length].at(np.array([plane]), np.array([at]))[:, 0]
        whole = np.where(self._room[plane, at] >= self._reaches(length), sums, NO_LINE)
        driven = np.array(self._driven[: -1 - min(self.rows, length) : -1])
        passed: NDArray[np.float64] = self._slopes[int(whole.argmin())] * (driven[0] - driven)
        return passed

    def _known_places(self, segments: Sequence[tuple[int, int]], bounds: Sequence[tuple[int, int]]) -> NDArray[np.intp]:
        """Of each padded place, the place that it is; the number of places where it is none."""
        known = np.full(self._places, segments[-1][1], dtype=np.intp)
        for (start, end), (first, _), lap in zip(segments, bounds, self._laps, strict=True):
            padded = np.arange(start - self._margin, end + self._margin)
            if lap is not None:
                padded = np.where(padded < start, padded + lap, np.where(padded >= end, padded - lap, padded))
            inside = (padded >= start) & (padded < end)
            known[first + np.flatnonzero(inside)] = padded[inside]
        return known

    def _costs_of_planes(self, known: NDArray[np.intp], places: int) -> NDArray[np.intp]:
        """Where each plane's costs (planes, padded N) are among those of all orders, each with one more at its end."""
        of_planes = [self._mirror(plane, known) + ORDERS.index(plane[1]) * (places + 1) for plane in self.planes]
        return np.stack(of_planes)

    def _by_plane(self, costs: NDArray[np.int32]) -> NDArray[np.int32]:
        """One cost row (orders, N) as each plane needs it: (planes, padded N), mirrored for the way back."""
        unknown = np.full((len(costs), 1), COST_ONE, dtype=np.int32)
        return np.concatenate([costs, unknown], axis=1).take(self._cost_at)

    @staticmethod
    def _mirror(plane: Alignment, row: NDArray[Any]) -> NDArray[Any]:
        return row[..., ::-1] if plane[0] == "reverse" else row


def _room(segments: Sequence[tuple[int, int]]) -> dict[Direction, NDArray[np.int32]]:
    """How many places a line that ends here may reach back before it leaves its segment: (N,) in search order."""
    lengths = [end - start for start, end in segments]
    return {
        "forward": np.concatenate([np.arange(length, dtype=np.int32) for length in lengths]),
        "reverse": np.concatenate([np.arange(length, dtype=np.int32) for length in lengths[::-1]]),
    }
