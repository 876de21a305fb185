"""`lookback sim fixes`: seeded drives over the named courses, each judged by its rules."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence
from pathlib import Path

from edge.descriptor.network import Network
from edge.errors import ConfigError
from sim.trial.courses import CASES, COURSES, courses_of
from sim.trial.rules import Run
from sim.trial.run import drive
from sim.trial.table import HEADER, CourseScore, line
from sim.trial.views import RoadLibrary

WORLD, LENGTH_M, SHORTEST_M = 21, 1000.0, 500.0


def add_command(sim_commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `fixes` to the commands of `lookback sim`."""
    parser = sim_commands.add_parser(
        "fixes", help="simulate drives without GPS over named courses, and judge every position by the truth"
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--course", default="home", metavar="NAME", help="course, `all`, or `list` to print them (default home)"
    )
    what.add_argument(
        "--case", metavar="LETTER", help=f"a case of courses, {min(CASES)} to {max(CASES)} or `all`: each seed has one"
    )
    parser.add_argument(
        "--runs", type=int, default=5, metavar="N", help="seeded drives of each course, or of each case (default 5)"
    )
    parser.add_argument("--first-seed", type=int, default=1, metavar="SEED", help="seed of the first (default 1)")
    parser.add_argument(
        "--length-m", type=float, default=LENGTH_M, metavar="M", help=f"of the road, from {SHORTEST_M:g} (default 1000)"
    )
    parser.add_argument(
        "--world", type=int, default=WORLD, metavar="SEED", help=f"seed of the road (default {WORLD}, as flown)"
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("trial"), metavar="FOLDER", help="keeps journals and rendered views"
    )
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    if args.course == "list":
        width = max(map(len, COURSES))
        for case in CASES:
            print("\n".join(f"{name:<{width}}  {case}  {COURSES[name].about}" for name in courses_of(case)))
        return 0
    _check(args)
    logging.getLogger("edge").setLevel(logging.ERROR)  # the daemon warns of what the courses do to it
    seeds = range(args.first_seed, args.first_seed + args.runs)
    if args.case is None:
        names = list(COURSES) if args.course == "all" else [args.course]
        scores = run_courses([(name, seed) for name in names for seed in seeds], args)
    else:
        scores = []
        for case in CASES if args.case == "all" else [args.case]:
            of_courses = run_courses(drives_of(case, seeds), args)
            together = tuple(run for score in of_courses for run in score.runs)
            scores += [CourseScore(f"**{case}: {CASES[case]}**", together), *of_courses]
    print("\n" + HEADER)
    for score in scores:
        print(score.row())
    return 1 if any(score.failures for score in scores) else 0


def drives_of(case: str, seeds: Sequence[int]) -> list[tuple[str, int]]:
    """The drives of a case: each seed with the next of its courses."""
    names = courses_of(case)
    return [(names[seed % len(names)], seed) for seed in seeds]


def _check(args: argparse.Namespace) -> None:
    if args.course != "all" and args.course not in COURSES:
        raise ConfigError(f"--course: {args.course!r} is not a course; `--course list` prints them")
    if args.case not in (None, "all", *CASES):
        raise ConfigError(f"--case: {args.case!r} is not one of {', '.join(CASES)} and all")
    if args.runs < 1:
        raise ConfigError("--runs: at least 1")
    if not SHORTEST_M <= args.length_m <= 20000:
        raise ConfigError(f"--length-m: {args.length_m:g} is not between {SHORTEST_M:g} and 20000")


def run_courses(drives: Sequence[tuple[str, int]], args: argparse.Namespace) -> list[CourseScore]:
    """Drive courses with seeds, print a line for each drive, and collect those of each course."""
    args.output.mkdir(parents=True, exist_ok=True)
    runs: dict[str, list[Run]] = {name: [] for name, _ in drives}
    library = RoadLibrary(Network.load(), args.output / "views")
    try:
        for name, seed in drives:
            runs[name].append(drive(name, seed, args.length_m, args.world, args.output, library))
            print(line(name, runs[name][-1]), flush=True)
    finally:
        library.save()
        library.close()
    return [CourseScore(name, tuple(of_course)) for name, of_course in runs.items()]
