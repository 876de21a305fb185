"""Both region orders of one query against a whole map: ours, and what others would do."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import faiss
import numpy as np
from numpy.typing import NDArray

from edge.reference_map.costs import CostMatcher, encode, inverse_lengths, squared_norms
from sim.bench.timing import race
from sim.research.bench.machine import Machine, read_all
from sim.research.bench.rows import Row, Section, against, at_most

faiss.omp_set_num_threads(1)
REGIONS, DIMENSIONS = 2, 4096
BLOCK = 1000
OURS, READING, FAISS = "ours", "reading the map's bytes once", "faiss SQ8, one order"


def measure(machine: Machine, places: Sequence[int], rounds: int, dimensions: int = DIMENSIONS) -> Section:
    """A section with the rows of every size; targets are for sizes of 10,000 and up."""
    section = Section("Matching, one frame in both orders", [], [])
    for count in places:
        _add_size(section, machine, count, rounds, dimensions)
    return section


def _add_size(section: Section, machine: Machine, places: int, rounds: int, dimensions: int) -> None:
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
    section.rows.append(against(OURS, OURS, times, READING, size))
    section.rows.extend(against(name, name, times, OURS, size) for name in (READING, FAISS))
    macs = machine.floor_ms(descriptors.size, descriptors.size * len(ring))
    whole = race({"ring": lambda: matcher.costs(ring)}, max(2, rounds // 3))["ring"]
    ratio = whole.median_ms / macs
    section.rows.append(Row("40 rows, when the ring is normalized again", whole, "its floor", ratio, size=size))
    if places >= 10_000:
        what = f"matching {places:,} x {REGIONS * dimensions} against"
        section.targets.append(at_most(f"{what} {READING}", 1.3, times[OURS].ratio(times[READING])))
        section.targets.append(at_most(f"{what} {FAISS}", 1, times[OURS].ratio(times[FAISS])))


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
