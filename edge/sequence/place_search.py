"""From normalised rows to a match on a map of any size: the whole of it, around a position, or a slice a frame.

A map of up to `places_per_frame` places is searched whole with every frame. Of a larger one, only the part around the
autopilot's position is searched, or around the place that was recognised last. Where there is neither, or nothing is
believed there for a while, the map is gone through a slice a frame (`map_scan`). No frame costs more than its share.
The maps of a folder are searched as one; those of them that a part needs are opened first, a few with each frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.normalize import NormalizedRows
from edge.reference_map.map_set import MapSet
from edge.reference_map.spatial_index import Ranges, apart_m
from edge.sequence import SequenceMatch
from edge.sequence.global_search import GlobalSearch
from edge.sequence.submap import Submap

SLACK_M = 250.0
"""So much further than it must does a part reach, so that it need not be chosen anew with every frame."""
OPENED_A_FRAME = 2
MOST_MAPS = 256
"""In a part, however small they are: a process may usually have 1,024 files open."""


@dataclass(frozen=True)
class Near:
    """Where the vehicle is by the autopilot's own account: degrees, and metres that it may be wrong."""

    lat_deg: float
    lon_deg: float
    radius_m: float

    def holds(self, other: Near, radius_m: float) -> bool:
        """Whether all that lies within `radius_m` of the other position does so of this one."""
        away_m = apart_m(self.lat_deg, self.lon_deg, np.array([other.lat_deg]), np.array([other.lon_deg]))
        return bool(away_m[0] + radius_m <= self.radius_m)


