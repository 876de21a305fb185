"""The map of this drive, which is searched while it grows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.reference_map.costs import CostMatcher
from edge.reference_map.store import ReferenceMap

CAPACITY = 200_000
"""Places at most: 400 km at 2 m, 1.6 GB of descriptors."""


@dataclass(frozen=True)
class PartialMap(ReferenceMap):
    """The first places of a growing map, as a map that can be searched.

    matcher: of these places, whose descriptors are renewed. mean, deviation: (R, D) when it was made. keypoints: what
    gives the records (K,) of a place by its row, as far as they are known by then.
    """

    matcher: CostMatcher = field(kw_only=True)
    mean: NDArray[np.float64] = field(kw_only=True)
    deviation: NDArray[np.float64] = field(kw_only=True)
    thumbnails: Callable[[int], bytes] = field(kw_only=True)
    keypoints: NDArray[np.void] | None = field(kw_only=True, default=None)

    def statistics(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and standard deviation (R, D) of all raw descriptors so far. MapError if there are none."""
        if not self.header.places:
            raise MapError(f"{self.path}: no place yet")
        return self.mean, self.deviation

    def thumbnail(self, place: int) -> bytes:
        """The place's small JPEG, for people."""
        return self.thumbnails(place)
