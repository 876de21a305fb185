"""What a map's own descriptors say of it: which drives are closed, and which places are mistaken for others.

A drive is closed if its last places show what comes just before its first ones. Places near each other look alike: how
much, the drive itself says. At the number of places to a lap that fits the ends best, a drive is closed if these are
nearly half as alike as places that far apart along it, and if they lie together, where positions are known. An indoor
track has 0.51 of it; of 90 simulated roads, the closest has 0.35.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north
from edge.reference_map.costs import COST_ONE, CostMatcher
from edge.reference_map.place_index import PlaceIndex
from edge.reference_map.store import ReferenceMap

COMPARED = 32
"""Places at each end that are compared; the ends may overlap by nearly as many."""
NEIGHBORS = 3
"""Places as far apart as this still look alike."""
ALIKE = 0.42
"""Likeness of the ends from which a drive is closed, as a share of that along it."""
TOGETHER_M = 20.0

Floats = NDArray[np.float64]


def lap_places(
    maps: Sequence[ReferenceMap], places: NDArray[np.void], index: PlaceIndex, segments: Sequence[tuple[int, int]]
) -> tuple[int | None, ...]:
    """How many places a lap has, of some segments of the maps; None where the segment is not closed."""
    return tuple(_lap(maps, places, index, *segment) for segment in segments)


def _lap(maps: Sequence[ReferenceMap], places: NDArray[np.void], index: PlaceIndex, start: int, end: int) -> int | None:
    count = min(COMPARED, (end - start) // 3)
    if count <= NEIGHBORS or not _are_together(places[[start, end - 1]]):
        return None
    first, last = (_descriptors(maps, index, *ends) for ends in ((start, start + count), (end - count, end)))
    across, along = _likeness(last, first), _likeness(first, first)
    by_distance = np.array([*(np.diagonal(along, step).mean() for step in range(NEIGHBORS + 1)), 0.0])
    laps = np.arange(end - start - count + NEIGHBORS, end - start + 1)
    apart = np.abs(
        np.subtract.outer(np.arange(end - start - count, end - start), np.arange(count)) - laps[:, None, None]
    )
    expected = by_distance[np.minimum(apart, NEIGHBORS + 1)]
    found, sought = (across * expected).sum(axis=(1, 2)), np.square(expected).sum(axis=(1, 2))
    best = int((found / np.sqrt(sought)).argmax())
    return int(laps[best]) if found[best] >= ALIKE * sought[best] else None


def _descriptors(maps: Sequence[ReferenceMap], index: PlaceIndex, start: int, end: int) -> NDArray[np.int8]:
    """Of places [start, end), (R, n, D)."""
    return np.concatenate([maps[at].descriptors[:, a:b] for at, a, b in index.by_map([(start, end)])], axis=1)


def _likeness(ones: NDArray[np.int8], others: NDArray[np.int8]) -> Floats:
    """Cosine similarity (n, m) of some places to others."""
    return 1 - CostMatcher.of_encoded(others).costs_of_encoded(ones)[:, 0] / COST_ONE


def _are_together(ends: NDArray[np.void]) -> bool:
    """Whether two places are near each other, or one of them is not known."""
    apart_m = float(np.hypot(*np.diff(east_north(ends["lat_deg"], ends["lon_deg"]), axis=0)[0]))
    return not apart_m > TOGETHER_M


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
