"""Some ranges of the places of a set of maps, or all of them, searched as if there were no others."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.reference_map import MapSet, Ranges
from edge.sequence import PlaceMatch
from edge.sequence.acceptance import Neighborhood
from edge.sequence.row_matcher import RowMatcher


class Submap(RowMatcher):
    """A `RowMatcher` of some ranges, whose answers are in coordinates of the maps."""

    def __init__(self, ranges: Ranges, map_set: MapSet, config: Config, frame: int = 0) -> None:
        """frame: how many frames came before the first that this part will match."""
        self.ranges = ranges
        self.places = np.concatenate([np.arange(start, end) for start, end in ranges])
        self._map_set = map_set
        pieces = list(map_set.index.by_segment(ranges))
        lengths = [end - start for _, start, end in pieces]
        neighborhood = Neighborhood(
            map_set.east_north_m(ranges),
            np.ascontiguousarray(map_set.places_in(ranges)["route_m"]),
            np.repeat(np.array([number for number, _, _ in pieces], dtype=np.int32), lengths),
            config.acceptance,
        )
        segments = list(pairwise(np.cumsum([0, *lengths]).tolist()))
        views = [map_set.index.view(number) for number, _, _ in pieces]
        super().__init__(segments, views, map_set.headers[0].regions.count, neighborhood, config, frame)

    def advance(self, costs: NDArray[np.int32], *, replaces_ring: bool) -> PlaceMatch | None:
        """Add cost rows (n, orders, places of the part); the best match now, in coordinates of the maps."""
        match = self.push(costs, replaces_ring=replaces_ring)
        if match is None:
            return None
        place_index = int(self.places[match.place])
        name, row = self._map_set.locate(place_index)
        return replace(match, place_index=place_index, map=name, place=row)
