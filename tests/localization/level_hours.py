"""How often errors exceed their protection levels, by seeded drives without pictures.

The drives have what positions are wrong by: errors of matches and of their parallax that last, an odometer and a
heading that are wrong, stretches of the map that are shifted as often as `STRETCH_WRONG` says, unmapped stretches of
which some resemble the map, turn-offs, halts and reversing. What is rare is drawn more often and weighted (importance
sampling, `level_course`): shifted stretches, in classes of their own, and large errors of odometer and heading. Where
errors come near to their levels, paths go on from there (`splitting`).

    python -m tests.localization.level_hours --groups 40 20 30 20 --page docs/integrity.md
"""

from __future__ import annotations

import argparse
import math
import os
import textwrap
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from decimal import ROUND_CEILING, Context
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
from tqdm import tqdm

from sim.research.trial.table import put_between
from tests.localization.level_course import CLASSES, course
from tests.localization.route_bench import CORRELATED_M, Bounded, Result
from tests.localization.splitting import EFFORT, LEVELS, BoundedDrive, begun, reached

KEPT = Path(__file__).with_name("level_groups.jsonl")
"""The groups that were driven so far; each took a processor one to six minutes."""
CONFIDENCE = 0.95
SEEDS = 250_000  # of a class
FEW, RESAMPLED = 10, 10_000
"""Groups alike that must come to a level for a bound (`bounding_level`), and how often groups are drawn anew for it."""


def seed_of_run() -> int:
    """The first seed of this run, another one where LOOKBACK_SEED says so; drives add less than a million to it."""
    return int(os.environ.get("LOOKBACK_SEED") or 1) * 1_000_000


class Group(msgspec.Struct, frozen=True):
    """What some drives of a class showed on average, each as often as it occurs.

    drives: how many. reached: how often one comes as near as each of LEVELS (`splitting`); the last one exceeds it.
    medians_m: of the finite protection levels, along and across, with parallax and without; None where there were none.
    first_m: all errors of the first drive, which other code would change.
    """

    of_class: str
    first_seed: int
    drives: int
    hours: float
    reached: list[float]
    medians_m: tuple[tuple[float, float] | None, tuple[float, float] | None]
    first_m: float


def driven(first_seed: int, name: str) -> Group:
    """Drive as many courses of a class as a group has, and follow what comes near to a level."""
    of_class, rng = CLASSES[name], np.random.default_rng([first_seed, 99])
    hours, first_m, paths, levels_m = 0.0, 0.0, [], [np.zeros((0, 3))]
    with TemporaryDirectory() as maps:
        for seed in range(first_seed, first_seed + of_class.together):
            drawn, weight = course(seed, of_class)
            bench = BoundedDrive(drawn, seed, Path(maps))
            paths += begun(bench, weight / of_class.together, rng)
            hours += weight / of_class.together * bench.seconds / 3600
            if seed == first_seed:
                first_m = round_to_6(summed_m(bench.result))
            every = np.array(bench.result.bounded).reshape(-1, 7)[:, 5:]
            levels_m.append(np.insert(every[np.isfinite(every[:, 0])], 0, drawn.parallax, axis=1))
        near = [round_to_6(share) for share in reached(paths, EFFORT * of_class.together, rng)]
    of_all = np.concatenate(levels_m)
    with_parallax, without = (_median(of_all[of_all[:, 0] == parallax, 1:]) for parallax in (True, False))
    return Group(name, first_seed, of_class.together, round_to_6(hours), near, (with_parallax, without), first_m)


def round_to_6(number: float) -> float:
    """To so many digits."""
    return float(f"{number:.6g}")


def summed_m(result: Result) -> float:
    """All errors, along and across."""
    return float(sum(one.along_m + one.across_m for one in result.bounded))


def _median(levels_m: np.ndarray) -> tuple[float, float] | None:
    if not len(levels_m):
        return None
    along_m, across_m = np.median(levels_m, axis=0).round(2).tolist()
    return along_m, across_m


def exceeded(bounded: Sequence[Bounded]) -> int:
    """Episodes in which a position is further off than its protection level."""
    at_m = [one.at_m for one in bounded if one.along_m > one.level_along_m or one.across_m > one.level_across_m]
    return sum(index == 0 or at - at_m[index - 1] > CORRELATED_M for index, at in enumerate(at_m))


def read(kept: Path) -> dict[int, Group]:
    """The groups of a file, by their first seed; none if there is no file. ValueError if it is damaged."""
    decoder, known = msgspec.json.Decoder(Group), {}
    for number, line in enumerate(kept.read_bytes().splitlines() if kept.exists() else [], start=1):
        try:
            one = decoder.decode(line)
        except msgspec.DecodeError as error:
            raise ValueError(f"{kept}: line {number}: {error}; delete the line") from error
        known[one.first_seed] = one
    return known


