"""`lookback completion`: print a script that lets bash, zsh or tcsh complete commands, options and file names."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from edge.commands.parser import build_parser
from sim.output import needing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback completion`."""
    parser.description = "For bash: lookback completion bash | sudo tee /etc/bash_completion.d/lookback > /dev/null"
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"))
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    with needing("completion", "desk"):
        import shtab
    whole = build_parser()
    _complete_paths(whole, shtab.FILE)
    print(shtab.complete(whole, args.shell))
    return 0


def _complete_paths(parser: argparse.ArgumentParser, complete: Mapping[str, object]) -> None:
    """Let every argument that is a path, of this parser and those below it, be completed as a file."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                _complete_paths(below, complete)
        elif action.type is Path:
            action.complete = complete  # type: ignore[attr-defined]
