"""How well the coverage of a route is predicted from its map alone: simulated worlds, rehearsed and then driven.

    python -m sim.research.evaluation.coverage --seeds 4501 4502 --cache FOLDER

Each world is driven once with the rear camera by day (the map), home at night and again at dusk with the front camera.
Of every second world the middle third is not mapped. For each 100 m, the share of frames that are believed, as it is
rehearsed (`sim.coverage`) and as it is found; for each drive, its longest gap. Descriptors are kept in FOLDER.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config
from edge.reference_map import Drives
from edge.sequence import Direction
from sim.coverage import Conditions, Pass, Rehearsal, Sheet
from sim.coverage.sheet import longest_gap, spans_of
from sim.research.evaluation.roads import (
    SPACING_M,
    TOLERANCE_M,
    Cut,
    Described,
    believe,
    described,
    kept,
    mapped,
    offset_m,
)
from sim.research.evaluation.tables import options, publish
from sim.world.scenario import Scenario

STRETCH_M, REHEARSALS, FACTOR = 100.0, 8, 1.5
DRIVEN: tuple[tuple[Conditions, int], ...] = ((Conditions("home", "night"), 2), (Conditions("again", "dusk"), 3))
"""Conditions, and the seed of the drive."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Judged:
    """A drive over a world: shares of stretches (n,), predicted and found, whether first in it, and longest gaps."""

    predicted: Floats
    found: Floats
    is_first: Floats
    predicted_gap_m: float
    found_gap_m: float


def judge(road: Described, query: Described, conditions: Conditions, cut: Cut) -> Judged:
    """Rehearse a drive over a world, and hold it against the one that was driven."""
    with mapped(road, cut, to_north=True) as maps:
        drives = Drives(maps, SPACING_M)
        rehearsal = Rehearsal(maps, Config(), conditions)
        rehearsed = [rehearsal.drive(seed) for seed in range(REHEARSALS)]
        found = _passes(road, query, drives, cut, home=conditions.way == "home")
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
    return Judged(shares[:, 0], shares[:, 1], shares[:, 2], gap.length_m, real_gap.length_m)


def _is_first(segment: int, from_m: float, drives: Drives, home: bool) -> bool:
    """Whether a stretch is the first 200 m of a segment as it is driven."""
    low_m, high_m = drives.extent_m(segment)
    return high_m - from_m <= 2 * STRETCH_M if home else from_m - low_m < 2 * STRETCH_M


def _passes(road: Described, query: Described, drives: Drives, cut: Cut, *, home: bool) -> list[Pass]:
    """What was driven, over each segment."""
    beliefs = believe(road, query, cut)
    along_m = query.route_m + offset_m(query, beliefs)
    right = np.abs(beliefs.along_m - along_m) <= TOLERANCE_M
    believed = right & (beliefs.confidence >= AcceptanceConfig().confidence_from)
    found = []
    for segment in range(len(kept(cut, len(road.raw)))):
        low_m, high_m = drives.extent_m(segment)
        inside = (along_m >= low_m) & (along_m <= high_m)
        found.append(Pass(segment, along_m[inside], believed[inside]))
    return found[::-1] if home else found


def driven(road: Scenario, conditions: Conditions, drive_seed: int, folder: Path) -> Described:
    """A drive of the front camera over a road."""
    direction: Direction = "reverse" if conditions.way == "home" else "forward"
    seen = replace(road, view="front", light=conditions.light, direction=direction, drive_seed=drive_seed)
    return described(seen, folder)


def predictions(roads: Sequence[Scenario], folder: Path) -> Iterator[str]:
    """For each drive its shares and gaps, and for all the correlation of shares and how many gaps are right."""
    judged = []
    yield "| road | drive | share, predicted / found | longest gap, predicted / found |\n|---|---|---|---|"
    for number, scenario in enumerate(roads):
        cut: Cut = "thirds" if number % 2 else "whole"
        for conditions, drive_seed in DRIVEN:
            query = driven(scenario, conditions, drive_seed, folder)
            judged.append(one := judge(described(scenario, folder), query, conditions, cut))
            name = f"{scenario.seed}{', the middle not mapped' * (number % 2)} | {conditions.way}, {conditions.light}"
            shares = f"{one.predicted.mean():.2f} / {one.found.mean():.2f}"
            yield f"| {name} | {shares} | {one.predicted_gap_m:.0f} / {one.found_gap_m:.0f} m |"
    predicted, found, is_first = (
        np.concatenate(rows) for rows in zip(*((one.predicted, one.found, one.is_first) for one in judged), strict=True)
    )
    later = np.corrcoef(predicted[is_first == 0], found[is_first == 0])[0, 1]
    right = [1 / FACTOR <= one.predicted_gap_m / max(one.found_gap_m, 1.0) <= FACTOR for one in judged]
    yield (
        f"correlation by stretch: {np.corrcoef(predicted, found)[0, 1]:.2f} of {len(found)}; without the first 200 m of"
        f" each segment {later:.2f}\nlongest gap within a factor of {FACTOR:g}: {sum(right)} of {len(right)}"
    )


def main() -> None:
    """Print the predictions."""
    args = options(__doc__, 1200.0).parse_args()
    roads = [Scenario(seed=seed, length_m=args.length, view="rear", drive_seed=1) for seed in args.seeds]
    publish("coverage", predictions(roads, args.cache), args.page)


if __name__ == "__main__":
    main()