def check(kept: Path, known: dict[int, Group]) -> None:
    """ValueError if groups are of other classes, or the first one of a class was driven by other code.

    Its first drive is driven again.
    """
    for one in known.values():
        of_class = CLASSES.get(one.of_class)
        if of_class is None or of_class.together != one.drives or len(one.reached) != len(LEVELS):
            raise ValueError(f"{kept}: group {one.first_seed} is of another class; delete the file")
    for one in {one.of_class: one for one in reversed(known.values())}.values():
        drawn, _ = course(one.first_seed, CLASSES[one.of_class])
        with TemporaryDirectory() as maps:
            now_m = summed_m(BoundedDrive(drawn, one.first_seed, Path(maps)).run())
        if not math.isclose(now_m, one.first_m, rel_tol=1e-4):
            raise ValueError(f"{kept}: group {one.first_seed} was driven by other code; delete the file")


def seeds(counts: Sequence[int], first_seed: int) -> dict[str, range]:
    """The first seeds of so many groups of each class."""
    found = {}
    for number, ((name, of_class), count) in enumerate(zip(CLASSES.items(), counts, strict=True)):
        first, together = first_seed + number * SEEDS, of_class.together
        found[name] = range(first, first + count * together, together)
    return found


def groups(wanted: Mapping[str, range], kept: Path | None = None) -> dict[str, list[Group]]:
    """The groups of each class that begin with those seeds, on all processors; those in `kept` are not driven again.

    ValueError if `kept` is damaged, or was driven by other code.
    """
    known: dict[int, Group] = {}
    found = {}
    if kept is not None:
        known = read(kept)
        check(kept, known)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for name, every in wanted.items():
            missing = [seed for seed in every if seed not in known]
            for one in tqdm(pool.map(driven, missing, repeat(name)), name, len(missing), leave=False):
                known[one.first_seed] = one
                if kept is not None:
                    with kept.open("ab") as file:
                        file.write(msgspec.json.encode(one) + b"\n")
            found[name] = [known[seed] for seed in every]
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


def statement(found: dict[str, list[Group]], first_seed: int) -> str:
    """What was shown, for people."""
    (estimate, bounds), drives = rate(found), sum(one.drives for of_class in found.values() for one in of_class)
    bound, nearest = sum(bounds.values()), []
    most = f"below {decimal(bound, 2)}" if math.isfinite(bound) else "not bounded yet"
    for name, of_class in found.items():
        level = bounding_level(of_class)
        come = "none" if level is None else f"{LEVELS[level]:.2f} (below {decimal(bounds[name], 2)})"
        nearest.append(f"{name} {come}")
    medians = ", ".join(
        f"{along_m:.1f} and {across_m:.1f} m {how} parallax"
        for how, parallax in (("with", True), ("without", False))
        for along_m, across_m in [median_level_m(found["right"], parallax=parallax)]
    )
    counts = " ".join(str(len(every)) for every in found.values())
    command = f"python -m tests.localization.level_hours --groups {counts} --seed {first_seed}"
    text = (
        f"`{command}`: in {drives:,} drives an error exceeds its level {decimal(estimate)} times an hour, "
        f"at 95 % confidence {most}. The bound is how often errors come to the highest "
        f"share of their levels up to which {FEW} groups of drives alike came: {', '.join(nearest)}. "
        f"Median levels on right maps, along and across: {medians}."
    )
    return textwrap.fill(text, 120, break_on_hyphens=False)


def decimal(number: float, digits: int = 1) -> str:
    """Not less, to so many digits, and without an exponent."""
    return f"{Context(digits, ROUND_CEILING).create_decimal(number):f}"


def median_level_m(of_class: Sequence[Group], *, parallax: bool) -> tuple[float, float]:
    """The medians along and across of those of the groups."""
    medians_m = [one.medians_m[0 if parallax else 1] for one in of_class]
    along_m, across_m = np.median([one for one in medians_m if one is not None], axis=0)
    return float(along_m), float(across_m)


def main(argv: Sequence[str] | None = None) -> int:
    """Count, print what was shown, and write it into a page."""
    parser = argparse.ArgumentParser(prog="python -m tests.localization.level_hours", description=__doc__)
    parser.add_argument(
        "--groups",
        type=int,
        nargs=len(CLASSES),
        default=[2] * len(CLASSES),
        metavar="N",
        help="of drives, of each class (default 2, a quarter of an hour of a processor)",
    )
    parser.add_argument("--seed", type=int, help="the first (default: a new one)")
    parser.add_argument(
        "--keep",
        type=Path,
        metavar="FILE",
        help="of groups: those in it are not driven again, and new ones are added",
    )
    parser.add_argument("--page", type=Path, metavar="FILE", help="write what was shown into this page")
    args = parser.parse_args(argv)
    first_seed = int(time.time()) if args.seed is None else args.seed
    try:
        found = groups(seeds(args.groups, first_seed), args.keep)
    except ValueError as error:
        parser.error(str(error))
    text = statement(found, first_seed)
    print(text)
    if args.page is not None:
        put_between("level hours", args.page, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
