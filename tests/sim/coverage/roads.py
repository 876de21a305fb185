"""Small maps of roads whose descriptors are alike where they are close, without pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.reference_map import MapSet, open_map_set
from edge.reference_map.store import ModelKey, RegionsKey
from edge_plugins.mapping.builder import MapBuilder, Place


def walk(places: int, rng: np.random.Generator, dimensions: int = 256) -> NDArray[np.float32]:
    """Descriptors of a road: neighbors are alike, and places far apart are not."""
    raw = rng.normal(size=(places, 2, dimensions))
    for row in range(1, places):
        raw[row] = 0.75 * raw[row - 1] + np.sqrt(1 - 0.75**2) * raw[row]
    found: NDArray[np.float32] = raw.astype(np.float32)
    return found


def road(path: Path, parts: list[tuple[float, NDArray[np.float32]]]) -> MapSet:
    """A map with a segment for each part, which begins so many meters further north."""
    key = ModelKey("test", "0" * 64, "fc6", parts[0][1].shape[2])
    with MapBuilder(path, key, RegionsKey("left-right", 0.4, "set"), SamplingConfig()) as builder:
        index = 0
        for north_m, raw in parts:
            builder.begin_segment("drive", "rear")
            for row, one in enumerate(raw):
                builder.add(one, Place(index, (north_m + 2 * row) / 110_574, 0.0, route_m=2.0 * row))
                index += 1
        builder.finish()
    return open_map_set(path)
