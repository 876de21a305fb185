"""Going through a map that is too large for one frame: each frame matches one slice of it with the whole ring.

When all slices have been seen, their best lines are held against each other as if they had been searched at once.
The lines of the first slices are then older than those of the last by as many frames as there are slices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.reference_map.map_set import MapSet
from edge.reference_map.spatial_index import Ranges
from edge.sequence import SequenceMatch
from edge.sequence.submap import Submap

SLICE_SHARE = 8
"""A slice is matched with the whole ring in one product, which takes this many times as long as with one row."""


class GlobalSearch:
    """One pass after another through all places."""

    def __init__(self, atlas: MapSet, config: Config, open_part: Callable[[Ranges], Submap]) -> None:
        """open_part: makes a part of ranges that are open."""
        self._atlas, self._config, self._open_part = atlas, config, open_part
        self._places = atlas.numbering.places
        self._slice = max(1, config.map.places_per_frame // SLICE_SHARE)
        self._at = 0
        self._found: list[SequenceMatch] = []

    def begin(self) -> None:
        """Start at the first place again."""
        self._at, self._found = 0, []

    def step(self, ring: NDArray[np.float32]) -> SequenceMatch | None:
        """Match one slice with the ring (n, R, D); the best match of the whole map at the end of a pass, else None."""
        if len(ring) < self._config.sequence.length:
            return None
        end = min(self._at + self._slice, self._places)
        # Lines that end in the slice may begin before it, or after it on the way back.
        ranges = self._atlas.opened(self._atlas.numbering.widened([(self._at, end)], self._config.sequence.length))
        if ranges:
            match = self._open_part(ranges).advance(self._atlas.costs(ring, ranges), replaces_ring=True)
            self._found += [match] if match else []
        self._at = end
        if end < self._places:
            return None
        best = self._best()
        self.begin()
        return best

    def _best(self) -> SequenceMatch | None:
        """The best of all slices; what is best elsewhere may lie in its own slice or in another."""
        if not self._found:
            return None
        best = min(self._found, key=lambda match: match.cost)
        # Neighbouring slices overlap, and the same place is not elsewhere.
        overlap = 2 * self._config.sequence.length
        others = [match.cost for match in self._found if abs(match.place - best.place) > overlap]
        uniqueness = min([best.uniqueness, *(cost / max(best.cost, 1.0) for cost in others)])
        return replace(best, uniqueness=uniqueness, accepted=uniqueness >= self._config.acceptance.uniqueness_min)
