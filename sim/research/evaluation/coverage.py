"""How well the coverage of a route is predicted from its map alone: simulated worlds, rehearsed and then driven.

    python -m sim.research.evaluation.coverage --seeds 4501 4502 --cache FOLDER
    python -m sim.research.evaluation.coverage --similarity --seeds 4201 4202 --cache FOLDER

Each world is driven once with the rear camera by day (the map), home at night and again at dusk with the front camera.
Of every second world the middle third is not mapped. For each 100 m, the share of frames that are believed, as it is
rehearsed (`sim.coverage`) and as it is found; for each drive, its longest gap. Descriptors are kept in FOLDER.

--similarity prints how alike a place is to its place of the map after normalization (cosine), by where the map's camera
looked, by direction and by light, in the worlds and in rehearsed drives over their maps: what the constants of
`sim.coverage.rehearsal` rest on.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config
from edge.descriptor.network import Network
from edge.descriptor.normalize import normalize
from edge.feed import View
from edge.reference_map import Drives, MapSet, ModelKey
from edge.reference_map.builder import Place
from edge.sequence import Direction
from sim.coverage import Conditions, Pass, Rehearsal, Sheet
from sim.coverage.rehearsal import LIGHTS, WAYS
from sim.coverage.sheet import longest_gap, spans_of
from sim.research.evaluation.belief import Described, believe, described, kept, offset_m
from sim.research.evaluation.temporary_map import MappedDrive, temporary_map
from sim.world.scenario import Scenario

STRETCH_M, REHEARSALS, FACTOR = 100.0, 8, 1.5
DRIVEN: tuple[tuple[Conditions, int], ...] = ((Conditions("home", "night"), 2), (Conditions("again", "dusk"), 3))
"""Conditions, and the seed of the drive."""
VIEWS: tuple[View, ...] = ("rear", "front")
M_PER_DEG = 110_574.0
AROUND_M = 8.0
DEAD = 0.1
"""Share of the mean deviation below which a dimension says nothing of a shift."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Judged:
    """A drive over a world: shares of stretches (n,), predicted and found, whether first in it, and longest gaps."""

    name: str
    predicted: Floats
    found: Floats
    is_first: NDArray[np.bool_]
    predicted_gap_m: float
    found_gap_m: float


@contextmanager
def mapped(road: Described, *, whole: bool, view: View = "rear") -> Iterator[MapSet]:
    """The road's map, by a camera that looked so, on a straight line north."""
    rows, config = np.arange(len(road.raw)), Config()
    drives = [
        MappedDrive(
            road.raw[start:end].astype(np.float32),
            [
                Place(row, float(road.route_m[row]) / M_PER_DEG, 0.0, route_m=float(road.route_m[row]))
                for row in rows[start:end].tolist()
            ],
            view,
        )
        for start, end in kept("whole" if whole else "thirds", len(rows))
    ]
    with temporary_map(drives, ModelKey("cached", "0" * 64, "fc6", road.raw.shape[2]), config.descriptor) as maps:
        yield maps


def judge(name: str, road: Described, query: Described, conditions: Conditions, *, whole: bool) -> Judged:
    """Rehearse a drive over a world, and hold it against the one that was driven."""
    with mapped(road, whole=whole) as maps:
        drives = Drives(maps, 2.0)
        rehearsal = Rehearsal(maps, Config(), conditions)
        rehearsed = [rehearsal.drive(seed) for seed in range(REHEARSALS)]
        found = _passes(road, query, drives, whole=whole, home=conditions.way == "home")
        spans = spans_of(maps, drives, STRETCH_M)
        predicted = Sheet.of(maps, drives, spans, rehearsed, [], np.inf)
        real = Sheet.of(maps, drives, spans, [], [found], np.inf)
        gap, real_gap = predicted.gap, longest_gap(found, maps)
    assert gap is not None and real_gap is not None
    shares = np.array([
        (one.share, other.share, _is_first(one.span.segment, one.span.from_m, drives, conditions.way == "home"))
        for one, other in zip(predicted.stretches, real.stretches, strict=True)
        if one.share is not None and other.share is not None
    ])  # fmt: skip
    return Judged(name, shares[:, 0], shares[:, 1], shares[:, 2] > 0, gap.length_m, real_gap.length_m)


def _is_first(segment: int, from_m: float, drives: Drives, home: bool) -> bool:
    """Whether a stretch is the first 200 m of a segment as it is driven."""
    low_m, high_m = drives.extent_m(segment)
    return high_m - from_m <= 2 * STRETCH_M if home else from_m - low_m < 2 * STRETCH_M


def _passes(road: Described, query: Described, drives: Drives, *, whole: bool, home: bool) -> list[Pass]:
    """What was driven, over each segment."""
    beliefs = believe(road, query, "whole" if whole else "thirds")
    along_m = query.route_m + offset_m(query, beliefs)
    right = np.abs(beliefs.along_m - along_m) <= 40.0
    believed = right & (beliefs.confidence >= AcceptanceConfig().confidence_from)
    found = []
    for segment in range(1 if whole else 2):
        low_m, high_m = drives.extent_m(segment)
        inside = (along_m >= low_m) & (along_m <= high_m)
        found.append(Pass(segment, along_m[inside], believed[inside]))
    return found[::-1] if home else found


def worlds(seeds: list[int], length_m: float, cache: Path) -> Iterator[tuple[int, Described, list[Described]]]:
    """The road of each seed as the rear camera saw it, and the drives of DRIVEN."""
    network = Network.load()
    for seed in seeds:
        road = described(Scenario(seed=seed, length_m=length_m, view="rear", drive_seed=1), network, cache)
        queries = [described(_scene(seed, length_m, one, number), network, cache) for one, number in DRIVEN]
        yield seed, road, queries


