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
    _add_match(actions.add_parser("match", help="find sequence matches in a cost matrix and score them"))


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


def _add_match(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "costs",
        type=Path,
        metavar="COSTS.npy",
        help="array (reference x query), lower is more similar; or a folder of VPR-Bench",
    )
    parser.add_argument(
        "--truth",
        type=Path,
        help=".csv or .npy: the true reference index of each query frame, -1 off the map; or .npy: which reference is"
        " right for which query (reference x query, true or false); or ground_truth_new.npy of VPR-Bench",
    )
    parser.add_argument(
        "--tolerance", type=float, default=5.0, metavar="N", help="a match is correct within N places (default 5)"
    )
    parser.add_argument("--length", type=int, help="frames in a sequence (default 20; 1 for VPR-Bench)")
    parser.add_argument("--directions", choices=("both", "forward", "reverse"), default="both")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the matches to this CSV file")
    parser.set_defaults(run=_later("match_command"))


def _later(module: str) -> Callable[[argparse.Namespace], int]:
    """What runs an action, whose module is imported when it runs."""
    return lambda args: int(import_module(f"sim.research.evaluation.{module}").run(args))
