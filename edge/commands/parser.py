"""The command line: only the command that is asked for is imported, so that `lookback --help` loads none of them."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

import edge
from edge.errors import ConfigError
from edge.extras import install_command

COMMANDS = {
    "run": "edge.commands.run",
    "record": "edge.commands.record",
    "map": "edge.commands.map_build",
    "replay": "edge.commands.replay",
    "home": "edge.commands.home",
    "doctor": "edge.commands.doctor",
    "check": "edge.commands.check",
    "completion": "edge.commands.completion",
}
"""Module of each command of a vehicle, with its `add_arguments`; entry points `lookback.commands` name further ones."""


def build_parser(words: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """The parser of a command line; each leaf sets `run`, a function of the arguments.

    words: the command line, of which the first that is no option names the command. Of all others only the names and
    the lines of help are known. None: every command, with all that it imports.
    """
    parser = argparse.ArgumentParser(prog="lookback", description=edge.__doc__.splitlines()[0])
    parser.add_argument("--version", action="version", version=f"lookback {edge.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    # By name: an installation from before the distribution was renamed may still be beside this one.
    plug_ins = {point.name: point.module for point in entry_points(group="lookback.commands")}
    asked = None if words is None else next((word for word in words if not word.startswith("-")), "")
    for name, module in {**COMMANDS, **dict(sorted(plug_ins.items()))}.items():
        if asked is None or asked == name:
            _fill(name, module, commands)
        else:
            commands.add_parser(name, help=_about(module))
    return parser


def _fill(name: str, module: str, commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add one command; one whose packages are not installed here must not take the others down with it."""
    try:
        add_arguments: Callable[[argparse.ArgumentParser], None] = import_module(module).add_arguments
    except ModuleNotFoundError as error:
        missing = error.name

        def refuse(args: argparse.Namespace) -> int:
            raise ConfigError(f"{name}: needs the package {missing}: {install_command('sim')}")

        # No option is known here, so a dash means nothing: all words are the missing command's.
        parser = commands.add_parser(name, help=_about(module), prefix_chars="\0", add_help=False)
        parser.add_argument("arguments", nargs="*")
        parser.set_defaults(run=refuse)
    else:
        add_arguments(commands.add_parser(name, help=_about(module)))


def _about(module: str) -> str:
    """What the first line of a module's docstring says after the command's name, read without importing anything."""
    package, _, rest = module.partition(".")
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        return "not installed"
    file = Path(spec.origin).parent.joinpath(*rest.split(".")).with_suffix(".py") if rest else Path(spec.origin)
    docstring = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0].partition(": ")[2].rstrip(".").replace("%", "%%")
