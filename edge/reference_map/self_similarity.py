"""Which place elsewhere in a map resembles one of its places most, by the map itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north
from edge.reference_map.costs import CostMatcher

NEIGHBOR_PLACES = 4
"""A place elsewhere is mistaken for a place if it is more similar to it than the places so many before and after."""
ELSEWHERE_M = 80.0
"""From this distance on, over the ground and along the drive, another place is elsewhere."""


@dataclass(frozen=True)
class Rival:
    """The most similar place elsewhere. is_mistaken: whether it is more similar than a place's own neighbors are."""

    row: int
    is_mistaken: bool


def rival(matcher: CostMatcher, descriptors: NDArray[np.int8], places: NDArray[np.void], row: int) -> Rival | None:
    """Of the place in a row, with NEIGHBOR_PLACES places before and after it; None where the map has nothing elsewhere.

    descriptors (R, N, K) int8 and places (N,) of one map. Costs as much as matching one frame.
    """
    costs = matcher.costs_of_encoded(descriptors[:, row : row + 1])[0, 0]
    origin = float(places["lat_deg"][row]), float(places["lon_deg"][row])
    away_m = np.hypot(*east_north(places["lat_deg"], places["lon_deg"], origin).T)
    along_m = np.abs(places["route_m"] - places["route_m"][row])
    elsewhere = np.flatnonzero(np.fmin(away_m, along_m) > ELSEWHERE_M)
    if not elsewhere.size:
        return None
    found = int(elsewhere[costs[elsewhere].argmin()])
    beside = max(int(costs[row - NEIGHBOR_PLACES]), int(costs[row + NEIGHBOR_PLACES]))
    return Rival(found, bool(costs[found] <= beside))
