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
    plans = "a plan (TOML, see plan.py beside this module), or one of simulator, real_feeds, real_front_rear"
    for name, module, about in (
        ("run", "run", "run a plan and write its report"),
        ("networks", "network_comparison", "compare networks on the traverses of a plan"),
    ):
        action = actions.add_parser(name, help=about)
        action.add_argument("plan", type=Path, metavar="PLAN", help=plans)
        action.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="of the report's files")
        for what in ("feeds", "models"):
            where = f"folder of the plan's {what} (default: beside the plan)"
            action.add_argument(f"--{what}", type=Path, metavar="FOLDER", help=where)
        action.set_defaults(run=_later(module))
        if name == "networks":
            beside = "a network file or folder beside those of the plan; may be repeated"
            action.add_argument("--model", action="append", default=[], metavar="NAME=PATH", help=beside)


def _later(module: str) -> Callable[[argparse.Namespace], int]:
    """What runs an action, whose module is imported when it runs."""
    return lambda args: int(import_module(f"sim.research.evaluation.{module}").run(args))
