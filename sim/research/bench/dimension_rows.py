"""What a descriptor of another dimension costs after the network: from the least dimension to the greatest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.normalize import OnlineNormalizer
from edge.reference_map.costs import CostMatcher, squared_norms
from sim.bench.simulated_map import REGIONS, map_bytes
from sim.bench.timing import Times, race
from sim.research.bench.machine import read_all
from sim.research.bench.rows import Row, Section, Target

DIMENSIONS = (64, 512, 4096, 32_768)
SHIPPED = 4096
LENGTH = 40
READING = "reading the map's bytes once"
OVER_READING, FEW_DIMENSIONS = 1.5, 0.25
"""Targets: over the floor at the greatest dimension; share of the shipped network's time at the least one."""


def measure(places: int, rounds: int) -> Section:
    """Normalizing a frame and matching it with a map of that size, at each dimension."""
    rows: list[Row] = []
    matching: dict[int, dict[str, Times]] = {}
    for dimensions in DIMENSIONS:
        rng = np.random.default_rng(dimensions)
        times = matching[dimensions] = race(_matching(rng, places, dimensions), rounds)
        over = times["ours"].ratio(times[READING])
        size = f"{REGIONS.count * dimensions}"
        rows.append(Row("bytes a place", note=f"{map_bytes(1, dimensions):,}", size=size))
        rows.append(Row(f"matching {places:,} places", times["ours"], READING, over, size=size))
        normalizing = race({"ours": _normalizing(rng, dimensions)}, 3 * rounds)["ours"]
        share = normalizing.median_ms / times["ours"].median_ms
        rows.append(Row("normalizing", normalizing, "matching", share, size=size))
    greatest, least = DIMENSIONS[-1], DIMENSIONS[0]
    over = matching[greatest]["ours"].ratio(matching[greatest][READING])
    share = matching[least]["ours"].median_ms / matching[SHIPPED]["ours"].median_ms
    return Section(
        "Descriptors of other dimensions",
        rows,
        [
            Target(
                f"matching {places:,} places of {greatest} dimensions, against {READING}",
                f"{OVER_READING}x or less",
                f"{over:.2f}x",
                over <= OVER_READING,
            ),
            Target(
                f"matching {places:,} places of {least} dimensions, against the same of {SHIPPED}",
                f"{FEW_DIMENSIONS}x or less",
                f"{share:.2f}x",
                share <= FEW_DIMENSIONS,
            ),
        ],
    )


def _matching(rng: np.random.Generator, places: int, dimensions: int) -> dict[str, Callable[[], object]]:
    descriptors: NDArray[np.int8] = rng.integers(-60, 60, (REGIONS.count, places, dimensions), dtype=np.int8)
    blocks = range(0, places, 1000)  # in one piece, the products would need four times the map
    norms_sq = np.concatenate([squared_norms(descriptors[:, first : first + 1000]) for first in blocks])
    matcher = CostMatcher(descriptors, norms_sq)
    query = rng.normal(size=(1, REGIONS.count, dimensions)).astype(np.float32)
    return {"ours": lambda: matcher.costs(query), READING: lambda: read_all(descriptors)}


def _normalizing(rng: np.random.Generator, dimensions: int) -> Callable[[], object]:
    """A frame like the others, with rows of the ring that are normalized again where their statistics are stale."""
    frames = rng.gamma(0.5, 3.0, (2 * LENGTH, REGIONS.count, dimensions)).astype(np.float32)
    normalizer = OnlineNormalizer(LENGTH, renormalize_ring=True)
    for frame in frames:
        normalizer.push(frame)
    return lambda: normalizer.push(frames[-1])
