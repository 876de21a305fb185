"""How often errors exceed their protection levels, counted on seeded drives without pictures.

The drives have what positions are wrong by: errors of matches and of their parallax that last, an odometer and a
heading that are wrong, stretches of the map that are shifted as often as `STRETCH_WRONG` says, unmapped stretches of
which some resemble the map, turn-offs, halts and reversing. Shifted stretches are rare, so that they are sampled more
often than they occur, and weighted (importance sampling): classes of drives are counted apart.

    python -m tests.localization.level_hours --drives 100 --page docs/integrity.md
"""

from __future__ import annotations

import argparse
import math
import os
import textwrap
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from edge.localization.claims import STRETCH_WRONG
from sim.research.trial.table import put_between
from tests.localization.route_bench import CORRELATED_M, Bench, Bounded, Course, Stretch

ROAD_M, STRETCH_M = 3000.0, 500.0
UNMAPPED, RESEMBLES, OFF = 0.1, 0.1, 0.15
OFF_HOW = "turn -90", "turn 180", "stop 45", "reverse 2"
SHIFTED_M = (5.0, 500.0)
"""Least and greatest shift of a stretch that is wrong; its logarithm is spread evenly."""
NEAR_M = 40.0
"""Larger shifts are noticed more easily, so that they are a class of their own."""
CLASSES = {"right": None, "shifted by less": (SHIFTED_M[0], NEAR_M), "shifted by more": (NEAR_M, SHIFTED_M[1])}
CONFIDENCE = 0.95


def seed_of_run() -> int:
    """The first seed of this run, another one where LOOKBACK_SEED says so; drives add less than a million to it."""
    return int(os.environ.get("LOOKBACK_SEED") or 1) * 1_000_000


def share_of(shifted_m: tuple[float, float]) -> float:
    """Of all shifts, those of a class."""
    return math.log(shifted_m[1] / shifted_m[0]) / math.log(SHIFTED_M[1] / SHIFTED_M[0])


def stretches(rng: np.random.Generator, shifted_m: tuple[float, float] | None) -> tuple[list[Stretch], float]:
    """Of a map, some missing, in one drive or several; and how much more often it is drawn than it occurs, inverted.

    shifted_m: none is shifted, or one and by chance others.
    """
    begins_m = [at for at in np.arange(0.0, ROAD_M, STRETCH_M) if at == 0 or rng.random() >= UNMAPPED]
    several = rng.random() < 0.3
    count = len(begins_m)
    is_shifted = np.zeros(count, bool) if shifted_m is None else rng.random(count) < STRETCH_WRONG
    weight = (1 - STRETCH_WRONG) ** count
    least, most = np.log(SHIFTED_M)
    far_m = np.exp(rng.uniform(least, most, count))
    if shifted_m is not None:
        one = int(rng.integers(count))
        is_shifted[one], far_m[one] = True, math.exp(rng.uniform(*np.log(shifted_m)))
        weight = count * STRETCH_WRONG * share_of(shifted_m) / is_shifted.sum()
    found: list[Stretch] = []
    for begins, by_m, angle in zip(begins_m, far_m * is_shifted, rng.uniform(0, 2 * math.pi, count), strict=True):
        continues = bool(found) and found[-1].ends_m == begins and not several
        shift = by_m * math.sin(angle), by_m * math.cos(angle)
        found.append(Stretch(float(begins), float(begins) + STRETCH_M, *shift, continues=continues))
    return found, float(weight)


def course(seed: int, shifted_m: tuple[float, float] | None = None) -> tuple[Course, float]:
    """A drive, and its weight, see `stretches`."""
    rng = np.random.default_rng([seed, 17])
    mapped, weight = stretches(rng, shifted_m)
    missing = set(np.arange(0.0, ROAD_M, STRETCH_M)) - {one.begins_m for one in mapped}
    alias = (math.inf, math.inf)
    if missing and rng.random() < RESEMBLES:
        begins_m = float(rng.choice(sorted(missing))) + 100.0
        alias = begins_m, begins_m + 128.0
    off_how = str(rng.choice(OFF_HOW)) if rng.random() < OFF else ""
    drawn = Course(
        road_m=ROAD_M,
        stretches=tuple(mapped),
        off_at_m=float(rng.uniform(600, 2400)) if off_how else math.inf,
        off_how=off_how,
        alias=alias,
        alias_from_m=30.0,
        steers=bool(rng.random() < 0.5),
        parallax=bool(rng.random() < 0.5),
        speed_mps=float(rng.uniform(3, 12)),
    )
    return drawn, weight


