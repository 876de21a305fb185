"""`lookback dev sim fixes`: seeded drives over the named courses, on several roads, each judged by its rules."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from edge.config import FIRST_NETWORK
from edge.descriptor.network import Network
from edge.errors import ConfigError
from sim.research.trial.course_drive import drive
from sim.research.trial.course_rules import CourseRun
from sim.research.trial.courses import CASES, COURSES, courses_of
from sim.research.trial.courses.maps import on_keypoints
from sim.research.trial.table import TABLES, CourseScore, in_short, line, put_between, shown, side_by_side
from sim.trial.views import RoadLibrary

WORLDS = (21, 5, 11, 303, 911)
"""Nothing was set on the last two. 911 was driven on real autopilots."""
LENGTH_M, SHORTEST_M = 1000.0, 500.0


class DrivePlan(NamedTuple):
    """A drive of a course; world: seed of its road. keypoints: of its map, see `on_keypoints`."""

    course: str
    seed: int
    world: int
    keypoints: bool = False


def add_command(sim_commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `fixes` to the commands of `lookback dev sim`."""
    parser = sim_commands.add_parser(
        "fixes", help="simulate drives without GPS over named courses, and judge every position by the truth"
    )
    what = parser.add_mutually_exclusive_group()
    names = "courses, `all`, or `list` to print them (default home)"
    what.add_argument("--course", default="home", metavar="NAMES", help=names)
    letters = f"cases of courses, {min(CASES)} to {max(CASES)} or `all`: each seed has one"
    what.add_argument("--case", metavar="LETTERS", help=letters)
    runs = "seeded drives of each course, or of each case (default 5)"
    parser.add_argument("--runs", type=int, default=5, metavar="N", help=runs)
    parser.add_argument("--first-seed", type=int, default=1, metavar="SEED", help="seed of the first (default 1)")
    length = f"of the road, from {SHORTEST_M:g} (default 1000)"
    parser.add_argument("--length-m", type=float, default=LENGTH_M, metavar="M", help=length)
    roads = f"seeds of the roads, of which each drive has the next (default {','.join(map(str, WORLDS))})"
    parser.add_argument("--worlds", type=_worlds, default=WORLDS, metavar="SEEDS", help=roads)
    keypoints = "drive each on a map with keypoints as well, and compare both with the lane that was taught"
    parser.add_argument("--keypoints", action="store_true", help=keypoints)
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="roads driven side by side (default 1)")
    page = "write the table into this page, in place of its last one"
    parser.add_argument("--page", type=Path, metavar="FILE", help=page)
    kept = "keeps rendered views, and the journal of each road's last drive"
    parser.add_argument("-o", "--output", type=Path, default=Path("trial"), metavar="FOLDER", help=kept)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    if args.course == "list":
        width = max(map(len, COURSES))
        for case in CASES:
            print("\n".join(f"{name:<{width}}  {case}  {COURSES[name].about}" for name in courses_of(case)))
        return 0
    _check(args)
    runs = drive_all(plan(args), args)
    scores = compare(runs) if args.keypoints else judge(runs)
    name = "results"
    if args.keypoints:
        name = "known" if all(COURSES[one.course].case == "L" for one in runs) else "keypoints"
    table = shown(scores, TABLES[name]) if name in TABLES else in_short(scores)
    print("\n" + "\n".join([shown(scores), *(["", table] if name in TABLES else [])]))
    if args.page is not None:
        roads = ", ".join(str(world) for world in args.worlds)
        driven = "all" if args.course == "all" else ",".join(dict.fromkeys(one.course for one in runs))
        what = f"--course {driven}" if args.case is None else f"--case {args.case}"
        what += f" --runs {args.runs} --first-seed {args.first_seed} --length-m {args.length_m:g}"
        what += " --keypoints" * args.keypoints
        put_between(name, args.page, f"`lookback dev sim fixes {what}`, roads {roads}:\n\n{table}")
    return 1 if any(score.failures for score in scores) else 0


