"""Small maps of roads whose descriptors are alike where they are close, without pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.reference_map import MapSet
from edge_plugins.mapping.builder import Place
from tests.map_of import map_of


def walk(places: int, rng: np.random.Generator, dimensions: int = 256) -> NDArray[np.float32]:
    """Descriptors of a road: neighbors are alike, and places far apart are not."""
    raw = rng.normal(size=(places, 2, dimensions))
    for row in range(1, places):
        raw[row] = 0.75 * raw[row - 1] + np.sqrt(1 - 0.75**2) * raw[row]
    found: NDArray[np.float32] = raw.astype(np.float32)
    return found


def road(path: Path, parts: list[tuple[float, NDArray[np.float32]]]) -> MapSet:
    """A map with a segment for each part, which begins so many meters further north."""
    places: list[Place] = []
    starts = []
    for north_m, raw in parts:
        starts.append(len(places))
        for row in range(len(raw)):
            places.append(Place(len(places), (north_m + 2 * row) / 110_574, 0.0, route_m=2.0 * row))
    return MapSet.of(map_of(path, np.concatenate([raw for _, raw in parts]), places, starts=starts, view="rear"))
