"""Sequence search in a ring buffer of cost rows: equations 2 and 3, exact, in O(N K) a frame whatever the length.

A line of slope v that ends at place i in frame T lies, in frame t, at place i - (r(T) - r(t)) with r(t) = floor(v t +
1/2). Because the rounding hangs on the frame count and not on the line's end, a line and its predecessor share all
frames but two, and with d = r(T) - r(T-1), D = r(T) - r(T-L):

    S(T, i) = S(T-1, i - d) + cost(T, i) - cost(T-L, i - D)

Costs are integers, so the running sums equal the direct ones to the bit. Places before the first count as cost 0 in
the sums; lines that would need them, or would cross from one map segment into the next, are masked in the end.
The way back along the map is the same search in mirrored rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.sequence import ORDERS, Direction, Plane

NO_LINE = np.iinfo(np.int32).max
"""Cost of a place at which no whole line ends."""


def slopes_around_diagonal(limit_rad: float, count: int) -> tuple[float, ...]:
    """`count` slopes (places a frame) at even angles within +-limit_rad of the diagonal (section III-C)."""
    if count == 1:
        return (1.0,)
    return tuple(math.tan(math.pi / 4 + limit_rad * (2 * k / (count - 1) - 1)) for k in range(count))


@dataclass(frozen=True)
class Lines:
    """The lowest line sum that ends at each place: costs (N,) int32 over `length` frames, NO_LINE where none is whole.

    planes: (N,) index into `SequenceSearch.planes`, which direction and region order that line has.
    """

    costs: NDArray[np.int32]
    planes: NDArray[np.intp]
    length: int


class SequenceSearch:
    """The ring of the last `length` cost rows, and the running sum of every line through it."""

    def __init__(
        self,
        segments: Sequence[tuple[int, int]],
        planes: Sequence[Plane],
        length: int,
        slopes: Sequence[float],
        possible: NDArray[np.bool_] | None = None,
        frame: int = 0,
    ) -> None:
        """`segments` are the map's [start, end) in order; a line of a plane has its direction and region order.

        possible: (planes, N), whether a line of that plane may end at that place; everywhere if None. frame: how many
        frames came before, so that searches begun at different times round their slopes alike.
        """
        self.length = length
        self.planes = tuple(planes)
        self._slopes = tuple(slopes)
        self._places = segments[-1][1]
        room = np.stack([_room(segments)[direction] for direction, _ in self.planes])
        if possible is not None:
            room[~np.stack([self._mirror(plane, row) for plane, row in zip(self.planes, possible, strict=True)])] = -1
        self._room = room
        self._ring = np.zeros((length, len(self.planes), self._places), dtype=np.int32)
        self._sums = np.zeros((len(self._slopes), len(self.planes), self._places), dtype=np.int32)
        self._spare = np.empty_like(self._sums)
        self._frame = frame
        self._rows = 0

    def clear(self) -> None:
        """Forget all rows: the next line begins with the next row."""
        self._rows = 0
        self._ring[:] = 0
        self._sums[:] = 0

    def push(self, costs: NDArray[np.int32]) -> None:
        """Add the newest cost row (orders, N) and move every running sum on by one frame."""
        self._frame += 1
        frame = self._frame
        slot = frame % self.length
        leaving = self._ring[slot].copy()  # the row of frame T-L, all zero while the ring is filling
        self._ring[slot] = self._by_plane(costs)
        entering = self._ring[slot]
        for k, slope in enumerate(self._slopes):
            step = _rounded(slope, frame) - _rounded(slope, frame - 1)
            span = _rounded(slope, frame) - _rounded(slope, frame - self.length)
            sums = self._spare[k]
            _shift(self._sums[k], step, out=sums)
            sums += entering
            if span < self._places:
                sums[:, span:] -= leaving[:, : self._places - span]
        self._sums, self._spare = self._spare, self._sums
        self._rows = min(self._rows + 1, self.length)

    def refill(self, rows: NDArray[np.int32]) -> None:
        """Replace the whole ring by rows (n <= length, orders, N), oldest first, the last being a new frame's."""
        self._frame += 1
        self._ring[:] = 0
        self._sums[:] = 0
        self._rows = len(rows)
        for age, costs in enumerate(rows[::-1]):
            frame = self._frame - age
            row = self._ring[frame % self.length]
            row[:] = self._by_plane(costs)
            for k, slope in enumerate(self._slopes):
                offset = _rounded(slope, self._frame) - _rounded(slope, frame)
                if offset < self._places:
                    self._sums[k][:, offset:] += row[:, : self._places - offset]

    def lines(self) -> Lines | None:
        """The best line that ends at each place (eq. 2); None until the ring is full."""
        if self._rows < self.length:
            return None
        best = np.full((len(self.planes), self._places), NO_LINE, dtype=np.int32)
        first = self._frame - self.length + 1
        for k, slope in enumerate(self._slopes):
            offset = _rounded(slope, self._frame) - _rounded(slope, first)
            np.minimum(best, self._sums[k], out=best, where=self._room >= offset)
        in_map_order = np.stack([self._mirror(plane, row) for plane, row in zip(self.planes, best, strict=True)])
        which = in_map_order.argmin(axis=0)
        return Lines(np.take_along_axis(in_map_order, which[np.newaxis], axis=0)[0], which, self.length)

    def recent(self, plane: Plane) -> NDArray[np.int32]:
        """The rows in the ring as that plane's lines see them, (n <= length, N) in map order, oldest first; a copy."""
        slots = [frame % self.length for frame in range(self._frame - self._rows + 1, self._frame + 1)]
        return np.ascontiguousarray(self._mirror(plane, self._ring[slots, self.planes.index(plane)]))

    def slope(self, plane: int, place: int) -> float:
        """Places a frame of the best line of that plane that ends at that place (k of eq. 2)."""
        at = place if self.planes[plane][0] == "forward" else self._places - 1 - place
        first = self._frame - self.length + 1
        whole = [
            (int(sums[plane, at]), slope)
            for sums, slope in zip(self._sums, self._slopes, strict=True)
            if self._room[plane, at] >= _rounded(slope, self._frame) - _rounded(slope, first)
        ]
        return min(whole)[1]

    def _by_plane(self, costs: NDArray[np.int32]) -> NDArray[np.int32]:
        """One cost row (orders, N) as each plane needs it: (planes, N), mirrored for the way back."""
        return np.stack([self._mirror(plane, costs[ORDERS.index(plane[1])]) for plane in self.planes])

    @staticmethod
    def _mirror(plane: Plane, row: NDArray[Any]) -> NDArray[Any]:
        return row[..., ::-1] if plane[0] == "reverse" else row


def _rounded(slope: float, frame: int) -> int:
    return math.floor(slope * frame + 0.5)


def _shift(source: NDArray[np.int32], step: int, out: NDArray[np.int32]) -> None:
    """out[:, i] = source[:, i - step], 0 before the first."""
    out[:, :step] = 0
    out[:, step:] = source[:, : max(0, source.shape[1] - step)]


def _room(segments: Sequence[tuple[int, int]]) -> dict[Direction, NDArray[np.int32]]:
    """How many places a line that ends here may reach back before it leaves its segment: (N,) in search order."""
    lengths = [end - start for start, end in segments]
    return {
        "forward": np.concatenate([np.arange(length, dtype=np.int32) for length in lengths]),
        "reverse": np.concatenate([np.arange(length, dtype=np.int32) for length in lengths[::-1]]),
    }
