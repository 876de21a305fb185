"""`lookback dev paper`: run the paper's comparisons on your traverses.

Each action is imported when it runs: matplotlib alone takes half a second.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev paper`."""
    actions = parser.add_subparsers(required=True, metavar="COMMAND")
    run = actions.add_parser("run", help="run a plan and write its report")
    networks = actions.add_parser("networks", help="compare networks on the traverses of a plan")
    for action, module in ((run, "run"), (networks, "network_comparison")):
        _add_plan(action)
        action.set_defaults(run=_later(module))
    networks.add_argument(
        "--model",
        action="append",
        default=[],
        metavar="NAME=PATH",
        help="a network file or folder beside those of the plan; may be repeated",
    )


def _add_plan(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "plan",
        type=Path,
        metavar="PLAN",
        help="a plan (TOML, see plan.py beside this module), or one of simulator, real_feeds, real_front_rear",
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="folder for HTML, CSV and PNG files"
    )
    parser.add_argument(
        "--feeds", type=Path, metavar="FOLDER", help="folder of the plan's feeds (default: beside the plan)"
    )
    parser.add_argument(
        "--models", type=Path, metavar="FOLDER", help="folder of the plan's models (default: beside the plan)"
    )


def _later(module: str) -> Callable[[argparse.Namespace], int]:
    """What runs an action, whose module is imported when it runs."""
    return lambda args: int(import_module(f"sim.research.evaluation.{module}").run(args))
