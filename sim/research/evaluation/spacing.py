"""What is believed where frames and places are not equally far apart: simulated worlds, with an odometer and without.

    python -m sim.research.evaluation.spacing --seeds 4711 4712 4813 --cache FOLDER

Each world is driven by day with the rear camera (the map), and at night home and at dusk the same way with the front
camera, with a picture each meter; descriptors are kept in FOLDER. Of these, a map has every first, second or fourth,
and a vehicle uses some: evenly, or unevenly and all but a fifth of them, which are lost in bursts. The whole road is
mapped, or its first and last third. A place is right as in `sim.research.evaluation.roads`, with the offset that
this drive has with a frame and a place every 2 m.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, SamplingConfig
from sim.compare.scores import at_threshold, joined
from sim.evaluation.metrics import Answers
from sim.research.evaluation.roads import Cut, Described, believe, described, judge, kept, offset_m
from sim.research.evaluation.tables import options, publish
from sim.world.scenario import Scenario

MAP_M = (1, 2, 4)
VEHICLE_M = (1, 2, 4, 6)
Frames = Literal["even", "rough"]
FRAMES: tuple[Frames, ...] = ("even", "rough")
ODOMETERS: dict[str, float | None] = {"right": 1.0, "8 % more": 1.08, "none": None}
UNEVEN = 0.6  # share by which a step differs from the usual one at most
EVERY = 4  # of so many dimensions of a descriptor one is used, which takes a third of the time
LOST, BURST = 0.2, 5  # share of the frames that are lost, and how many in a row on average
CUTS: tuple[Cut, ...] = ("whole", "thirds")


@dataclass(frozen=True)
class Case:
    """How far apart places and frames are, meters, and what is known of what was driven."""

    map_m: int
    vehicle_m: int
    frames: Frames
    odometer: str

    @property
    def sampling(self) -> SamplingConfig:
        """Of the vehicle; without an odometer by time, since by distance nothing is matched then."""
        by: Literal["time", "distance"] = "time" if ODOMETERS[self.odometer] is None else "distance"
        return SamplingConfig(by=by, spacing_m=float(self.vehicle_m))


def thinned(drive: Described, rows: NDArray[np.intp]) -> Described:
    """Some frames of a drive."""
    return Described(drive.raw[rows], drive.route_m[rows], drive.driven_m[rows])


def rows_used(case: Case, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Which of `count` pictures, a meter apart, a vehicle uses: with an odometer, by what that reads."""
    steps_m = np.full(count, case.vehicle_m / (ODOMETERS[case.odometer] or 1.0))
    if case.frames == "rough":
        steps_m *= rng.uniform(1 - UNEVEN, 1 + UNEVEN, count)
    at_m = np.cumsum(steps_m)
    rows = np.unique(np.rint(at_m[at_m <= count - 1]).astype(np.intp))
    if case.frames == "rough":
        is_lost = np.zeros(len(rows), dtype=bool)
        for start in np.flatnonzero(rng.random(len(rows)) < LOST / (1 - LOST) / BURST):
            is_lost[start : start + rng.geometric(1 / BURST)] = True
        rows = rows[~is_lost]
    return rows


def world(seed: int, length_m: float, folder: Path) -> tuple[Described, list[Described]]:
    """The road of a seed as the rear camera saw it, and the drives on it."""
    scene = partial(Scenario, seed=seed, length_m=length_m)
    home = scene(light="night", direction="reverse", drive_seed=3)
    scenes = [scene(view="rear", drive_seed=1), home, scene(light="dusk", drive_seed=4)]
    found = [described(one, folder, 1.0) for one in scenes]
    road, *drives = (replace(one, raw=one.raw[:, :, ::EVERY]) for one in found)
    return road, drives


def judged(seed: int, road: Described, query: Described, ahead_m: float, case: Case) -> dict[Cut, Answers]:
    """Of one drive, with all of the road mapped and with a part of it."""
    mapped = thinned(road, np.arange(0, len(road.raw), case.map_m))
    seen = thinned(query, rows_used(case, len(query.raw), np.random.default_rng(seed)))
    found = {}
    for cut in CUTS:
        beliefs = believe(mapped, seen, cut, ODOMETERS[case.odometer], sampling=case.sampling)
        mapped_m = np.concatenate([mapped.route_m[start:end] for start, end in kept(cut, len(mapped.raw))])
        found[cut] = judge(seen, mapped_m, beliefs, ahead_m).belief
    return found


def offsets_m(road: Described, drives: list[Described]) -> list[float]:
    """How far ahead matches lie, of each drive."""
    road = thinned(road, np.arange(0, len(road.raw), 2))
    even = [thinned(drive, np.arange(0, len(drive.raw), 2)) for drive in drives]
    return [offset_m(drive, believe(road, drive, "whole")) for drive in even]


Figures = tuple[float, float, float]
"""Precision over both cuts, and the recall of each."""


def _figures(found: list[dict[Cut, Answers]]) -> Figures:
    threshold = AcceptanceConfig().confidence_from
    precision = at_threshold(joined([one[cut] for one in found for cut in CUTS]), threshold)[0]
    whole, thirds = (at_threshold(joined([one[cut] for one in found]), threshold)[1] for cut in CUTS)
    return precision, whole, thirds


def _cell(maps: list[Figures]) -> str:
    """Of maps of several spacings: the least precision, and from which recalls to which."""
    precisions, *recalls = zip(*maps, strict=True)
    least = min((one for one in precisions if not math.isnan(one)), default=float("nan"))
    return "; ".join([f"{least:.3f}", *(f"{min(ours):.2f} to {max(ours):.2f}" for ours in recalls)])


def rows_of(seeds: Sequence[int], length_m: float, odometers: Sequence[str], folder: Path) -> Iterator[str]:
    """A row for each odometer and kind of frames, with a column for each spacing of the vehicle's frames."""
    drives = [
        (seed, road, drive, ahead_m)
        for seed in seeds
        for road, drives in [world(seed, length_m, folder)]
        for drive, ahead_m in zip(drives, offsets_m(road, drives), strict=True)
    ]
    yield "| odometer, frames | " + " | ".join(f"each {vehicle_m} m" for vehicle_m in VEHICLE_M) + " |"
    yield "|---" * (1 + len(VEHICLE_M)) + "|"
    for odometer, frames in product(odometers, FRAMES):
        cells = []
        for vehicle_m in VEHICLE_M:
            cases = (Case(map_m, vehicle_m, frames, odometer) for map_m in MAP_M)
            cells.append(_cell([_figures([judged(*one, case) for one in drives]) for case in cases]))
        yield f"| {odometer}, {frames} | {' | '.join(cells)} |"


def main() -> None:
    """Print or write the table."""
    parser = options(__doc__, 1000.0)
    parser.add_argument("--odometers", nargs="+", choices=ODOMETERS, default=list(ODOMETERS), help="default: all")
    args = parser.parse_args()
    publish("spacing", rows_of(args.seeds, args.length, args.odometers, args.cache), args.page)


if __name__ == "__main__":
    main()
