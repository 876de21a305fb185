"""`lookback sim fixes`: many seeded drives home, each without GPS, and what the autopilot made of the fixes."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

from edge.errors import ConfigError
from sim.firmware import FIRMWARES
from sim.trial.course import LIGHTS, RememberingNetwork, lay_course, prepare_world
from sim.trial.live import drive_home_live
from sim.trial.run import drive_home
from sim.trial.score import RunScore, TrialScore

WAYS = ("auto", "external_position", "global_position_sensor", "vision_position")


def add_command(sim_commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `fixes` to the commands of `lookback sim`."""
    parser = sim_commands.add_parser("fixes", help="many drives without GPS: is the autopilot told the truth?")
    parser.add_argument("--runs", type=int, default=50, metavar="N", help="seeded drives, default 50")
    parser.add_argument("--first-seed", type=int, default=1, metavar="SEED", help="of the first run, default 1")
    parser.add_argument("--worlds", type=int, default=len(LIGHTS), metavar="N", help="roads that they share, default 5")
    parser.add_argument("--firmware", choices=list(FIRMWARES), default="ardupilot")
    parser.add_argument("--emit", choices=WAYS, default="auto", help="as [telemetry] emit, default auto")
    parser.add_argument("--live", action="store_true", help="in real time, the daemon as its own process")
    parser.add_argument("-o", "--output", type=Path, default=Path("trial"), metavar="FOLDER")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    if args.runs < 1 or args.worlds < 1:
        raise ConfigError("--runs, --worlds: at least 1")
    args.output.mkdir(parents=True, exist_ok=True)
    logging.getLogger("edge").setLevel(logging.WARNING)  # the daemon says a line at each end of each stretch
    network, scores = RememberingNetwork.load(), []
    for number in range(min(args.worlds, args.runs)):
        world = prepare_world(number, args.output)
        for seed in range(args.first_seed + number, args.first_seed + args.runs, args.worlds):
            course = lay_course(world, seed, args.output / "run.map")
            if args.live:
                run = drive_home_live(world, course, seed, args.output, args.firmware, args.emit)
            else:
                run = drive_home(world, course, seed, network, args.output, args.firmware, args.emit)
            scores.append(run)
            print(_line(scores[-1], world.home.light), flush=True)
        network.forget()
    trial = TrialScore(tuple(scores))
    print(trial.table())
    for failure in trial.failures:
        print(f"not good enough: {failure}")
    return 1 if trial.failures else 0


def _line(run: RunScore, light: str) -> str:
    after = sorted(run.after_m)
    middle = f"{after[len(after) // 2]:4.1f}" if after else "   -"
    return (
        f"seed {run.seed:3d}  {light:<5}  {len(run.fix_error_m):3d} fixes, {len(after):3d} taken, autopilot then"
        f" {middle} m off (largest {max(after, default=0.0):4.1f}),"
        f" at most {max(run.fix_sigmas, default=0.0):.1f} sigma,"
        f" false {run.false_fixes}; withheld: {', '.join(f'{why} {n}' for why, n in sorted(run.withheld.items()))}"
    )
