"""One open map of an atlas: its places in local metres, the matcher of its descriptors, and what is left to check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.reference_map.checksums import Checksums
from edge.reference_map.costs import CostMatcher
from edge.reference_map.route import east_north, first_known
from edge.reference_map.spatial_index import SpatialIndex
from edge.reference_map.store import ReferenceMap, open_unverified

Origin = tuple[float, float]
"""Latitude and longitude that local metres are counted from."""


class LoadedMap:
    """An open map; what it costs to open grows with its places, about 1 ms each 5,000 of them."""

    def __init__(self, reference_map: ReferenceMap, verification: Checksums) -> None:
        self.map, self.verification = reference_map, verification
        self.matcher = CostMatcher.of(reference_map)
        places, tile = reference_map.places, reference_map.header.tile
        self.route_m: NDArray[np.float64] = np.ascontiguousarray(places["route_m"])
        self.origin = tile.origin if tile else first_known(places["lat_deg"], places["lon_deg"])
        self._metres: tuple[Origin | None, NDArray[np.float64]] | None = None

    @classmethod
    def open(cls, path: Path) -> LoadedMap:
        """Open the map at a path, its large files yet to be verified. MapError."""
        return cls(*open_unverified(path))

    def east_north_m(self, origin: Origin | None) -> NDArray[np.float64]:
        """Metres east and north of an origin, (N, 2); NaN where unknown."""
        if self._metres is None or self._metres[0] != origin:
            places = self.map.places
            self._metres = origin, east_north(places["lat_deg"], places["lon_deg"], origin)
        return self._metres[1]

    def areas(self) -> SpatialIndex:
        """Where its blocks of places lie, in metres from its own origin."""
        return SpatialIndex(self.east_north_m(self.origin))
