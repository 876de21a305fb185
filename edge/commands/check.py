"""`lookback check`: check a config file, and the model, maps and keys that it names; `doctor --offline`."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.commands.doctor import diagnose
from edge.config import DEFAULT_TOML


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback check`."""
    parser.description = "The same as `lookback doctor --offline CONFIG`. Exit code 78 if something is wrong."
    parser.add_argument("config", type=Path, nargs="?", metavar="CONFIG", help="config file (TOML)")
    parser.add_argument("--default", action="store_true", help="print the default config, with comments")
    parser.set_defaults(run=_run, json=False, seconds=0.0, offline=True, error=parser.error)


def _run(args: argparse.Namespace) -> int:
    if not args.default:
        return diagnose(args)
    print(DEFAULT_TOML.read_text(encoding="utf-8"), end="")
    return 0