@dataclass(frozen=True)
class Drive:
    """What a drive showed. bounded: arrays (n, 7) of the fields of `Bounded`. exceeded: episodes."""

    hours: float
    weight: float
    parallax: bool
    bounded: np.ndarray
    exceeded: int


def drive(seed: int, shifted_m: tuple[float, float] | None, folder: Path) -> Drive:
    """Drive a course."""
    drawn, weight = course(seed, shifted_m)
    bench = Bench(drawn, seed, folder)
    bounded = bench.run().bounded
    return Drive(bench.seconds / 3600, weight, drawn.parallax, np.array(bounded).reshape(-1, 7), exceeded(bounded))


def exceeded(bounded: Sequence[Bounded]) -> int:
    """Episodes in which a position is further off than its protection level."""
    at_m = [one.at_m for one in bounded if one.along_m > one.level_along_m or one.across_m > one.level_across_m]
    return sum(index == 0 or at - at_m[index - 1] > CORRELATED_M for index, at in enumerate(at_m))


def drives(count: int, first_seed: int, folder: Path) -> dict[str, list[Drive]]:
    """So many drives of each class, on all processors."""
    found = {}
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for number, (name, shifted_m) in enumerate(CLASSES.items()):
            seeds = range(first_seed + number * count, first_seed + (number + 1) * count)
            found[name] = list(pool.map(drive, seeds, [shifted_m] * count, [folder] * count))
    return found


def rate(found: dict[str, list[Drive]]) -> tuple[float, float]:
    """Episodes in an hour as drives occur: the estimate, and its upper bound at CONFIDENCE.

    Of each class at most `most_events` are behind its count; the classes share what may be wrong.
    """
    hours = sum(float(np.mean([one.weight * one.hours for one in of_class])) for of_class in found.values())
    estimate = sum(float(np.mean([one.weight * one.exceeded for one in of_class])) for of_class in found.values())
    bound = sum(
        max(one.weight for one in of_class)
        * most_events(sum(one.exceeded for one in of_class), (1 - CONFIDENCE) / len(found))
        / len(of_class)
        for of_class in found.values()
    )
    return estimate / hours, bound / hours


def most_events(count: int, wrong: float) -> float:
    """The mean of a Poisson distribution that gives at most `count` with the probability `wrong`."""
    low, high = 0.0, 10.0 * (count + 10)
    while high - low > 1e-6:
        mean = (low + high) / 2
        terms = np.exp(-mean + np.arange(count + 1) * math.log(mean) - [math.lgamma(k + 1) for k in range(count + 1)])
        low, high = (mean, high) if terms.sum() > wrong else (low, mean)
    return high


def statement(found: dict[str, list[Drive]], first_seed: int) -> str:
    """What was shown, for people."""
    estimate, bound = rate(found)
    count = len(found["right"])
    counted = ", ".join(
        f"{sum(one.exceeded for one in of_class)} in {sum(one.hours for one in of_class):.0f} h ({name})"
        for name, of_class in found.items()
    )
    medians = ", ".join(
        f"{along_m:.1f} and {across_m:.1f} m {how} parallax"
        for how, parallax in (("with", True), ("without", False))
        for along_m, across_m in [median_level_m(found["right"], parallax)]
    )
    text = (
        f"`python -m tests.localization.level_hours --drives {count} --seed {first_seed}`: levels were exceeded so "
        f"often: {counted}. "
        f"As such drives occur, that is {estimate:.4f} an hour, below {bound:.4f} at 95 % confidence. "
        f"Median levels on right maps, along and across: {medians}."
    )
    return textwrap.fill(text, 120, break_on_hyphens=False)


def median_level_m(of_class: Sequence[Drive], parallax: bool) -> tuple[float, float]:
    """The medians along and across of the finite levels."""
    every = np.concatenate([one.bounded for one in of_class if one.parallax is parallax])
    finite = every[np.isfinite(every[:, 5])]
    return float(np.median(finite[:, 5])), float(np.median(finite[:, 6]))


def main(argv: Sequence[str] | None = None) -> int:
    """Count, print what was shown, and write it into a page."""
    parser = argparse.ArgumentParser(prog="python -m tests.localization.level_hours", description=__doc__)
    parser.add_argument("--drives", type=int, default=100, metavar="N", help="of each class (default 100)")
    parser.add_argument("--seed", type=int, help="the first (default: a new one)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write what was shown into this page")
    args = parser.parse_args(argv)
    first_seed = int(time.time()) if args.seed is None else args.seed
    with TemporaryDirectory() as folder:
        text = statement(drives(args.drives, first_seed, Path(folder)), first_seed)
    print(text)
    if args.page is not None:
        put_between("level hours", args.page, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
