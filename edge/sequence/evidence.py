"""What speaks for a line: trajectory uniqueness (section IV-B) with its window in meters, sharpness, and width.

The lowest cost alone is a poor confidence, since a vehicle off the map has a lowest cost as well. What matters is how
much worse the best line elsewhere is (perceptual aliasing makes it as good). Elsewhere is in meters: neighbors of a
place are as good as the place itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig
from edge.reference_map import COST_ONE
from edge.sequence import MOST_OFF_COURSE_RAD, ORDERS, Direction, PlaceMatch
from edge.sequence.search import NO_LINE, SequenceCosts, SequenceSearch

BESIDE = 0.3
"""Share of a window between a place and the two beside it that its line is held against. A window is what is driven
within a line, and at least so many places as a line has frames: neighbors are as alike where frames are denser. With a
frame every meter on a map of 2 m, recall was .37 so, and .27 with what was driven alone; every 4 m on a map of 1 m,
.27, and .08 with so many places as frames."""
CHORD_M = 5.0
"""From a place to those whose chord is the way of its road; positions by GPS are wrong by a meter or two."""
SHORT_M = 1.5
"""A chord that is shorter says nothing of a way."""


class Neighborhood:
    """Which places count as the same place as another, for uniqueness."""

    def __init__(
        self,
        east_north_m: NDArray[np.float64],
        route_m: NDArray[np.float64],
        segment_of: NDArray[np.int32],
        config: AcceptanceConfig,
        laps: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        """east_north_m (N, 2), route_m (N,) (NaN where unknown), segment_of (N,).

        laps: how many places a lap has, of those numbers in `segment_of` that are closed.
        """
        self._east_m, self._north_m = np.ascontiguousarray(east_north_m.T)
        self._route_m = route_m
        self._segment_of = segment_of
        self._config = config
        self._laps = laps

    def around(self, place: int) -> NDArray[np.bool_]:
        """Places (N,) within `window_m` of `place`, along its drive or as the crow flies.

        Where the map knows no meters, those within `window_places` of it in its segment.
        """
        window_m = self._config.window_m
        segment = self.segment(place)
        # Comparisons with NaN are False: what is not known is not near.
        east_m, north_m = self._east_m - self._east_m[place], self._north_m - self._north_m[place]
        around: NDArray[np.bool_] = np.square(east_m, out=east_m) + np.square(north_m, out=north_m) <= window_m**2
        if np.isnan(self._route_m[place]):
            near = self._config.window_places
            around[max(segment.start, place - near) : min(segment.stop, place + near + 1)] = True
        else:
            around[segment] |= np.abs(self._route_m[segment] - self._route_m[place]) <= window_m
        lap = self._laps.get(int(self._segment_of[place]))
        if lap is not None:
            self._mark_again(around[segment], self._route_m[segment], place - segment.start, lap)
        return around

    def _mark_again(self, around: NDArray[np.bool_], route_m: NDArray[np.float64], place: int, lap: int) -> None:
        """Mark the neighbors that a place of a closed drive (n,) has a lap before and after it."""
        spacing_m = abs(float(route_m[-1] - route_m[0])) / max(1, len(route_m) - 1)
        near = self._config.window_places if np.isnan(spacing_m) else round(self._config.window_m / spacing_m)
        for image in (place - lap, place + lap):
            around[max(0, image - near) : max(0, image + near + 1)] = True

    def segment(self, place: int) -> slice:
        """The places of the same drive."""
        first, end = np.searchsorted(self._segment_of, [self._segment_of[place], self._segment_of[place] + 1])
        return slice(int(first), int(end))


class Roads:
    """The drives of some places as ways on the ground."""

    def __init__(
        self,
        east_north_m: NDArray[np.float64],
        route_m: NDArray[np.float64],
        segments: Sequence[tuple[int, int]],
        laps: Sequence[int | None],
        config: AcceptanceConfig,
    ) -> None:
        """east_north_m (N, 2), route_m (N,) (NaN where unknown). segments: [start, end) of each drive, laps: as closed.

        What a vehicle goes along may lie as far from the place as `window_m`: it sees ahead, and turns later.
        """
        self._ahead = np.full((2, len(route_m)), np.nan)
        self._around = np.tile(np.arange(len(route_m)), (2, 1))  # the first and the last place within the window
        for (start, end), lap in zip(segments, laps, strict=True):
            here, along_m = slice(start, end), np.abs(route_m[start:end] - route_m[start])
            if end - start < 2 or np.isnan(along_m).any() or (np.diff(along_m) < 0).any():
                continue
            (before, after), at = _within(along_m, CHORD_M), np.arange(end - start)
            before, after = np.minimum(before, at - 1).clip(0), np.maximum(after, at + 1).clip(0, end - start - 1)
            chords_m = (east_north_m[start + after] - east_north_m[start + before]).T
            lengths_m = np.hypot(*chords_m)
            self._ahead[:, here] = np.where(lengths_m > SHORT_M, chords_m / np.maximum(lengths_m, SHORT_M), np.nan)
            if lap is not None:  # it goes on at its beginning
                self._ahead[:, [start, end - 1]] = np.nan
            self._around[:, here] = np.stack(_within(along_m, config.window_m)) + start

    def against(self, course_rad: float) -> dict[Direction, NDArray[np.bool_]]:
        """Places (N,) around which the road nowhere leads along a course, by direction; none where it is unknown."""
        along = math.sin(course_rad) * self._ahead[0] + math.cos(course_rad) * self._ahead[1]
        (first, last), found = self._around, {}
        ways: tuple[tuple[Direction, NDArray[np.float64]], ...] = (("forward", along), ("reverse", -along))
        for direction, ahead in ways:
            against = np.concatenate([[0], np.cumsum(ahead < math.cos(MOST_OFF_COURSE_RAD))])
            found[direction] = against[last + 1] - against[first] == last + 1 - first
        return found


def _within(along_m: NDArray[np.float64], reach_m: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The first and the last place within a distance of each place, by the meters (n,) along their drive."""
    last = np.searchsorted(along_m, along_m + reach_m, side="right") - 1
    return np.searchsorted(along_m, along_m - reach_m), last


