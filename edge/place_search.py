"""From normalised rows to a match on a map of any size: the whole of it, around a position, or a slice a frame.

A map of up to `places_per_frame` places is searched whole with every frame. Of a larger one, only the part around the
autopilot's position is searched, or around the place that was recognised last. Where there is neither, or nothing is
believed there for a while, the map is gone through a slice a frame (`map_scan`). No frame costs more than its share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.normalize import NormalizedRows
from edge.map_part import MapPart
from edge.map_scan import MapScan
from edge.reference_map.areas import Areas, Ranges, widened
from edge.reference_map.costs import CostMatcher
from edge.reference_map.route import Route
from edge.reference_map.store import ReferenceMap
from edge.sequence import SequenceMatch

SLACK_M = 250.0
"""So much further than it must does a part reach, so that it need not be chosen anew with every frame."""


@dataclass(frozen=True)
class Near:
    """Where the vehicle is by the autopilot's own account: degrees, and metres that it may be wrong."""

    lat_deg: float
    lon_deg: float
    radius_m: float


class PlaceSearch:
    """Cost rows, sequence search and acceptance, over as much of the map as a frame may cost."""

    def __init__(
        self,
        reference_map: ReferenceMap,
        route: Route,
        config: Config,
        stopwatch: Callable[[str], None] = lambda stage: None,
    ) -> None:
        """`stopwatch("matching")` is called when the costs of a frame are there, and its search begins."""
        self._stopwatch = stopwatch
        header = reference_map.header
        self._header, self._route, self._config = header, route, config
        self._matcher = CostMatcher.of(reference_map)
        self._areas = Areas(route.east_north_m)
        self._frame = 0
        self._is_small = header.places <= config.map.places_per_frame
        self._part = self._open([(0, header.places)]) if self._is_small else None
        self._reach: tuple[NDArray[np.float64], float] | None = None  # centre and radius of the part, if it has one
        self._is_fresh = True  # the part has seen no row of the ring yet
        self._scan = MapScan(header.places, config, self._open, self._costs)
        self._unbelieved = 0
        self.newest_costs: NDArray[np.int32] = np.zeros((self._matcher.orders, 0), dtype=np.int32)
        """Costs (orders, places of `part`) of the newest frame, in units of COST_ONE, for those who draw them."""

    @property
    def part(self) -> MapPart | None:
        """What is searched now; None while the map is gone through, since it is not known where to look."""
        return self._part

    def clear(self) -> None:
        """Forget all rows (after a gap): the next line begins with the next row."""
        self._scan.begin()
        if self._is_small and self._part:
            self._part.clear()
        else:
            self._part = self._reach = None

    def push(
        self, change: NormalizedRows, ring: Callable[[], NDArray[np.float32]], near: Near | None
    ) -> SequenceMatch | None:
        """The best match now; None while too few rows have come, or the map is still being gone through.

        `ring` gives all rows of the ring (n, R, D), oldest first, where those that changed are not enough.
        """
        if not self._is_small:
            self._choose_part(near)
        self._frame += 1
        match = self._advance(change, ring)
        if self._is_small or (match is not None and match.accepted):
            self._unbelieved = 0
            if not self._is_small and near is None and match is not None:
                self._follow(match.place)
            return match
        self._unbelieved += 1
        if self._part is None or self._unbelieved > 2 * self._config.sequence.length:
            found = self._scan.step(ring())
            if found is not None and found.accepted:
                self._settle(found.place)
                return found
        return match

    def _advance(self, change: NormalizedRows, ring: Callable[[], NDArray[np.float32]]) -> SequenceMatch | None:
        if self._part is None:
            return None
        rows = NormalizedRows(ring(), replaces_ring=True) if self._is_fresh else change
        self._is_fresh = False
        costs = self._costs(rows.rows, self._part.ranges)
        self._stopwatch("matching")
        self.newest_costs = costs[-1]
        return self._part.advance(costs, replaces_ring=rows.replaces_ring)

    def _choose_part(self, near: Near | None) -> None:
        """Search around the position, if there is one and the part does not reach as far as it must."""
        if near is None:
            return
        centre = self._route.east_north(near.lat_deg, near.lon_deg)
        must_m = max(near.radius_m, 2 * self._config.acceptance.window_m)
        if self._reach is None or np.hypot(*(centre - self._reach[0])) + must_m > self._reach[1]:
            self._search_around(centre, must_m + SLACK_M)

    def _follow(self, place: int) -> None:
        """Move the part on before the vehicle comes to its end."""
        centre = self._route.east_north_m[place]
        if self._reach is None or not np.hypot(*(centre - self._reach[0])) <= SLACK_M:
            self._settle(place)

    def _settle(self, place: int) -> None:
        """Search around a place from the next frame on."""
        centre = self._route.east_north_m[place]
        self._unbelieved = 0
        if np.isnan(centre).any():
            some = self._config.map.places_per_frame // 4
            self._use([(max(0, place - some), min(self._header.places, place + some))], None)
        else:
            self._search_around(centre, 2 * (SLACK_M + self._config.acceptance.window_m))

    def _search_around(self, centre: NDArray[np.float64], radius_m: float) -> None:
        ranges = self._areas.within(centre, radius_m)
        self._use(widened(ranges, self._config.sequence.length, self._header.places), (centre, radius_m))

    def _use(self, ranges: Ranges, reach: tuple[NDArray[np.float64], float] | None) -> None:
        """Make some ranges the part that is searched; with none, or too many for a frame, there is no part."""
        count = sum(end - start for start, end in ranges)
        self._part = self._open(ranges) if 0 < count <= self._config.map.places_per_frame else None
        self._reach, self._is_fresh = reach, True

    def _open(self, ranges: Ranges) -> MapPart:
        return MapPart(ranges, self._header, self._route, self._config, self._frame)

    def _costs(self, rows: NDArray[np.float32], ranges: Ranges) -> NDArray[np.int32]:
        return self._matcher.costs(rows, ranges)
