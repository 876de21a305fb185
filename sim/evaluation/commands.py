"""The options of `lookback eval`. Each action is imported when it runs: matplotlib alone takes half a second."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `lookback eval`; the entry point of `lookback.commands`."""
    actions = commands.add_parser("eval", help="the paper's comparisons on your traverses").add_subparsers(
        required=True, metavar="COMMAND"
    )
    _add_run(actions.add_parser("run", help="run a plan and write its report"))
    _add_match(actions.add_parser("match", help="search a cost matrix, and score the matches"))
    shrinking = actions.add_parser("shrinking", help="what fewer dimensions cost, measured on a map that has them")
    shrinking.add_argument("map", type=Path, metavar="MAP", help="a map that `map build --dimensions` made")
    shrinking.set_defaults(run=_shrinking)


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "plan", type=Path, metavar="PLAN", help="TOML as sim/evaluation/plan.py describes it, or simulator, real_feeds"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="for HTML, CSV and PNG")
    parser.add_argument("--feeds", type=Path, metavar="FOLDER", help="where the plan's feeds are (default: beside it)")
    parser.add_argument("--models", type=Path, metavar="FOLDER", help="where its models are (default: beside it)")
    elsewhere = parser.add_mutually_exclusive_group()
    elsewhere.add_argument("--workers", type=int, default=1, metavar="N", help="describe traverses in N processes")
    elsewhere.add_argument("--cluster", default="", metavar="ADDRESS", help="describe them on a Dask cluster instead")
    parser.set_defaults(run=_run)


def _add_match(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("costs", type=Path, metavar="COSTS.npy", help="reference x query, lower is more alike")
    parser.add_argument("--truth", type=Path, help=".csv or .npy: a query's true reference index a row, -1 off the map")
    parser.add_argument("--tolerance", type=float, default=5.0, metavar="N", help="right within N places (default 5)")
    parser.add_argument("--length", type=int, default=20, help="frames in a sequence (default 20)")
    parser.add_argument("--directions", choices=("both", "forward", "reverse"), default="both")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the matches there as CSV")
    parser.set_defaults(run=_match)


def _run(args: argparse.Namespace) -> int:
    from sim.evaluation.run import run

    return run(args)


def _match(args: argparse.Namespace) -> int:
    from sim.evaluation.match_command import run

    return run(args)


def _shrinking(args: argparse.Namespace) -> int:
    from sim.evaluation.shrinking import run

    return run(args)
