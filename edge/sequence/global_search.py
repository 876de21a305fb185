"""Scanning maps that are too large for one frame: each frame matches one slice of them with the whole ring.

When all slices have been matched, their best lines are compared as if they had been searched at once. The lines of the
first slices are then older than those of the last by as many frames as there are slices.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.reference_map import COST_ONE, MapSet
from edge.sequence import PlaceMatch
from edge.sequence.parallax import Lanes, lane_costs
from edge.sequence.submap import Submap

SLICE_SHARE = 8
"""A slice is matched with the whole ring in one product, which takes this many times as long as with one row."""


class GlobalSearch:
    """One pass after another through all places."""

    def __init__(self, map_set: MapSet, config: Config) -> None:
        self._map_set, self._config = map_set, config
        self._slice = max(1, config.map.places_per_frame // SLICE_SHARE)
        self.restart()

    def grow(self, map_set: MapSet) -> None:
        """Scan a set that has further places after those of the last one."""
        self._map_set = map_set

    def restart(self) -> None:
        """Start at the first place again."""
        self._next = 0
        self._found: list[PlaceMatch] = []

    def step(self, ring: NDArray[np.float32], span: float, lanes: Lanes) -> PlaceMatch | None:
        """Match one slice with the ring (n, R, D); the best match of all maps at the end of a pass, else None.

        span: the most places within a line, see `SequenceSearch`. lanes: see `lane_costs`.
        """
        if len(ring) < self._config.sequence.length:
            return None
        end = min(self._next + self._slice, self._map_set.index.places)
        # Lines that end in the slice may begin before it, or after it on the way back.
        ranges = self._map_set.index.widened([(self._next, end)], math.ceil(span))
        slice_of_maps = Submap(ranges, self._map_set, self._config, span)
        ages = range(len(ring))[::-1]
        costs = lane_costs(self._map_set, ring, ages, ranges, lanes)
        match = slice_of_maps.refill(costs, lanes.driven[-len(ring) :])
        self._map_set.release(ranges)  # or a pass would map every descriptor there is
        self._found += [match] if match else []
        self._next = end
        if end < self._map_set.index.places:
            return None
        best = self._best()
        self.restart()
        return best

    def _best(self) -> PlaceMatch | None:
        """The best of all slices; what is best elsewhere may lie in its own slice or in another."""
        if not self._found:
            return None
        best = min(self._found, key=lambda match: match.distance)
        # Neighboring slices overlap, and the same place is not elsewhere.
        overlap = 2 * self._config.sequence.length
        others = [match.distance for match in self._found if abs(match.place_index - best.place_index) > overlap]
        uniqueness = min([best.uniqueness, *(other / max(best.distance, 1 / COST_ONE) for other in others)])
        return replace(best, uniqueness=uniqueness)
