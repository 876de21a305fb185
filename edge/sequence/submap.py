"""Cost rows in, matches out: the search of equations 2 and 3 and the uniqueness test, on a part of the maps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.geodesy import east_north_of
from edge.reference_map import COST_ONE, MapSet, Ranges
from edge.sequence import ORDERS, VIEWS_ALIKE, VIEWS_OPPOSED, Alignment, Direction, PlaceMatch
from edge.sequence.evidence import Neighborhood, Roads, match_at
from edge.sequence.lane import Lanes, lane_costs
from edge.sequence.search import FIRST_FRAMES, NO_LINE, SequenceCosts, SequenceSearch, slopes_around_diagonal

Segments = list[tuple[int, int]]
SLOPES = 21
"""Slopes that are searched within `[sequence] slope_limit_rad` of the diagonal."""
MEASURED_SLOPE_RAD = 0.05
"""Limit of the slopes where the distance between places is measured: an odometer is wrong by a tenth at most. In a
wider one, lines drift away from a vehicle that leaves its lane, whose regions then show places that are apart."""
MEASURED_SLOPES = 11
"""Slopes up to that limit; over 40 frames they are one place apart."""


class RowMatcher:
    """Matches rows of costs to places that are counted from 0; whatever the costs were made of.

    lines: the best line that ends at each place, after the newest row; None before the ring is full.
    """

    lines: SequenceCosts | None = None
    _against: Mapping[Direction, NDArray[np.bool_]] = MappingProxyType({})
    """Places (N,) that the vehicle cannot pass in a direction."""

    def __init__(
        self,
        segments: Sequence[tuple[int, int]],
        views: Sequence[str],
        regions: int,
        neighborhood: Neighborhood,
        config: Config,
        *,
        span: float | None = None,
        open_ends: bool = False,
        laps: Sequence[int | None] = (),
        halves: bool = False,
        is_measured: bool = False,
    ) -> None:
        """segments: [start, end) of each drive, in order; views: front or rear, of each. regions: of a descriptor.

        config: [sequence], and the view of [camera]. open_ends: whether lines may begin before their drive does, and
        span, laps: see `SequenceSearch`. halves: whether lines of half as many rows are searched as well, where these
        are enough for an answer. is_measured: whether the distance between rows is.
        """
        self.neighborhood = neighborhood
        planes, possible = _planes(segments, views, regions, config)
        limit_rad = min(config.sequence.slope_limit_rad, MEASURED_SLOPE_RAD if is_measured else math.inf)
        slopes = slopes_around_diagonal(limit_rad, MEASURED_SLOPES if is_measured else SLOPES)
        half = config.sequence_frames // 2
        self._half = half if halves and half >= FIRST_FRAMES else None
        self._search = SequenceSearch(
            segments,
            planes,
            config.sequence_frames,
            slopes,
            possible,
            span=span,
            open_ends=open_ends,
            laps=laps,
            shorter=self._half,
        )
        self.newest: NDArray[np.int32] = np.zeros((1, 0), dtype=np.int32)
        """Costs (orders, N) of the newest row, in units of COST_ONE."""

    @property
    def is_empty(self) -> bool:
        """Whether there is no row yet."""
        return self._search.rows == 0

    def push(
        self, costs: NDArray[np.int32], ages: Sequence[int] = (0,), driven: float | None = None
    ) -> PlaceMatch | None:
        """Add cost rows (n, orders, N), the new one first, and replace older ones; the best match.

        ages: see `NormalizedRows`. driven: see `SequenceSearch.push`.
        """
        self._search.push(costs[0], driven)
        self.newest = costs[0]
        for age, row in zip(ages[1:], costs[1:], strict=True):
            self._search.replace(age, row)
        return self._best()

    def refill(self, costs: NDArray[np.int32], driven: Sequence[float] | None = None) -> PlaceMatch | None:
        """Replace the whole ring by cost rows (n, orders, N), oldest first; the best match. driven: of each row."""
        self._search.refill(costs, driven)
        self.newest = costs[-1]
        return self._best()

    def _best(self) -> PlaceMatch | None:
        self.lines = self._search.lines(self._against)
        return self._best_of(self.lines)

    @property
    def shorter(self) -> PlaceMatch | None:
        """The best line of half as many rows; None where none are searched. It costs nothing where nobody asks."""
        return self._best_of(self._search.lines(self._against, self._half)) if self._half else None

    def _best_of(self, lines: SequenceCosts | None) -> PlaceMatch | None:
        if lines is None:
            return None
        best = int(lines.costs.argmin())
        return self._match(best, lines.plane(best), lines)

    def _match(self, place: int, plane: int, lines: SequenceCosts) -> PlaceMatch | None:
        """The line of that plane that ends at a place; None where no whole one does."""
        if lines.by_plane[plane][place] == NO_LINE:
            return None
        return match_at(place, plane, self._search, lines, self.newest, self.neighborhood)

    def clear(self) -> None:
        """Remove all rows."""
        self._search.clear()
        self.lines = None


class Submap(RowMatcher):
    """A `RowMatcher` of some ranges, whose answers are in coordinates of the maps."""

    def __init__(
        self,
        ranges: Ranges,
        map_set: MapSet,
        config: Config,
        span: float | None = None,
        *,
        halves: bool = False,
        is_measured: bool = False,
    ) -> None:
        """span: the most places that may be driven within a line, so many as frames if None. Others: as above."""
        self.ranges = ranges
        self.places = np.concatenate([np.arange(start, end) for start, end in ranges])
        self._map_set, self._origin = map_set, map_set.origin(ranges)
        pieces = list(map_set.index.by_segment(ranges))
        lengths = [end - start for _, start, end in pieces]
        laps = [map_set.laps[number] if map_set.index.segment(number) == (a, b) else None for number, a, b in pieces]
        segments = list(pairwise(np.cumsum([0, *lengths]).tolist()))
        east_north_m = map_set.east_north_m(ranges)
        self._ground_m = np.ascontiguousarray(east_north_m[~np.isnan(east_north_m[:, 0])].T, np.float32)
        route_m = np.ascontiguousarray(map_set.places_in(ranges)["route_m"])
        self._roads = Roads(east_north_m, route_m, segments, laps, config.acceptance)
        neighborhood = Neighborhood(
            east_north_m,
            route_m,
            np.repeat(np.array([number for number, _, _ in pieces], dtype=np.int32), lengths),
            config.acceptance,
            {number: lap for (number, _, _), lap in zip(pieces, laps, strict=True) if lap is not None},
        )
        views, regions = [map_set.index.view(number) for number, _, _ in pieces], map_set.headers[0].regions.count
        super().__init__(
            segments,
            views,
            regions,
            neighborhood,
            config,
            span=span,
            open_ends=True,
            laps=laps,
            halves=halves,
            is_measured=is_measured,
        )

    def take_over(self, before: Submap, ring: NDArray[np.float32], lanes: Lanes) -> None:
        """Go on from a part that has the first of these places, so that only the others are matched with the ring.

        ring: its rows (n, R, D), oldest first. lanes: see `lane_costs`. Where the others can be passed in other
        directions or region orders, this part stays empty, and has to be matched with all rows.
        """
        if before._search.planes != self._search.planes:
            return
        further = [(len(before.places), len(self.places))]
        costs = lane_costs(self._map_set, ring, range(len(ring))[::-1], further, lanes)
        self._search.take_over(before._search, costs)

    def head(self, course_rad: float | None) -> None:
        """Search from the next row on only what leads along a course; everything if that is not known."""
        self._against = {} if course_rad is None else self._roads.against(course_rad)

    def squares_m2(self, lat_deg: float, lon_deg: float) -> NDArray[np.float32]:
        """Squares (n,) of the meters from a position to each place that has one."""
        if self._origin is None:
            return np.zeros(0, np.float32)
        east_m, north_m = east_north_of(lat_deg, lon_deg, self._origin)
        square, other = self._ground_m[0] - np.float32(east_m), self._ground_m[1] - np.float32(north_m)
        square *= square
        other *= other
        return np.asarray(square + other)

    @property
    def excludes(self) -> bool:
        """Whether lines against the course are not searched."""
        return any(bool(of.any()) for of in self._against.values())

    def best_between(self, first: int, end: int, direction: Direction) -> PlaceMatch | None:
        """The best line in a direction that ends at places [first, end) of one drive; None where this part has none."""
        start, stop = (int(at) for at in np.searchsorted(self.places, [first, end]))
        if self.lines is None or start >= stop:
            return None
        planes = [number for number, plane in enumerate(self._search.planes) if plane[0] == direction]
        costs = np.stack([self.lines.by_plane[plane][start:stop] for plane in planes])
        number, at = np.unravel_index(int(costs.argmin()), costs.shape)
        return self._match(start + int(at), planes[number], self.lines)

    def _match(self, place: int, plane: int, lines: SequenceCosts) -> PlaceMatch | None:
        match = super()._match(place, plane, lines)
        if match is None:
            return None
        place_index = int(self.places[place])
        name, row = self._map_set.locate(place_index)
        return replace(match, place_index=place_index, map=name, place=row)


def _planes(
    segments: Sequence[tuple[int, int]],
    views: Sequence[str],
    regions: int,
    config: Config,
) -> tuple[list[Alignment], NDArray[np.bool_]]:
    """The directions and region orders to search in, and where (planes, N) each of them is possible."""
    sequence = config.sequence
    orders = ORDERS[:regions]  # one region has no order
    directions: tuple[Direction, ...] = ("forward", "reverse")
    planes = [
        (direction, order) for direction in directions for order in orders if sequence.directions in ("both", direction)
    ]
    possible = np.ones((len(planes), segments[-1][1]), dtype=bool)
    if len(orders) == 2:
        for (start, end), view in zip(segments, views, strict=True):
            allowed = VIEWS_ALIKE if view == config.camera.view else VIEWS_OPPOSED
            possible[:, start:end] = np.array([plane in allowed for plane in planes])[:, np.newaxis]
    used = np.flatnonzero(possible.any(axis=1))
    return [planes[index] for index in used], possible[used]


SLICE_SHARE = 8
"""A slice is matched with the whole ring in one product, which takes this many times as long as with one row."""


class GlobalSearch:
    """Scans maps that are too large for one frame: each frame matches one slice of them with the whole ring.

    When all slices have been matched, their best lines are compared as if they had been searched at once. The lines of
    the first slices are then older than those of the last by as many frames as there are slices.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._slice = max(1, config.map.places_per_frame // SLICE_SHARE)
        self.restart()

    def restart(self) -> None:
        """Start at the first place again."""
        self._next = 0
        self._found: list[PlaceMatch] = []

    def step(
        self, maps: MapSet, ring: NDArray[np.float32], span: float, lanes: Lanes, course_rad: float | None = None
    ) -> PlaceMatch | None:
        """Match one slice with the ring (n, R, D); the best match of all maps at the end of a pass, else None.

        maps: the same during a pass, but for further places at their end. span: the most places within a line, see
        `SequenceSearch`. lanes: see `lane_costs`. course_rad: see `MotionPrior`.
        """
        if len(ring) < self._config.sequence_frames:
            return None
        end = min(self._next + self._slice, maps.index.places)
        # Lines that end in the slice may begin before it, or after it on the way back.
        ranges = maps.index.widened([(self._next, end)], math.ceil(span))
        slice_of_maps = Submap(ranges, maps, self._config, span)
        slice_of_maps.head(course_rad)
        ages = range(len(ring))[::-1]
        costs = lane_costs(maps, ring, ages, ranges, lanes)
        match = slice_of_maps.refill(costs, lanes.driven[-len(ring) :])
        maps.release(ranges)  # or a pass would map every descriptor there is
        self._found += [match] if match else []
        self._next = end
        if end < maps.index.places:
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
        overlap = 2 * self._config.sequence_frames
        others = [match.distance for match in self._found if abs(match.place_index - best.place_index) > overlap]
        uniqueness = min([best.uniqueness, *(other / max(best.distance, 1 / COST_ONE) for other in others)])
        return replace(best, uniqueness=uniqueness)
