"""Some ranges of places, or all of them, searched by sequences: equations 2 and 3, and the uniqueness test."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.reference_map import COST_ONE, MapSet, Ranges
from edge.sequence import ORDERS, VIEWS_ALIKE, VIEWS_OPPOSED, Alignment, Direction, Order, PlaceMatch
from edge.sequence.acceptance import Neighbourhood, best_match
from edge.sequence.search import SequenceSearch, slopes_around_diagonal


class Submap:
    """Some ranges of places, searched as if there were no others; within it they are counted from 0."""

    def __init__(self, ranges: Ranges, map_set: MapSet, config: Config, frame: int = 0) -> None:
        """frame: how many frames came before the first that this part will match."""
        self.ranges = ranges
        self._map_set = map_set
        self.places = np.concatenate([np.arange(start, end) for start, end in ranges])
        self._per_frame_order = config.sequence.region_order == "frame"
        self._acceptance = config.acceptance
        pieces = list(map_set.index.by_segment(ranges))
        lengths = [end - start for _, start, end in pieces]
        views = [map_set.index.view(number) for number, _, _ in pieces]
        bounds = list(pairwise(np.cumsum([0, *lengths]).tolist()))
        planes, possible = _planes(bounds, views, map_set.headers[0].regions.count, config)
        slopes = slopes_around_diagonal(config.sequence.slope_limit_rad, config.sequence.slopes)
        self.search = SequenceSearch(bounds, planes, config.sequence.length, slopes, possible, frame)
        self.neighbourhood = Neighbourhood(
            map_set.east_north_m(ranges),
            np.ascontiguousarray(map_set.places_in(ranges)["route_m"]),
            np.repeat(np.array([number for number, _, _ in pieces], dtype=np.int32), lengths),
            config.acceptance,
        )

    def advance(self, costs: NDArray[np.int32], *, replaces_ring: bool) -> PlaceMatch | None:
        """Add cost rows (n, orders, places of the part); the best match now."""
        searched = costs.min(axis=1, keepdims=True) if self._per_frame_order else costs
        if replaces_ring:
            self.search.refill(searched)
        else:
            self.search.push(searched[-1])
        lines = self.search.lines()
        match = best_match(self.search, lines, self.neighbourhood, self._acceptance) if lines else None
        if match is None:
            return None
        # Where every frame took its better order, the line is said to have that of the newest.
        order = ORDERS[int(costs[-1][:, match.place].argmin())] if self._per_frame_order else match.order
        place_index = int(self.places[match.place])
        name, row = self._map_set.locate(place_index)
        return replace(match, place_index=place_index, map=name, place=row, order=order)

    def skip(self) -> None:
        """Add a row of which nothing is known: every place is as far as one with nothing in common."""
        self.search.push(np.full((len(ORDERS), len(self.places)), COST_ONE, dtype=np.int32))

    def recent_costs(self, direction: Direction, order: Order) -> NDArray[np.int32]:
        """The cost rows in the ring, (n, places) oldest first, as a line of that kind sees them."""
        return self.search.recent((direction, "same" if self._per_frame_order else order))

    def clear(self) -> None:
        """Forget all rows."""
        self.search.clear()


def _planes(
    bounds: list[tuple[int, int]], views: list[str], regions: int, config: Config
) -> tuple[list[Alignment], NDArray[np.bool_]]:
    """The directions and region orders to search in, and where (planes, N) each of them is possible.

    bounds, views: of the pieces of segments, numbered within the part.
    """
    sequence = config.sequence
    # One region has no order; and where the better order of each frame counts, the search sees but one.
    orders = ORDERS if regions == 2 and sequence.region_order != "frame" else ORDERS[:1]
    directions: tuple[Direction, ...] = ("forward", "reverse")
    planes = [
        (direction, order) for direction in directions for order in orders if sequence.directions in ("both", direction)
    ]
    possible = np.ones((len(planes), bounds[-1][1]), dtype=bool)
    if sequence.region_order == "rig" and len(orders) == 2:
        for (start, end), view in zip(bounds, views, strict=True):
            allowed = VIEWS_ALIKE if view == config.camera.view else VIEWS_OPPOSED
            possible[:, start:end] = np.array([plane in allowed for plane in planes])[:, np.newaxis]
    used = np.flatnonzero(possible.any(axis=1))
    return [planes[index] for index in used], possible[used]
