"""`lookback config`: print a config file to start from, or with every key."""

from __future__ import annotations

import argparse

from edge.config import DEFAULT_TOML, START_TOML


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback config`."""
    parser.description = "Prints a config file with the keys that most vehicles set, each with its unit and default."
    parser.add_argument("--all", action="store_true", help="print every key with its unit, range and default")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    print((DEFAULT_TOML if args.all else START_TOML).read_text(encoding="utf-8"), end="")
    return 0
