"""How often errors exceed their protection levels, by seeded drives without pictures.

The drives have what positions are wrong by: errors of matches and of their parallax that last, an odometer and a
heading that are wrong, stretches of the map that are shifted as often as `STRETCH_WRONG` says, unmapped stretches of
which some resemble the map, turn-offs, halts and reversing. What is rare is drawn more often and weighted (importance
sampling): shifted stretches, in classes of their own, and large errors of odometer and heading. A drive goes on the
more often the nearer its error is to its level (`splitting`).

    python -m tests.localization.level_hours --drives 200 --page docs/integrity.md
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
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from edge.localization.claims import STRETCH_WRONG
from sim.research.trial.table import put_between
from tests.localization.route_bench import CORRELATED_M, Bench, Bounded
from tests.localization.route_course import Course, Stretch
from tests.localization.splitting import LEVELS, Split, reached_by

ROAD_M, STRETCH_M = 3000.0, 500.0
UNMAPPED, RESEMBLES, OFF = 0.1, 0.1, 0.15
OFF_HOW = "turn -90", "turn 180", "stop 45", "reverse 2"
SHIFTED_M = (5.0, 500.0)
"""Least and greatest shift of a stretch that is wrong; its logarithm is spread evenly."""


class Class(NamedTuple):
    """Drives that have something in common, how they are split, and how many times as many are driven.

    shifted_m: the range of the shift of a stretch that is wrong; None where none is.
    """

    shifted_m: tuple[float, float] | None
    split: Split
    times: int = 1


CLASSES = {
    "right": Class(None, Split(37.0, 0.14), times=2),
    "shifted by less": Class((SHIFTED_M[0], 8.0), Split(20.0, 0.3)),
    "shifted by 8 to 40 m": Class((8.0, 40.0), Split(15.0, 0.45), times=4),
    "shifted by more": Class((40.0, SHIFTED_M[1]), Split(30.0, 0.15)),
}
"""Where a shift is hardest to notice, between 8 and 40 m, many drives come near, and some of them much more often.