def plan(args: argparse.Namespace) -> list[DrivePlan]:
    """The drives that are asked for: of each course over the next of the roads, and of a case each seed's course."""
    seeds = range(args.first_seed, args.first_seed + args.runs)
    if args.case is not None:
        drives = [drive for case in (CASES if args.case == "all" else args.case) for drive in drives_of(case, seeds)]
    else:
        names = list(COURSES) if args.course == "all" else args.course.split(",")
        drives = [(name, seed, seed - 1 + number) for seed in seeds for number, name in enumerate(names)]
    maps = (False, True) if args.keypoints else (False,)
    return [
        DrivePlan(name, seed, args.worlds[turn % len(args.worlds)], has_keypoints)
        for name, seed, turn in drives
        for has_keypoints in maps
    ]


def drives_of(case: str, seeds: Sequence[int]) -> list[tuple[str, int, int]]:
    """The drives of a case, each seed with the next of its courses; and a number by which its road is chosen."""
    names = courses_of(case)
    return [(names[seed % len(names)], seed, seed % len(names) + seed // len(names)) for seed in seeds]


def judge(runs: dict[DrivePlan, CourseRun]) -> list[CourseScore]:
    """A score for each course; before those of a case one of them together, and first of all one of everything."""
    several = len({COURSES[one.course].case for one in runs}) > 1
    scores = [CourseScore("**all**", tuple(runs.values()))] if several else []
    for case, about in CASES.items():
        of_courses = [
            CourseScore(name, tuple(run for one, run in runs.items() if one.course == name))
            for name in dict.fromkeys(one.course for one in runs)
            if COURSES[name].case == case
        ]
        if len(of_courses) > 1:
            scores.append(CourseScore(f"**{case}: {about}**", tuple(run for one in of_courses for run in one.runs)))
        scores += of_courses
    return scores


def compare(runs: dict[DrivePlan, CourseRun]) -> list[CourseScore]:
    """Each course without keypoints and with them."""
    return [
        CourseScore(f"{name}, {words}", tuple(run for one, run in runs.items() if one[::3] == (name, keypoints)))
        for name in dict.fromkeys(one.course for one in runs)
        for keypoints, words in ((False, "sequence matches"), (True, "keypoint poses"))
    ]


def drive_all(planned: Sequence[DrivePlan], args: argparse.Namespace) -> dict[DrivePlan, CourseRun]:
    """Drive several roads side by side, and those on one road one after the other; print a line for each drive."""
    args.output.mkdir(parents=True, exist_ok=True)
    roads = [[one for one in planned if one.world == world] for world in dict.fromkeys(one.world for one in planned)]
    of_road = partial(drive_part, length_m=args.length_m, folder=args.output)
    found = {one: run for runs in side_by_side(of_road, roads, args.jobs) for one, run in runs.items()}
    return {one: found[one] for one in planned}


def drive_part(planned: Sequence[DrivePlan], length_m: float, folder: Path) -> dict[DrivePlan, CourseRun]:
    """Drives in one process."""
    logging.getLogger("edge").setLevel(logging.ERROR)  # the daemon warns of what the courses do to it
    library, runs = RoadLibrary(Network.load(Path(FIRST_NETWORK)), folder / "views"), {}
    try:
        for one in planned:
            journals = folder / f"road-{one.world}"
            journals.mkdir(exist_ok=True)
            course = on_keypoints(COURSES[one.course]) if one.keypoints else COURSES[one.course]
            runs[one] = drive(course, one.seed, length_m, one.world, journals, library)
            print(line(f"{one.course}{', keypoints' * one.keypoints}", runs[one]), flush=True)
    finally:
        library.save()
        library.close()
    return runs


def _worlds(text: str) -> tuple[int, ...]:
    """Seeds of roads, separated by commas."""
    return tuple(int(world) for world in text.split(","))


def _check(args: argparse.Namespace) -> None:
    for name in args.course.split(","):
        if name not in ("all", *COURSES):
            raise ConfigError(f"--course: {name!r} is not a course; `--course list` prints them")
    if args.case not in (None, "all") and not set(args.case) <= CASES.keys():
        raise ConfigError(f"--case: {args.case!r} is not one of {', '.join(CASES)} and all")
    if args.runs < 1:
        raise ConfigError("--runs: at least 1")
    if args.jobs < 1:
        raise ConfigError("--jobs: at least 1")
    if not SHORTEST_M <= args.length_m <= 20000:
        raise ConfigError(f"--length-m: {args.length_m:g} is not between {SHORTEST_M:g} and 20000")