def _scene(seed: int, length_m: float, conditions: Conditions, drive_seed: int) -> Scenario:
    direction: Direction = "reverse" if conditions.way == "home" else "forward"
    return Scenario(seed=seed, length_m=length_m, light=conditions.light, direction=direction, drive_seed=drive_seed)


def print_similarity(seeds: list[int], length_m: float, cache: Path) -> None:
    """A table: cosine of a place with its place of the map, mean and standard deviation, found and rehearsed."""
    network = Network.load()
    print("| map | way | light | found: mean / deviation | rehearsed | mean shifted by |\n|---|---|---|---|---|---|")
    for view, way, light in product(VIEWS, WAYS, LIGHTS):
        found, rehearsed, shifts = [], [], []
        for seed in seeds:
            road = described(Scenario(seed=seed, length_m=length_m, view=view, drive_seed=1), network, cache)
            conditions = Conditions(way, light)
            query = described(_scene(seed, length_m, conditions, 5), network, cache)
            shifts.append(_shift(road, query))
            with mapped(road, whole=True, view=view) as maps:
                rehearsal = Rehearsal(maps, Config(), conditions)
                swapped = not rehearsal.look_alike(0)
                found.append(_similarity(road, query, swapped=swapped))
                raw = np.concatenate(list(rehearsal.frames(0, seed=0)))
                driven_m = road.route_m[::-1] if way == "home" else road.route_m
                rehearsed.append(_similarity(road, Described(raw, driven_m, road.route_m), swapped=swapped))
        cells = (f"{np.mean(values):.2f} / {np.std(values):.2f}" for values in map(np.concatenate, (found, rehearsed)))
        print(f"| {view} | {way} | {light} | {' | '.join(cells)} | {np.mean(shifts):.2f} |", flush=True)


def _similarity(road: Described, query: Described, *, swapped: bool) -> Floats:
    """Of each frame, to the most similar place within AROUND_M of the offset at which it is highest in the mean."""
    places, frames = (_unit(one.raw.astype(np.float32)) for one in (road, query))
    if swapped:
        frames = frames[:, ::-1]
    values = []
    for ahead_m in np.arange(-40.0, 41.0, 2.0):
        rows = np.abs(road.route_m - (query.route_m + ahead_m)[:, np.newaxis]).argmin(axis=1)
        values.append(np.einsum("nrd,nrd->n", frames, places[rows]))
    at, around = int(np.argmax(np.mean(values, axis=1))), round(AROUND_M / 2.0)
    best: Floats = np.max(values[max(0, at - around) : at + around + 1], axis=0)
    return best


def _shift(road: Described, query: Described) -> float:
    """Root mean square by which the mean of a drive differs from the road's, in the road's standard deviations."""
    mean, deviation = road.raw.astype(np.float64).mean((0, 1)), road.raw.astype(np.float64).std(0).mean(0)
    sound = deviation > DEAD * deviation.mean()
    off = (query.raw.astype(np.float64).mean((0, 1)) - mean)[sound] / deviation[sound]
    return float(np.sqrt(np.mean(off**2)))


def _unit(raw: NDArray[np.float32]) -> NDArray[np.float32]:
    """Normalized over the whole set, each of length 1."""
    mean, deviation = (np.broadcast_to(one, raw.shape[1:]) for one in (raw.mean((0, 1)), raw.std(0).mean(0)))
    found = normalize(raw, mean.astype(np.float64), deviation.astype(np.float64))
    unit: NDArray[np.float32] = found / np.sqrt(np.einsum("nrd,nrd->n", found, found))[:, np.newaxis, np.newaxis]
    return unit


def main() -> None:
    """Print for each drive its gaps, and for all the correlation of shares and how many gaps are right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--length", type=float, default=1200.0, help="of the road, m")
    parser.add_argument("--similarity", action="store_true", help="print what the constants rest on")
    args = parser.parse_args()
    args.cache.mkdir(parents=True, exist_ok=True)
    if args.similarity:
        print_similarity(args.seeds, args.length, args.cache)
        return
    judged = []
    print("| road | drive | share, predicted / found | longest gap, predicted / found |\n|---|---|---|---|")
    for number, (seed, road, queries) in enumerate(worlds(args.seeds, args.length, args.cache)):
        for (conditions, _), query in zip(DRIVEN, queries, strict=True):
            name = (
                f"{seed}{'' if number % 2 == 0 else ', the middle not mapped'} | {conditions.way}, {conditions.light}"
            )
            one = judge(name, road, query, conditions, whole=number % 2 == 0)
            judged.append(one)
            shares = f"{one.predicted.mean():.2f} / {one.found.mean():.2f}"
            print(f"| {name} | {shares} | {one.predicted_gap_m:.0f} / {one.found_gap_m:.0f} m |", flush=True)
    predicted, found = (np.concatenate([getattr(one, what) for one in judged]) for what in ("predicted", "found"))
    later = ~np.concatenate([one.is_first for one in judged])
    print(f"correlation by stretch: {np.corrcoef(predicted, found)[0, 1]:.2f} of {len(found)};", end=" ")
    print(f"without the first 200 m of each segment {np.corrcoef(predicted[later], found[later])[0, 1]:.2f}")
    right = [1 / FACTOR <= one.predicted_gap_m / max(one.found_gap_m, 1.0) <= FACTOR for one in judged]
    print(f"longest gap within a factor of {FACTOR:g}: {sum(right)} of {len(right)}")


if __name__ == "__main__":
    main()
