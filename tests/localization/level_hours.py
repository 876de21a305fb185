"""How often errors exceed their protection levels, by seeded drives without pictures.

The drives have what positions are wrong by: errors of matches and of their parallax that last, an odometer and a
heading that are wrong, stretches of the map that are shifted as often as `STRETCH_WRONG` says, unmapped stretches of
which some resemble the map, turn-offs, halts and reversing. What is rare is drawn more often and weighted (importance
sampling, `level_course`): shifted stretches, in classes of their own, and large errors of odometer and heading. The
nearer an error is to its level, the more paths follow the drive from there (`splitting`).

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

import numpy as np
from tqdm import tqdm

from edge.files import replacing
from sim.research.trial.table import put_between
from tests.localization.level_course import CLASSES, course
from tests.localization.route_bench import CORRELATED_M, Bench, Bounded
from tests.localization.splitting import LEVELS, reached_by

CONFIDENCE = 0.95
SEEDS = 250_000  # of a class
FEW, RESAMPLED = 10, 10_000
"""Drives alike that must come to a level for a bound (`bounding_level`), and how often drives are drawn anew for it."""


def seed_of_run() -> int:
    """The first seed of this run, another one where LOOKBACK_SEED says so; drives add less than a million to it."""
    return int(os.environ.get("LOOKBACK_SEED") or 1) * 1_000_000


@dataclass(frozen=True)
class Drive:
    """What a drive showed. bounded: arrays (n, 7) of the fields of `Bounded`, of one path.

    reached: how often (len(LEVELS),) such a drive comes as near as each level (`splitting`); the last one exceeds it.
    """

    hours: float
    weight: float
    parallax: bool
    bounded: np.ndarray
    reached: np.ndarray


def drive(seed: int, name: str, folder: Path) -> Drive:
    """Drive a course of a class, or read from `folder` what it showed before."""
    kept = folder / f"{seed}.npz"
    if not kept.exists():
        of_class = CLASSES[name]
        drawn, weight = course(seed, of_class)
        with TemporaryDirectory() as maps:
            bench = Bench(drawn, seed, Path(maps))
        near = reached_by(bench, of_class.split, np.random.default_rng([seed, 99]))
        bounded = np.array(bench.result.bounded).reshape(-1, 7)
        found = Drive(bench.seconds / 3600, weight, drawn.parallax, bounded, near)
        with replacing(kept) as file:
            np.savez(file, **vars(found))
    with np.load(kept) as of:
        return Drive(float(of["hours"]), float(of["weight"]), bool(of["parallax"]), of["bounded"], of["reached"])


def exceeded(bounded: Sequence[Bounded]) -> int:
    """Episodes in which a position is further off than its protection level."""
    at_m = [one.at_m for one in bounded if one.along_m > one.level_along_m or one.across_m > one.level_across_m]
    return sum(index == 0 or at - at_m[index - 1] > CORRELATED_M for index, at in enumerate(at_m))


def drives(count: int, first_seed: int, folder: Path) -> dict[str, list[Drive]]:
    """So many drives of each class, or a multiple of it, on all processors; those in `folder` are read from there."""
    found = {}
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for number, (name, of_class) in enumerate(CLASSES.items()):
            seeds = range(first_seed + number * SEEDS, first_seed + number * SEEDS + of_class.times * count)
            every = pool.map(drive, seeds, repeat(name), repeat(folder))
            found[name] = list(tqdm(every, name, len(seeds), leave=False))
    return found


def rate(found: dict[str, list[Drive]]) -> tuple[float, dict[str, float]]:
    """Times an hour that an error exceeds its level, as drives occur: the estimate, and the most of each class.

    The sum of these is the bound at CONFIDENCE: the classes share what may be wrong.
    """
    hours = sum(float(np.mean([one.weight * one.hours for one in of_class])) for of_class in found.values())
    estimate = sum(float(weighted(of_class)[:, -1].mean()) for of_class in found.values())
    wrong = (1 - CONFIDENCE) / len(found)
    return estimate / hours, {name: upper_bound(of_class, wrong) / hours for name, of_class in found.items()}


def weighted(of_class: Sequence[Drive]) -> np.ndarray:
    """How often each drive comes as near as each level (n, len(LEVELS)), as such drives occur."""
    return np.array([one.weight * one.reached for one in of_class])


def bounding_level(of_class: Sequence[Drive]) -> int | None:
    """The highest level to which, and to each lower one, FEW drives came: what comes to the last comes to it as well.

    None: none. Drives that came to one more often than others count as fewer (Kish's effective sample size). Where few
    come to a lower one, those that come to a higher one say little: what made the former rare was not yet drawn.
    """
    shares = weighted(of_class)
    effective = shares.sum(axis=0) ** 2 / np.maximum((shares**2).sum(axis=0), np.finfo(float).tiny)
    count = int((effective >= FEW).cumprod().sum())
    return count - 1 if count else None


def upper_bound(of_class: Sequence[Drive], wrong: float) -> float:
    """At most so often, but for a probability of `wrong`: by the bootstrap over drives; infinite where few come near.

    With one drive more, like that which came nearest: most of a sum of such shares may be in a drive not yet drawn.
    """
    level, count = bounding_level(of_class), len(of_class)
    if level is None:
        return math.inf
    shares, rng = weighted(of_class)[:, level], np.random.default_rng(1)
    shares = np.append(shares, shares.max())
    drawn = [shares[rng.integers(count + 1, size=count + 1)].sum() / count for _ in range(RESAMPLED)]
    return float(np.quantile(drawn, 1 - wrong))


def statement(found: dict[str, list[Drive]], count: int, first_seed: int) -> str:
    """What was shown, for people."""
    (estimate, bounds), drives = rate(found), sum(map(len, found.values()))
    nearest = ", ".join(
        f"{name} {'-' if level is None else format(LEVELS[level], '.2f')} (below {bounds[name]:.1g})"
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
        f"at 95 % confidence below {sum(bounds.values()):.2g}. That bound is how often "
        f"errors come to the highest share of their levels up to which {FEW} drives alike came: {nearest}. "
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
    parser.add_argument(
        "--keep",
        type=Path,
        metavar="FOLDER",
        help="of drives: those there are not driven again; empty it when the code changes",
    )
    parser.add_argument("--page", type=Path, metavar="FILE", help="write what was shown into this page")
    args = parser.parse_args(argv)
    first_seed = int(time.time()) if args.seed is None else args.seed
    with TemporaryDirectory() as folder:
        kept = Path(folder) if args.keep is None else args.keep
        kept.mkdir(parents=True, exist_ok=True)
        text = statement(drives(args.drives, first_seed, kept), args.drives, first_seed)
    print(text)
    if args.page is not None:
        put_between("level hours", args.page, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
