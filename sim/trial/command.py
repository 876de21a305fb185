"""`lookback sim fixes`: seeded drives over the named courses, each judged by its rules."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence
from pathlib import Path

from edge.descriptor.network import Network
from edge.errors import ConfigError
from sim.trial.courses import COURSES, about
from sim.trial.run import drive
from sim.trial.table import HEADER, CourseScore, line
from sim.trial.views import RoadLibrary

WORLD, LENGTH_M, SHORTEST_M = 21, 1000.0, 500.0


def add_command(sim_commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `fixes` to the commands of `lookback sim`."""
    parser = sim_commands.add_parser(
        "fixes", help="simulate drives without GPS over named courses, and judge every position by the truth"
    )
    parser.add_argument(
        "--course", default="home", metavar="NAME", help="course, `all`, or `list` to print them (default home)"
    )
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="seeded drives of each course (default 5)")
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
        print("\n".join(f"{name:<26} {about(name)}" for name in COURSES))
        return 0
    if args.course != "all" and args.course not in COURSES:
        raise ConfigError(f"--course: {args.course!r} is not a course; `--course list` prints them")
    if args.runs < 1:
        raise ConfigError("--runs: at least 1")
    if not SHORTEST_M <= args.length_m <= 20000:
        raise ConfigError(f"--length-m: {args.length_m:g} is not between {SHORTEST_M:g} and 20000")
    logging.getLogger("edge").setLevel(logging.ERROR)  # the daemon warns of what the courses do to it
    names = list(COURSES) if args.course == "all" else [args.course]
    scores = run_courses(names, range(args.first_seed, args.first_seed + args.runs), args)
    print("\n" + HEADER)
    for score in scores:
        print(score.row())
    return 1 if any(score.failures for score in scores) else 0


def run_courses(names: Sequence[str], seeds: Sequence[int], args: argparse.Namespace) -> list[CourseScore]:
    """Drive each course with each seed, and print a line for each drive."""
    args.output.mkdir(parents=True, exist_ok=True)
    scores = []
    library = RoadLibrary(Network.load(), args.output / "views")
    try:
        for name in names:
            runs = []
            for seed in seeds:
                runs.append(drive(name, seed, args.length_m, args.world, args.output, library))
                print(line(name, runs[-1]), flush=True)
            scores.append(CourseScore(name, tuple(runs)))
            library.save()
    finally:
        library.close()
    return scores
