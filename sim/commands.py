"""`lookback dev sim`: record simulated drives, simulate an autopilot, and in a clone drive the trial."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from tqdm import tqdm

from edge.errors import ConfigError
from sim.vehicle import command as autopilot_command
from sim.world.recording import SPACING_M, record_drive
from sim.world.scenario import load_scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev sim`."""
    sim_commands = parser.add_subparsers(required=True, metavar="COMMAND")
    drive = sim_commands.add_parser("drive", help="drive through the street world and record a feed")
    drive.add_argument("scenario", type=Path, help="TOML file; sim/world/scenario.py describes its keys")
    drive.add_argument("-o", "--output", metavar="FEED", type=Path, required=True, help="folder for the new feed")
    pace = drive.add_mutually_exclusive_group()
    pace.add_argument("--spacing-m", metavar="M", type=float, default=SPACING_M, help="a frame every M m (default 2)")
    pace.add_argument("--fps", metavar="HZ", type=float, help="or HZ frames per second")
    drive.set_defaults(run=_record)
    autopilot_command.add_command(sim_commands)
    if find_spec("sim.research"):  # by name, since it is in a clone only
        import_module("sim.research.trial.fixes_command").add_command(sim_commands)


def _record(args: argparse.Namespace) -> int:
    """Render and write the drive of a scenario; SetupError when scenario, option or folder is wrong."""
    for option, value in (("--spacing-m", args.spacing_m), ("--fps", args.fps)):
        # Not `value <= 0`: that would let NaN through.
        if value is not None and not 0 < value < float("inf"):
            raise ConfigError(f"{option}: {value:g} is not above 0")
    scenario = load_scenario(args.scenario)
    # disable=None: shown on a terminal only.
    bar = partial(tqdm, unit="frame", desc=args.output.name, disable=None)
    count = record_drive(scenario, args.output, spacing_m=args.spacing_m, fps=args.fps, progress=bar)
    print(f"{args.output}: {count} frames over {scenario.length_m:g} m", file=sys.stderr)
    return 0