Strengths were tried on 30 to 40 drives of each class: higher levels are reached, in three times the time of a drive.
"""
CONFIDENCE = 0.95
SCALE, HEADING_DEG, WIDER = 0.03, 1.5, 1.5
"""Standard deviations of odometer and heading, and how many times as wide they are drawn."""
FEW, RESAMPLED = 10, 10_000
"""A bound is that of the highest level which so many drives alike came to; drives are drawn anew so often for it."""


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


def motion_errors(rng: np.random.Generator) -> tuple[float, float, float]:
    """Of odometer and heading, as a share and in degrees; and how much more often they are drawn, inverted."""
    drawn = rng.normal(0.0, WIDER, 2)
    weight = np.prod(WIDER * np.exp(-(drawn**2) / 2 * (1 - WIDER**-2)))
    return float(SCALE * drawn[0]), float(HEADING_DEG * drawn[1]), float(weight)


def course(seed: int, shifted_m: tuple[float, float] | None = None) -> tuple[Course, float]:
    """A drive, and its weight, see `stretches` and `motion_errors`."""
    rng = np.random.default_rng([seed, 17])
    mapped, weight = stretches(rng, shifted_m)
    missing = set(np.arange(0.0, ROAD_M, STRETCH_M)) - {one.begins_m for one in mapped}
    alias = (math.inf, math.inf)
    if missing and rng.random() < RESEMBLES:
        begins_m = float(rng.choice(sorted(missing))) + 100.0
        alias = begins_m, begins_m + 128.0
    off_how = str(rng.choice(OFF_HOW)) if rng.random() < OFF else ""
    scale, heading_deg, share = motion_errors(rng)
    drawn = Course(
        road_m=ROAD_M,
        stretches=tuple(mapped),
        scale=scale,
        heading_deg=heading_deg,
        off_at_m=float(rng.uniform(600, 2400)) if off_how else math.inf,
        off_how=off_how,
        alias=alias,
        alias_from_m=30.0,
        steers=bool(rng.random() < 0.5),
        parallax=bool(rng.random() < 0.5),
        speed_mps=float(rng.uniform(3, 12)),
    )
    return drawn, weight * share


@dataclass(frozen=True)
class Drive:
    """What a drive showed. bounded: arrays (n, 7) of the fields of `Bounded`, of one path.

    reached: probability (len(LEVELS),) with which such a drive comes as near as each level; the last one exceeds it.
    """

    hours: float
    weight: float
    parallax: bool
    bounded: np.ndarray
    reached: np.ndarray


def drive(seed: int, name: str, folder: Path) -> Drive:
    """Drive a course of a class."""
    drawn, weight = course(seed, CLASSES[name].shifted_m)
    bench = Bench(drawn, seed, folder)
    near = reached_by(bench, CLASSES[name].split, np.random.default_rng([seed, 99]))
    bounded = np.array(bench.result.bounded).reshape(-1, 7)
    return Drive(bench.seconds / 3600, weight, drawn.parallax, bounded, near)


def exceeded(bounded: Sequence[Bounded]) -> int:
    """Episodes in which a position is further off than its protection level."""
    at_m = [one.at_m for one in bounded if one.along_m > one.level_along_m or one.across_m > one.level_across_m]
    return sum(index == 0 or at - at_m[index - 1] > CORRELATED_M for index, at in enumerate(at_m))


def drives(count: int, first_seed: int, folder: Path) -> dict[str, list[Drive]]:
    """So many drives of each class, or a multiple of it, on all processors."""
    found = {}
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for name, of_class in CLASSES.items():
            seeds = range(first_seed, first_seed + of_class.times * count)
            found[name] = list(pool.map(drive, seeds, repeat(name), repeat(folder)))
            first_seed = seeds.stop
    return found


def rate(found: dict[str, list[Drive]]) -> tuple[float, float]:
    """Drives an hour in which an error exceeds its level, as drives occur: the estimate, and its bound at CONFIDENCE.

    The classes share what may be wrong.
    """
    hours = sum(float(np.mean([one.weight * one.hours for one in of_class])) for of_class in found.values())
    estimate = sum(float(weighted(of_class)[:, -1].mean()) for of_class in found.values())
    bound = sum(upper_bound(of_class, (1 - CONFIDENCE) / len(found)) for of_class in found.values())
    return estimate / hours, bound / hours


def weighted(of_class: Sequence[Drive]) -> np.ndarray:
    """How often each drive comes as near as each level (n, len(LEVELS)), as such drives occur."""
    return np.array([one.weight * one.reached for one in of_class])


def bounding_level(of_class: Sequence[Drive]) -> int | None:
    """The highest level to which FEW drives came: what comes to the last comes to it as well. None: none.

    Drives that came to it more often than others count as fewer (Kish's effective sample size).
    """
    shares = weighted(of_class)
    effective = shares.sum(axis=0) ** 2 / np.maximum((shares**2).sum(axis=0), np.finfo(float).tiny)
    enough = np.flatnonzero(effective >= FEW)
    return int(enough[-1]) if len(enough) else None


def upper_bound(of_class: Sequence[Drive], wrong: float) -> float:
    """At most so often, but for a probability of `wrong`: by the bootstrap over drives.

    Where too few come near to a level at all, by how many do, each as if it exceeded its level for certain.
    """
    level, count = bounding_level(of_class), len(of_class)
    if level is None:
        near = int((weighted(of_class)[:, 0] > 0).sum())
        return max(one.weight for one in of_class) * most_events(near, wrong) / count
    shares, rng = weighted(of_class)[:, level], np.random.default_rng(1)
    drawn = np.array([shares[rng.integers(count, size=count)].mean() for _ in range(RESAMPLED)])
    return float(np.quantile(drawn, 1 - wrong))


def most_events(count: int, wrong: float) -> float:
    """The mean of a Poisson distribution that gives at most `count` with the probability `wrong`."""
    low, high = 0.0, 10.0 * (count + 10)
    while high - low > 1e-6:
        mean = (low + high) / 2
        terms = np.exp(-mean + np.arange(count + 1) * math.log(mean) - [math.lgamma(k + 1) for k in range(count + 1)])
        low, high = (mean, high) if terms.sum() > wrong else (low, mean)
    return high


def statement(found: dict[str, list[Drive]], count: int, first_seed: int) -> str:
    """What was shown, for people."""
    (estimate, bound), drives = rate(found), sum(map(len, found.values()))
    nearest = ", ".join(
        f"{name} {'-' if level is None else format(LEVELS[level], '.2f')}"
        for name, of_class in found.items()
        for level in [bounding_level(of_class)]
    )
    medians = ", ".join(
        f"{along_m:.1f} and {across_m:.1f} m {how} parallax"
        for how, parallax in (("with", True), ("without", False))
        for along_m, across_m in [median_level_m(found["right"], parallax)]
    )
    command = f"python -m tests.localization.level_hours --drives {count} --seed {first_seed}"
    text = (
        f"`{command}`: in {drives:,} drives an error exceeds its level {estimate:.1g} times an hour, "
        f"at 95 % confidence below {bound:.2g}. That bound is how often "
        f"errors come to the highest share of their levels to which {FEW} drives alike came: {nearest}. "
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
    parser.add_argument(
        "--drives", type=int, default=200, metavar="N", help="of each class, of some a multiple (default 200)"
    )
    parser.add_argument("--seed", type=int, help="the first (default: a new one)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write what was shown into this page")
    args = parser.parse_args(argv)
    first_seed = int(time.time()) if args.seed is None else args.seed
    with TemporaryDirectory() as folder:
        text = statement(drives(args.drives, first_seed, Path(folder)), args.drives, first_seed)
    print(text)
    if args.page is not None:
        put_between("level hours", args.page, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
