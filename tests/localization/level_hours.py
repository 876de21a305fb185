"""How often errors exceed their protection levels, by seeded drives without pictures.

The drives have what positions are wrong by: errors of matches and of their parallax that last, an odometer and a
heading that are wrong, stretches of the map that are shifted as often as `STRETCH_WRONG` says, unmapped stretches of
which some resemble the map, turn-offs, halts and reversing. What is rare is drawn more often and weighted (importance
sampling, `level_course`): shifted stretches, in classes of their own, and large errors of odometer and heading. Where
errors come near to their levels, paths go on from there (`splitting`).

    python -m tests.localization.level_hours --groups 10 --page docs/integrity.md
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
from tests.localization.level_course import CLASSES, Class, course
from tests.localization.route_bench import CORRELATED_M, Bounded
from tests.localization.splitting import EFFORT, LEVELS, BoundedDrive, begun, reached

CONFIDENCE = 0.95
SEEDS = 250_000  # of a class
FEW, RESAMPLED = 10, 10_000
"""Groups alike that must come to a level for a bound (`bounding_level`), and how often groups are drawn anew for it."""


def seed_of_run() -> int:
    """The first seed of this run, another one where LOOKBACK_SEED says so; drives add less than a million to it."""
    return int(os.environ.get("LOOKBACK_SEED") or 1) * 1_000_000


@dataclass(frozen=True)
class Group:
    """What some drives of a class showed on average, each as often as it occurs.

    reached: how often (len(LEVELS),) one comes as near as each level (`splitting`); the last one exceeds it. levels_m:
    1 with parallax, else 0, and the protection levels along and across (n, 3) of the positions that have any.
    """

    hours: float
    reached: np.ndarray
    levels_m: np.ndarray


def drive(first_seed: int, name: str, folder: Path) -> Group:
    """Drive courses of a class, or read from `folder` what they showed before."""
    kept = folder / f"{first_seed}.npz"
    if not kept.exists():
        with replacing(kept) as file:
            np.savez(file, **vars(driven(first_seed, CLASSES[name])))
    with np.load(kept) as of:
        return Group(float(of["hours"]), of["reached"], of["levels_m"])


def driven(first_seed: int, of_class: Class) -> Group:
    """Drive as many courses of a class as a group has, and follow what comes near to a level."""
    together = of_class.together
    rng, hours, paths, levels_m = np.random.default_rng([first_seed, 99]), 0.0, [], [np.zeros((0, 3))]
    with TemporaryDirectory() as maps:
        for seed in range(first_seed, first_seed + together):
            drawn, weight = course(seed, of_class)
            bench = BoundedDrive(drawn, seed, Path(maps))
            paths += begun(bench, weight / together, rng)
            hours += weight / together * bench.seconds / 3600
            every = np.array(bench.result.bounded).reshape(-1, 7)[:, 5:]
            finite = every[np.isfinite(every[:, 0])]
            levels_m.append(np.insert(finite, 0, drawn.parallax, axis=1))
        return Group(hours, reached(paths, EFFORT * together, rng), np.concatenate(levels_m))


def exceeded(bounded: Sequence[Bounded]) -> int:
    """Episodes in which a position is further off than its protection level."""
    at_m = [one.at_m for one in bounded if one.along_m > one.level_along_m or one.across_m > one.level_across_m]
    return sum(index == 0 or at - at_m[index - 1] > CORRELATED_M for index, at in enumerate(at_m))


def groups(count: int, first_seed: int, folder: Path) -> dict[str, list[Group]]:
    """So many groups of each class, or a multiple of it, on all processors; those in `folder` are read from there."""
    found = {}
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for number, (name, of_class) in enumerate(CLASSES.items()):
            first, together = first_seed + number * SEEDS, of_class.together
            seeds = range(first, first + of_class.times * count * together, together)
            every = pool.map(drive, seeds, repeat(name), repeat(folder))
            found[name] = list(tqdm(every, name, len(seeds), leave=False))
    return found


def rate(found: dict[str, list[Group]]) -> tuple[float, dict[str, float]]:
    """Times an hour that an error exceeds its level, as drives occur: the estimate, and the most of each class.

    The sum of these is the bound at CONFIDENCE: the classes share what may be wrong.
    """
    hours = sum(float(np.mean([one.hours for one in of_class])) for of_class in found.values())
    estimate = sum(float(shares(of_class)[:, -1].mean()) for of_class in found.values())
    wrong = (1 - CONFIDENCE) / len(found)
    return estimate / hours, {name: upper_bound(of_class, wrong) / hours for name, of_class in found.items()}


def shares(of_class: Sequence[Group]) -> np.ndarray:
    """How often the drives of each group come as near as each level (n, len(LEVELS))."""
    return np.array([one.reached for one in of_class])


def bounding_level(of_class: Sequence[Group]) -> int | None:
    """The highest level to which, and to each lower one, FEW groups came: what comes to the last comes to it as well.

    None: none. Groups that came to one more often than others count as fewer (Kish's effective sample size). Where few
    come to a lower one, those that come to a higher one say little: what made the former rare was not yet drawn.
    """
    every = shares(of_class)
    effective = every.sum(axis=0) ** 2 / np.maximum((every**2).sum(axis=0), np.finfo(float).tiny)
    count = int((effective >= FEW).cumprod().sum())
    return count - 1 if count else None


def upper_bound(of_class: Sequence[Group], wrong: float) -> float:
    """At most so often, but for a probability of `wrong`: by the bootstrap over groups; infinite where few come near.

    With one group more, like that which came nearest: most of a sum of such shares may be in one not yet drawn. Where
    their logarithms have a sigma of 2, a level that 40 groups suggest is reached up to 2.2 times as often as this
    (95 %). Errors exceed their levels far less often than they come to that one.
    """
    level, count = bounding_level(of_class), len(of_class)
    if level is None:
        return math.inf
    every, rng = shares(of_class)[:, level], np.random.default_rng(1)
    every = np.append(every, every.max())
    drawn = rng.choice(every, (RESAMPLED, count + 1)).sum(axis=1) / count
    return float(np.quantile(drawn, 1 - wrong))


def statement(found: dict[str, list[Group]], count: int, first_seed: int) -> str:
    """What was shown, for people."""
    (estimate, bounds), drives = rate(found), sum(CLASSES[name].together * len(every) for name, every in found.items())
    nearest = ", ".join(
        f"{name} {'-' if level is None else format(LEVELS[level], '.2f')} (below {bounds[name]:.1g})"
        for name, of_class in found.items()
        for level in [bounding_level(of_class)]
    )
    medians = ", ".join(
        f"{along_m:.1f} and {across_m:.1f} m {how} parallax"
        for how, parallax in (("with", True), ("without", False))
        for along_m, across_m in [median_level_m(found["right"], parallax=parallax)]
    )
    command = f"python -m tests.localization.level_hours --groups {count} --seed {first_seed}"
    text = (
        f"`{command}`: in {drives:,} drives an error exceeds its level {estimate:.1g} times an hour, "
        f"at 95 % confidence below {sum(bounds.values()):.2g}. That bound is how often errors come to the highest "
        f"share of their levels up to which {FEW} groups of drives alike came: {nearest}. "
        f"Median levels on right maps, along and across: {medians}."
    )
    return textwrap.fill(text, 120, break_on_hyphens=False)


def median_level_m(of_class: Sequence[Group], *, parallax: bool) -> tuple[float, float]:
    """The medians along and across of the finite levels."""
    every = np.concatenate([one.levels_m for one in of_class])
    along_m, across_m = np.median(every[every[:, 0] == parallax, 1:], axis=0)
    return float(along_m), float(across_m)


def main(argv: Sequence[str] | None = None) -> int:
    """Count, print what was shown, and write it into a page."""
    parser = argparse.ArgumentParser(prog="python -m tests.localization.level_hours", description=__doc__)
    parser.add_argument(
        "--groups", type=int, default=10, metavar="N", help="of drives, of each class a multiple (default 10)"
    )
    parser.add_argument("--seed", type=int, help="the first (default: a new one)")
    parser.add_argument(
        "--keep",
        type=Path,
        metavar="FOLDER",
        help="of groups: those there are not driven again; empty it when the code changes",
    )
    parser.add_argument("--page", type=Path, metavar="FILE", help="write what was shown into this page")
    args = parser.parse_args(argv)
    first_seed = int(time.time()) if args.seed is None else args.seed
    with TemporaryDirectory() as folder:
        kept = Path(folder) if args.keep is None else args.keep
        kept.mkdir(parents=True, exist_ok=True)
        text = statement(groups(args.groups, first_seed, kept), args.groups, first_seed)
    print(text)
    if args.page is not None:
        put_between("level hours", args.page, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
