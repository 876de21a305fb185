"""Which places a known position allows, without looking at every place: blocks of neighbours and their bounds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

BLOCK = 64
STEEPEST = 2.0  # places a frame, above the steepest slope of the default limits
Ranges = list[tuple[int, int]]


class Areas:
    """The map in blocks of BLOCK places, each with the rectangle that its places lie in."""

    def __init__(self, east_north_m: NDArray[np.float64]) -> None:
        """east_north_m: (N, 2); NaN where unknown. A block with unknown places is allowed everywhere."""
        self._places = len(east_north_m)
        starts = np.arange(0, self._places, BLOCK)
        # A comparison with NaN is False below, so bounds that are NaN exclude nothing.
        self._low_m = np.minimum.reduceat(east_north_m, starts, axis=0)
        self._high_m = np.maximum.reduceat(east_north_m, starts, axis=0)

    def within(self, east_north_m: NDArray[np.float64], radius_m: float) -> Ranges:
        """[start, end) ranges of places that hold all places within `radius_m` of a point (2,), and some more."""
        outside_m = np.maximum(self._low_m - east_north_m, east_north_m - self._high_m).clip(min=0)
        far = np.square(outside_m).sum(axis=1) > radius_m**2
        return self._merged(~far)

    def _merged(self, wanted: NDArray[np.bool_]) -> Ranges:
        """Runs of wanted blocks as ranges of places."""
        edges = np.flatnonzero(np.diff(wanted.astype(np.int8), prepend=0, append=0))
        return [
            (int(start) * BLOCK, min(int(end) * BLOCK, self._places))
            for start, end in zip(edges[::2], edges[1::2], strict=True)
        ]


def widened(ranges: Ranges, sequence_length: int, places: int) -> Ranges:
    """The ranges with the places that a sequence ending in them may have passed before; merged where they touch."""
    margin = math.ceil(STEEPEST * sequence_length)
    out: Ranges = []
    for start, end in ranges:
        first, last = max(0, start - margin), min(places, end + margin)
        if out and first <= out[-1][1]:
            out[-1] = (out[-1][0], last)
        else:
            out.append((first, last))
    return out
