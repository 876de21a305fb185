"""`lookback sim fixes`: many seeded drives home without GPS, and what the autopilot made of the fixes."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from edge.errors import ConfigError
from sim.evaluation.memoizing_network import MemoizingNetwork
from sim.trial.course import LIGHTS, one_run, prepare_world
from sim.trial.run import Rules, drive_home, drive_home_live
from sim.trial.score import RunScore, TrialScore
from sim.vehicle.firmware import FIRMWARES

POSITION_MESSAGES = ("auto", "external_position", "global_position_sensor", "vision_position")


def add_command(sim_commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `fixes` to the commands of `lookback sim`."""
    parser = sim_commands.add_parser(
        "fixes", help="simulate many drives without GPS and measure the autopilot's position error"
    )
    parser.add_argument("--runs", type=int, default=50, metavar="N", help="number of seeded drives (default 50)")
    parser.add_argument("--first-seed", type=int, default=1, metavar="SEED", help="seed of the first run (default 1)")
    parser.add_argument("--worlds", type=int, default=len(LIGHTS), metavar="N", help="number of roads (default 5)")
    parser.add_argument("--firmware", choices=list(FIRMWARES), default="ardupilot")
    parser.add_argument("--emit", choices=POSITION_MESSAGES, default="auto", help="as [telemetry] emit (default auto)")
    parser.add_argument("--no-gps", action="store_true", help="no GPS even at the start; an origin is set nearby")
    parser.add_argument("--live", action="store_true", help="in real time, with the daemon in its own process")
    parser.add_argument(
        "--at-once", type=int, default=1, metavar="N", help="number of live drives in parallel (default 1)"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("trial"), metavar="FOLDER")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    if min(args.runs, args.worlds, args.at_once) < 1:
        raise ConfigError("--runs, --worlds, --at-once: at least 1")
    args.output.mkdir(parents=True, exist_ok=True)
    scores = []
    for score in (_live if args.live else _simulated)(args):
        print(_line(score), flush=True)
        scores.append(score)
    trial = TrialScore(tuple(scores))
    print(trial.table())
    for failure in trial.failures:
        print(f"not good enough: {failure}")
    return 1 if trial.failures else 0


def _simulated(args: argparse.Namespace) -> Iterator[RunScore]:
    """World by world, since drives on the same road share what the network has described."""
    logging.getLogger("edge").setLevel(logging.WARNING)  # the daemon logs a line at each end of each stretch
    network = MemoizingNetwork.load()
    for number in range(min(args.worlds, args.runs)):
        world = prepare_world(number, args.output)
        for seed in range(args.first_seed + number, args.first_seed + args.runs, args.worlds):
            with one_run(world, seed, args.output) as (course, folder):
                yield drive_home(world, course, seed, network, folder, _rules(args))
        network.clear()


def _live(args: argparse.Namespace) -> Iterator[RunScore]:
    """Some drives at once, each with two processes of its own: one for the autopilot, one for the daemon."""
    for number in range(min(args.worlds, args.runs)):
        prepare_world(number, args.output)
    seeds = range(args.first_seed, args.first_seed + args.runs)
    numbers = [(seed - args.first_seed) % args.worlds for seed in seeds]
    with ProcessPoolExecutor(args.at_once, get_context("spawn")) as pool:
        yield from pool.map(partial(_one_live, args.output, _rules(args)), numbers, seeds)


def _one_live(output: Path, rules: Rules, number: int, seed: int) -> RunScore:
    world = prepare_world(number, output)
    with one_run(world, seed, output) as (course, folder):
        return drive_home_live(world, course, seed, folder, rules)


def _rules(args: argparse.Namespace) -> Rules:
    return Rules(args.firmware, args.emit, gps_at_start=not args.no_gps)


def _line(run: RunScore) -> str:
    after = sorted(run.after_m)
    middle = f"{after[len(after) // 2]:4.1f}" if after else "   -"
    return (
        f"seed {run.seed:3d}  {run.light:<5}  {len(run.fix_error_m):3d} fixes, {len(after):3d} used, autopilot then"
        f" {middle} m off (largest {max(after, default=0.0):4.1f}),"
        f" at most {max(run.fix_sigmas, default=0.0):.1f} sigma,"
        f" false {run.false_fixes}; withheld: {', '.join(f'{why} {n}' for why, n in sorted(run.withheld.items()))}"
    )