class PlaceSearch:
    """Cost rows, sequence search and acceptance, over as much of the map as a frame may cost."""

    def __init__(self, atlas: MapSet, config: Config, stopwatch: Callable[[str], None] = lambda stage: None) -> None:
        """`stopwatch("matching")` is called when the costs of a frame are there, and its search begins."""
        self._stopwatch = stopwatch
        self._atlas, self._config = atlas, config
        self._most = config.map.places_per_frame
        self._is_small = atlas.numbering.places <= self._most and len(atlas.headers) <= MOST_MAPS
        self._scan = GlobalSearch(atlas, config, self._open)
        self._frame = 0
        self._part: Submap | None = None
        self._reach: Near | None = None  # of the part, if it lies around a position
        self._aim: Near | None = None  # around which the next part will lie, once its maps are open
        self._coming_maps: list[int] = []  # what these are
        self._part_maps: list[int] = []
        self._settled = 0  # the place that a part without positions lies around
        self._is_fresh = True  # the part has seen no row of the ring yet
        self._unbelieved = 0
        self._begin()
        orders = atlas.headers[0].regions.count
        self.newest_costs: NDArray[np.int32] = np.zeros((orders, 0), dtype=np.int32)
        """Costs (orders, places of `part`) of the newest frame, in units of COST_ONE, for those who draw them."""

    @property
    def part(self) -> Submap | None:
        """What is searched now; None while the map is gone through, since it is not known where to look."""
        return self._part

    def clear(self) -> None:
        """Forget all rows (after a gap): the next line begins with the next row."""
        self._scan.begin()
        if self._is_small and self._part:
            self._part.clear()
        else:
            self._part = self._reach = self._aim = None
            self._part_maps, self._coming_maps = [], []

    def skip(self) -> None:
        """A place was passed of which there is no frame; the ring that `push` asks for has a row of nothing for it."""
        self._frame += 1
        if self._part is not None and not self._is_fresh:
            self._part.skip()

    def push(
        self, change: NormalizedRows, ring: Callable[[], NDArray[np.float32]], near: Near | None
    ) -> SequenceMatch | None:
        """The best match now; None while too few rows have come, or the map is still being gone through.

        `ring` gives all rows of the ring (n, R, D), oldest first, where those that changed are not enough. MapError if
        no map is left that can be used.
        """
        if len(self._atlas.left_out) != self._left_out:
            self._begin()  # what was searched may be gone
        if not self._is_small:
            self._choose_part(near)
        self._frame += 1
        match = self._match(change, ring, near)
        self._atlas.use(self._needed(match))
        return match

    def _begin(self) -> None:
        """Nothing is known of where to look."""
        whole = self._atlas.opened([(0, self._atlas.numbering.places)]) if self._is_small else None
        self._left_out = len(self._atlas.left_out)
        self._use(whole or [], None)
        self._unbelieved = 0
        self._scan.begin()
        self._atlas.use(self._needed(None))

    def _needed(self, match: SequenceMatch | None) -> list[int]:
        """The maps that must stay open, and that what is told rests on."""
        found = [self._atlas.numbering.map_of(match.place)] if match is not None and match.accepted else []
        return [*self._part_maps, *self._coming_maps, *found]

    def _match(
        self, change: NormalizedRows, ring: Callable[[], NDArray[np.float32]], near: Near | None
    ) -> SequenceMatch | None:
        match = self._advance(change, ring)
        if self._is_small or (match is not None and match.accepted):
            self._unbelieved = 0
            if not self._is_small and near is None and match is not None:
                self._follow(match.place)
            return match
        if self._part is None and self._aim is not None:
            return None  # maps are being opened around a position, and that is the work of a frame
        self._unbelieved += 1
        if self._part is None or self._is_doubtful:
            found = self._scan.step(ring())
            if found is not None and found.accepted:
                self._settle(found.place)
                return found
        return match

    @property
    def _is_doubtful(self) -> bool:
        """Whether nothing has been believed for so long that it must be looked elsewhere."""
        return self._unbelieved > 2 * self._config.sequence.length

    def _advance(self, change: NormalizedRows, ring: Callable[[], NDArray[np.float32]]) -> SequenceMatch | None:
        if self._part is None:
            return None
        rows = NormalizedRows(ring(), replaces_ring=True) if self._is_fresh else change
        self._is_fresh = False
        costs = self._atlas.costs(rows.rows, self._part.ranges)
        self._stopwatch("matching")
        self.newest_costs = costs[-1]
        return self._part.advance(costs, replaces_ring=rows.replaces_ring)

    def _choose_part(self, near: Near | None) -> None:
        """Search around the position, if there is one and the part does not reach as far as it must."""
        is_by_place = self._part is not None and self._reach is None
        # A position says nothing of maps without any, nor of a place that was recognised on one.
        if near is not None and self._atlas.areas.are_known and (not is_by_place or self._is_doubtful):
            must_m = max(near.radius_m, 2 * self._config.acceptance.window_m)
            if not any(one is not None and one.holds(near, must_m) for one in (self._aim, self._reach)):
                self._aim = Near(near.lat_deg, near.lon_deg, must_m + SLACK_M)
        self._take_aim()

    def _follow(self, place: int) -> None:
        """Move the part on before the vehicle comes to its end."""
        reach, around = self._reach, self._around(place)
        if reach is None or around is None:
            far = reach is not None or around is not None or abs(place - self._settled) > self._most // 8
        else:
            far = not reach.holds(around, reach.radius_m - SLACK_M)
        if far and self._aim is None:
            self._settle(place)

    def _settle(self, place: int) -> None:
        """Search around a place from the next frame on."""
        self._unbelieved = 0
        self._aim = self._around(place)
        if self._aim is not None:
            self._take_aim()
            return
        first, end = self._atlas.numbering.whole(place)
        some = self._most // 4
        ranges = self._atlas.opened([(max(first, place - some), min(end, place + some))])
        self._use(ranges or [], None)
        self._settled = place

    def _around(self, place: int) -> Near | None:
        """A place's own surroundings, None where its position is not known."""
        if not self._atlas.opened([(place, place + 1)]):
            return None
        record = self._atlas.records(place, place + 1)[0]
        if np.isnan(record["lat_deg"]):
            return None
        radius_m = 2 * (SLACK_M + self._config.acceptance.window_m)
        return Near(float(record["lat_deg"]), float(record["lon_deg"]), radius_m)

    def _take_aim(self) -> None:
        """Make the part around `_aim` when its maps are open; some of them are opened here, and the rest later."""
        aim = self._aim
        if aim is None:
            return
        ranges = self._atlas.within(aim.lat_deg, aim.lon_deg, aim.radius_m, limit=self._most, at_most=OPENED_A_FRAME)
        if ranges is None:
            return
        ranges = self._atlas.numbering.widened(ranges, self._config.sequence.length)
        maps = self._atlas.numbering.maps_of(ranges)
        if not (0 < _count(ranges) <= self._most and len(maps) <= MOST_MAPS):
            ranges, maps = [], []
        self._coming_maps = maps
        opened = self._atlas.opened(ranges, OPENED_A_FRAME)
        if opened is not None:
            self._use(opened, aim)

    def _use(self, ranges: Ranges, reach: Near | None) -> None:
        """Make some ranges the part that is searched; with none, or too many for a frame, there is no part."""
        self._part = self._open(ranges) if 0 < _count(ranges) <= self._most else None
        self._reach, self._is_fresh = reach, True
        self._aim, self._coming_maps = None, []
        self._part_maps = self._atlas.numbering.maps_of(self._part.ranges) if self._part else []

    def _open(self, ranges: Ranges) -> Submap:
        return Submap(ranges, self._atlas, self._config, self._frame)


def _count(ranges: Ranges) -> int:
    return sum(end - start for start, end in ranges)
