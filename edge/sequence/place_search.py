"""From normalized rows to a match on maps of any size, in one of three modes.

whole: maps of up to `places_per_frame` places together are searched whole with every frame. around: of larger ones,
only the part around the autopilot's position is searched, or around the place that was recognized last. scanning:
where there is neither, one slice is searched with each frame (`GlobalSearch`). Where nothing was believed for a while
around a position, the maps are scanned besides, and the surroundings of what is found are searched as well as those of
the position; in their place, if both are too much for a frame. No frame costs more than its share.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor import NormalizedRows
from edge.reference_map import Drives, MapSet, Ranges
from edge.sequence import NOTHING_KNOWN, Direction, MotionPrior, PlaceMatch, SearchRegion
from edge.sequence.lane import NO_LAGS, Lanes, lags_of, lane_costs
from edge.sequence.submap import GlobalSearch, Submap

PART_SLACK_M = 250.0
"""How much farther than necessary a part reaches, so that it need not be chosen again with every frame."""

REGULAR, REGULAR_SHARE = 0.1, 0.9
"""The places of a map are regularly spaced if so many pieces of half a sequence are within this share of their
median length: single steps differ by more, since a camera that maps has no frame at the very moment."""
ROOM = 1.25
"""Share of what a sequence passed that the next ones have room for: frames need not be evenly apart."""
EXACT = 1e-6
"""Places by which a sum of steps may be inexact."""


@dataclass(frozen=True)
class Everywhere:
    """All places are searched, of maps that are small enough."""


@dataclass(frozen=True)
class Nowhere:
    """Nothing is searched, since nobody knows where: the maps are scanned."""


@dataclass(frozen=True)
class Around:
    """Places around a position; beside: around one that a scan has found, or a belief has confirmed since, as well.

    Where too many places lie there, or none, the maps are scanned until the position or the vehicle has moved on.
    """

    reach: SearchRegion
    beside: SearchRegion | None = None


@dataclass(frozen=True)
class Along:
    """Places before and after one whose position is not known."""

    place_index: int


Where: TypeAlias = Everywhere | Nowhere | Around | Along
Ring = Callable[[], NDArray[np.float32]]
"""All rows of the ring (n, R, D), oldest first, for where the newest one is not enough."""
NearestOf: TypeAlias = Callable[[int], NDArray[np.intp]]
"""See `PlaceSearch.nearest`."""


def is_regular(map_set: MapSet, frames: int) -> bool:
    """Whether the places of the maps are apart by about the same distance, so that lines over so many are straight."""
    half, drives = max(1, frames // 2), map_set.index.segments
    routes_m = [map_set.places["route_m"][first:end] for first, end in drives]
    stretches_m = np.abs(np.concatenate([np.zeros(0), *(route_m[half:] - route_m[:-half] for route_m in routes_m)]))
    stretches_m = stretches_m[~np.isnan(stretches_m)]
    if not stretches_m.size:
        return True
    usual_m = np.median(stretches_m)
    return bool(np.mean(np.abs(stretches_m - usual_m) <= REGULAR * usual_m) >= REGULAR_SHARE)


class PlaceSearch:
    """Cost rows and sequence search, over as many places as a frame may cost.

    part: what is searched now; None while scanning, since it is not known where to look.
    """

    part: Submap | None

    def __init__(self, map_set: MapSet, config: Config, stopwatch: Callable[[str], None] = lambda stage: None) -> None:
        """`stopwatch("matching")` is called when the costs of a frame are computed, and its search begins."""
        self._stopwatch = stopwatch
        self.map_set, self._config = map_set, config
        self._scan = GlobalSearch(config)
        self._lags = lags_of(config, Drives(map_set, config.sampling.spacing_m).spacing_m)
        self._driven = [0.0]
        """Places, at each row of the ring and the one before, the oldest first."""
        self._span: float = config.sequence_frames  # the most places that lines have room for
        self._unbelieved = 0  # frames since a place was believed
        self._is_position_known = False  # of the autopilot, at the newest frame
        self._measured_frames = config.sequence_frames  # in a row of which the distance driven is known
        self._is_regular = is_regular(map_set, config.sequence_frames)
        self._search(Everywhere() if self._is_whole else Nowhere())

    @property
    def _most(self) -> int:
        """Places that a frame may be matched with."""
        return self._config.map.places_per_frame

    @property
    def _is_whole(self) -> bool:
        return self.map_set.index.places <= self._most

    @property
    def folders_in_use(self) -> list[Path]:
        """Of the maps that the next match may rest on, as far as it is known."""
        return self.map_set.folders_of(self.part.ranges) if self.part else []

    @property
    def newest_costs(self) -> NDArray[np.int32]:
        """Costs (orders, places of `part`) of the newest frame, in units of COST_ONE, for those who draw them."""
        return self.part.newest if self.part is not None else np.zeros((1, 0), np.int32)

    def nearest(self, most: int, row: NDArray[np.float32] | None = None) -> NDArray[np.intp]:
        """Places whose left region is nearest to the newest frame's left one, and right to right, the nearest first.

        row: instead of that, a normalized one (R, D) that is in no line.
        """
        part = self.part
        if part is None or not (row is not None or part.newest.size):
            return np.zeros(0, np.intp)
        costs = part.newest[0] if row is None else self.map_set.costs(row[np.newaxis], part.ranges)[0, 0]
        some = np.argpartition(costs, most)[:most] if most < len(costs) else np.arange(len(costs))
        return np.asarray(part.places[some[np.argsort(costs[some], kind="stable")]])

    def clear(self) -> None:
        """Drop all rows (after a gap): the next line begins with the next row."""
        self._scan.restart()
        self._driven = self._driven[-1:]
        self._count_measured(self._config.sequence_frames)
        if self._is_whole and self.part:
            self.part.clear()
        else:
            self._search(Nowhere())

    def grow(self, map_set: MapSet, ring: Ring) -> None:
        """Search a set from now on that has further places after those of the last one; between two frames."""
        was_whole, grows, self.map_set = self._is_whole, map_set.index.places > self.map_set.index.places, map_set
        if self._is_whole and grows:
            before = self.part
            self._search(Everywhere())
            if self.part is not None and before is not None and not before.is_empty:
                self.part.take_over(before, ring(), self._lanes)
        elif was_whole and not self._is_whole:
            self._search(Nowhere())
        elif isinstance(self._where, Around):
            self._search(self._where)

    def push(
        self,
        change: NormalizedRows,
        ring: Ring,
        travel: MotionPrior = NOTHING_KNOWN,
        *,
        step: float = 1.0,
        usual: float = 1.0,
        is_measured: bool = False,
    ) -> PlaceMatch | None:
        """The best match now; None while there are too few rows, or the maps are still being scanned.

        step: places that are as far apart as was driven since the last row. usual: the same from row to row, as a rule.
        is_measured: whether that was measured, so that lines are hardly inclined.
        """
        self._measure(is_measured)
        self._is_position_known = travel.search_region is not None
        if not self._is_whole and travel.search_region is not None:
            self._search_around(travel.search_region)
        self._drive(step, usual)
        if self.part is not None:
            self.part.head(travel.course_rad)
        match = self._advance(change, ring)
        if not self._is_whole and (self.part is None or self._is_doubtful):
            found = self._scan.step(self.map_set, ring(), self._span, self._lanes, travel.course_rad)
            if found is not None and found.uniqueness >= self._config.acceptance.uniqueness_min:
                self._settle(found.place_index)
                return found
        return match

    @property
    def shorter(self) -> PlaceMatch | None:
        """The best line of half a sequence now; None where there is none, or too few frames would be in it."""
        return self.part.shorter if self.part is not None else None

    def best_between(self, first: int, end: int, direction: Direction) -> PlaceMatch | None:
        """The best line that ends at places [first, end) of one drive; None where none of them is searched."""
        return self.part.best_between(first, end, direction) if self.part is not None else None

    def follow(self, place_index: int | None) -> None:
        """Search around the place that is believed, None if there is none, from the next frame on."""
        if self._is_whole:
            return
        self._unbelieved = 0 if place_index is not None else self._unbelieved + 1
        has_beside = isinstance(self._where, Around) and self._where.beside is not None
        if place_index is not None and (has_beside or not self._is_position_known):
            self._follow(place_index)

    @property
    def _is_doubtful(self) -> bool:
        """Whether nothing was believed for so long that other places must be searched."""
        return self._unbelieved > 2 * self._config.sequence_frames

    def _advance(self, change: NormalizedRows, ring: Ring) -> PlaceMatch | None:
        if self.part is None:
            return None
        if any(self._lanes.lags) or self.part.is_empty:
            rows = ring()
            ages = range(len(rows))[::-1] if self.part.is_empty else change.ages
            costs = lane_costs(self.map_set, rows, ages, self.part.ranges, self._lanes)
        else:
            costs = self.map_set.costs(change.rows, self.part.ranges)
        self._stopwatch("matching")
        if self.part.is_empty:
            return self.part.refill(costs, self._driven[-len(costs) :])
        return self.part.push(costs, change.ages, self._driven[-1])

    def _search_around(self, near: SearchRegion) -> None:
        """Search around the position, if the part does not reach as far as it must."""
        where = self._where
        # A position says nothing of maps without any, nor of a place that was recognized on one.
        if not self.map_set.blocks.is_known or (isinstance(where, Along) and not self._is_doubtful):
            return
        must_m = max(near.radius_m, 2 * self._config.acceptance.window_m)
        if not (isinstance(where, Around) and where.reach.holds(near, must_m)):
            reach = SearchRegion(near.lat_deg, near.lon_deg, must_m + PART_SLACK_M)
            self._search(Around(reach, where.beside if isinstance(where, Around) else None))

    def _follow(self, place_index: int) -> None:
        """Move the part on before the vehicle comes to its end."""
        where, around = self._where, self._around(place_index)
        if isinstance(where, Around) and around is not None:
            reach = where.beside or where.reach
            is_far = not reach.holds(around, reach.radius_m - PART_SLACK_M)
        elif isinstance(where, Along) and around is None:
            is_far = abs(place_index - where.place_index) > self._most // 8
        else:
            is_far = True
        if is_far:
            self._settle(place_index)

    def _settle(self, place_index: int) -> None:
        """Search around a place from the next frame on, and around the autopilot's position, which may be right."""
        self._unbelieved = 0
        where, around = self._where, self._around(place_index)
        if around is None:
            self._search(Along(place_index))
        elif isinstance(where, Around) and self._is_position_known:
            self._search(Around(where.reach, around))
        else:
            self._search(Around(around))

    def _around(self, place_index: int) -> SearchRegion | None:
        """A place's own surroundings, None where its position is not known."""
        record = self.map_set.places[place_index]
        if np.isnan(record["lat_deg"]):
            return None
        radius_m = 2 * (PART_SLACK_M + self._config.acceptance.window_m)
        return SearchRegion(float(record["lat_deg"]), float(record["lon_deg"]), radius_m)

    def _search(self, where: Where) -> None:
        """Search there from the next frame on: in the first of some parts that is not too much for a frame."""
        self._where = where
        fits = (some for some in self._parts(where) if 0 < sum(end - start for start, end in some) <= self._most)
        ranges = next(fits, None)
        self.part = self._submap(ranges) if ranges else None

    def _parts(self, where: Where) -> Iterator[Ranges]:
        """What may be searched there, the best first."""
        index = self.map_set.index
        if isinstance(where, Everywhere):
            yield [(0, index.places)]
        elif isinstance(where, Along):
            first, end = index.whole(where.place_index)
            some = self._most // 4
            yield [(max(first, where.place_index - some), min(end, where.place_index + some))]
        elif isinstance(where, Around):
            near, beside = self._within(where.reach), self._within(where.beside) if where.beside else []
            yield index.widened(sorted(near + beside), math.ceil(self._span))
            yield index.widened(beside, math.ceil(self._span))

    def _within(self, reach: SearchRegion) -> Ranges:
        return self.map_set.blocks.within(reach.lat_deg, reach.lon_deg, reach.radius_m)

    def _submap(self, ranges: Ranges) -> Submap:
        return Submap(ranges, self.map_set, self._config, self._span, halves=True, is_measured=self._is_measured)

    @property
    def _lanes(self) -> Lanes:
        """Frames are a distance only where that is measured."""
        return Lanes(self._lags if self._is_measured else NO_LAGS, self._config.camera.view, self._driven)

    @property
    def _is_measured(self) -> bool:
        return self._measured_frames >= self._config.sequence_frames

    def _drive(self, step: float, usual: float) -> None:
        """Count what was driven; lines that pass more places than they have room for need another part.

        So do those that have twice the room that they need. What was driven before the first row is on no line.
        """
        length, now = self._config.sequence_frames, self._driven[-1] + step
        before = self._driven if len(self._driven) > 1 else [now - usual]
        self._driven = [*before, now][-length - 1 :]
        span = length * (now - self._driven[0]) / (len(self._driven) - 1)
        if span > self._span + EXACT or self._span > max(length, 2 * ROOM * span):
            self._span = max(length, ROOM * span)
            self._renew()

    def _measure(self, is_measured: bool) -> None:
        self._count_measured(self._measured_frames + 1 if is_measured and self._is_regular else 0)

    def _count_measured(self, frames: int) -> None:
        """Search other slopes where distance is known now, and was not within the sequence; or the reverse."""
        was_measured, self._measured_frames = self._is_measured, frames
        if self._is_measured != was_measured:
            self._renew()

    def _renew(self) -> None:
        """Match the part anew, whose lines are others now."""
        if self.part is not None:
            self.part = self._submap(self.part.ranges)