def match_at(
    place: int,
    plane: int,
    search: SequenceSearch,
    lines: SequenceCosts,
    newest: NDArray[np.int32],
    neighborhood: Neighborhood,
) -> PlaceMatch:
    """The line of one plane that ends at a place, and what speaks for it. newest: costs (orders, N) of its frame."""
    cost = int(lines.by_plane[plane][place])
    second = int(np.where(neighborhood.around(place), NO_LINE, lines.costs).min())
    direction, order = search.planes[plane]
    segment = neighborhood.segment(place)
    along, at = lines.by_plane[plane][segment], place - segment.start
    of_order = newest[ORDERS.index(order)] if len(newest) > 1 else newest[0]
    passed, window = search.passed(plane, place, lines.length), lines.length * max(1.0, search.step)
    return PlaceMatch(
        place_index=place,
        place=place,
        direction=direction,
        order=order,
        slope=float(passed[-1]) / max(1, len(passed) - 1),
        distance=cost / lines.length / COST_ONE,
        # With nothing whole outside the window there is nothing to compare with, so nothing is claimed.
        uniqueness=second / max(cost, 1) if second != NO_LINE else 1.0,
        sharpness=sharpness(along, at, window),
        row_share=np.count_nonzero(newest.min(axis=0) < lowest_around(of_order[segment], at, window)) / newest.shape[1],
        step=search.step,
        passed=tuple(passed.tolist()),
    )


def sharpness(costs: NDArray[np.int32], place: int, window: float) -> float:
    """Cost of the cheaper line that ends 0.3 windows away over that of `place`, less 1; 0 where there is none.

    costs: (n,) line costs of one segment. window: in places. A road that only resembles this kind of road is not sharp.
    """
    step = max(1, round(BESIDE * window))
    beside = [int(costs[at]) for at in (place - step, place + step) if 0 <= at < len(costs) and costs[at] != NO_LINE]
    return min(beside) / max(int(costs[place]), 1) - 1 if beside else 0.0


def lowest_around(row: NDArray[np.int32], place: int, window: float) -> int:
    """The lowest cost of a row (n,) of one segment within an eighth of a window of a place."""
    reach = max(1, int(window / 8))
    return int(row[max(0, place - reach) : place + reach + 1].min())


class HoldOff:
    """When the next event may follow: it lets one through, and the next after `hold_off_s`."""

    def __init__(self, hold_off_s: float) -> None:
        self._hold_off_ns = round(hold_off_s * 1e9)
        self._last_ns: int | None = None

    def passes(self, stamp_ns: int) -> bool:
        """True if an event at this time is due; it then counts as sent."""
        if self._last_ns is not None and 0 <= stamp_ns - self._last_ns < self._hold_off_ns:
            return False
        self._last_ns = stamp_ns
        return True
