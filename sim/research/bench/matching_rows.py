"""Both region orders of one query against a whole map: ours, and what others would do."""

from __future__ import annotations

from collections.abc import Callable

import faiss
import numpy as np
from numpy.typing import NDArray

from edge.reference_map.costs import CostMatcher, encode, inverse_lengths, squared_norms
from sim.bench.timing import race
from sim.research.bench.machine import Machine, read_all
from sim.research.bench.rows import Row, Section, Target, against

faiss.omp_set_num_threads(1)
REGIONS, DIMENSIONS = 2, 4096
BLOCK = 1000
OURS, READING, FAISS = "ours", "reading the map's bytes once", "faiss SQ8, one order"


def measure(machine: Machine, places: list[int], rounds: int, dimensions: int = DIMENSIONS) -> Section:
    """A section with the rows of every size; targets are for sizes of 10,000 and up."""
    rows: list[Row] = []
    targets: list[Target] = []
    for count in places:
        more_rows, more_targets = _of_size(machine, count, rounds, dimensions)
        rows, targets = rows + more_rows, targets + more_targets
    return Section("Matching, one frame in both orders", rows, targets)


def _of_size(machine: Machine, places: int, rounds: int, dimensions: int) -> tuple[list[Row], list[Target]]:
    rng = np.random.default_rng(places)
    descriptors, sq8 = _simulated(rng, places, dimensions)
    matcher = CostMatcher(descriptors, inverse_lengths(_norms(descriptors)))
    query = rng.normal(size=(1, REGIONS, dimensions)).astype(np.float32)
    ring = rng.normal(size=(40, REGIONS, dimensions)).astype(np.float32)
    flat = query.reshape(1, -1)
    racers: dict[str, Callable[[], object]] = {
        OURS: lambda: matcher.costs(query),
        READING: lambda: read_all(descriptors),
        FAISS: lambda: sq8.search(flat, 1),
    }
    times = race(racers, rounds)
    size = f"{places:,} places x {REGIONS * dimensions}"
    rows = [against(OURS, OURS, times, READING, size)]
    rows += [against(name, name, times, OURS, size) for name in list(racers)[1:]]
    macs = machine.floor_ms(descriptors.size, descriptors.size * len(ring))
    whole = race({"ring": lambda: matcher.costs(ring)}, max(2, rounds // 3))["ring"]
    ratio = whole.median_ms / macs
    rows.append(Row("40 rows, when the ring is normalized again", whole, "its floor", ratio, size=size))
    if places < 10_000:
        return rows, []
    over = times[OURS].ratio(times[READING])
    to_faiss = times[OURS].ratio(times[FAISS])
    return rows, [
        Target(
            f"matching {places:,} x {REGIONS * dimensions} against reading the map's bytes once",
            "1.3x or less",
            f"{over:.2f}x",
            over <= 1.3,
        ),
        Target(
            f"matching {places:,} x {REGIONS * dimensions} against {FAISS}",
            "1x or less",
            f"{to_faiss:.2f}x",
            to_faiss <= 1.0,
        ),
    ]


def _simulated(
    rng: np.random.Generator, places: int, dimensions: int
) -> tuple[NDArray[np.int8], faiss.IndexScalarQuantizer]:
    """Descriptors (R, N, D) int8 of a map, and faiss's 8-bit index of the same numbers."""
    kind = faiss.ScalarQuantizer.QT_8bit_direct_signed
    index = faiss.IndexScalarQuantizer(REGIONS * dimensions, kind, faiss.METRIC_INNER_PRODUCT)
    out = np.empty((REGIONS, places, dimensions), dtype=np.int8)
    for start in range(0, places, BLOCK):
        block = rng.standard_normal((min(BLOCK, places - start), REGIONS, dimensions), np.float32)
        out[:, start : start + BLOCK] = encode(block)
        index.add(out[:, start : start + BLOCK].swapaxes(0, 1).reshape(len(block), -1).astype(np.float32))
    return out, index


def _norms(descriptors: NDArray[np.int8]) -> NDArray[np.int32]:
    """Squared norms in blocks: in one piece they would need four times the map."""
    starts = range(0, descriptors.shape[1], BLOCK)
    return np.concatenate([squared_norms(descriptors[:, start : start + BLOCK]) for start in starts])
