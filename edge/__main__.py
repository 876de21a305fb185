"""The command `lookback`: one module a sub-command; further ones come as entry points `lookback.commands`.

Exit codes: 0 done, 1 a device or link is lost or a check failed, 2 wrong usage, 78 bad configuration, map, model or
feed (a restart would not help).
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import threading
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from typing import NoReturn

import edge
from edge.commands import completion, doctor, home, map_build, record, replay, run
from edge.errors import EXIT_SETUP, ConfigError, LookbackError, SetupError
from edge.extras import install_command


def build_parser() -> argparse.ArgumentParser:
    """All commands, those of installed plug-ins included; each leaf sets `run`, a function of the arguments."""
    parser = argparse.ArgumentParser(prog="lookback", description=edge.__doc__.splitlines()[0])
    parser.add_argument("--version", action="version", version=f"lookback {edge.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for module in (run, record, map_build, replay, home, doctor):
        module.add_command(commands)
    completion.add_command(commands, parser)
    # By name: an installation from before the distribution was renamed may still be beside this one.
    for _, point in sorted({point.name: point for point in entry_points(group="lookback.commands")}.items()):
        _add_plug_in(point, commands)
    return parser


def _add_plug_in(point: EntryPoint, commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add a plug-in's command; one whose packages are not installed here must not take `run` down with it."""
    try:
        add_command = point.load()
    except ModuleNotFoundError as error:
        missing = error.name

        def refuse(args: argparse.Namespace) -> int:
            raise ConfigError(f"{point.name}: needs the package {missing}: {install_command('sim')}")

        # No option is known here, so a dash means nothing: all words are the missing command's.
        parser = commands.add_parser(
            point.name, help=f"not installed: needs {missing}", prefix_chars="\0", add_help=False
        )
        parser.add_argument("arguments", nargs="*")
        parser.set_defaults(run=refuse)
    else:
        add_command(commands)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; errors that Lookback raises on purpose become one line on standard error."""
    logging.basicConfig(level=logging.INFO, format="lookback: %(message)s", stream=sys.stderr)
    args = build_parser().parse_args(argv)
    try:
        return int(args.run(args))
    except LookbackError as error:
        print(f"lookback: {error}", file=sys.stderr)
        return EXIT_SETUP if isinstance(error, SetupError) else 1
    except PermissionError as error:  # of a path on the command line
        print(f"lookback: {error.filename}: {error.strerror}", file=sys.stderr)
        return EXIT_SETUP
    except BrokenPipeError:
        # The reader of our output went away (`| head`); the interpreter must not try to flush to it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        return 130


def command() -> NoReturn:
    """`main`, and the end of the process.

    While it finalizes, the interpreter ends threads that still run in a driver or in the network by unwinding their C++
    code, which may abort the process. So where there are any, the process ends at once, when all is written.
    """
    code: str | int | None
    try:
        code = main()
    except SystemExit as stop:
        code = stop.code
    if isinstance(code, int) and any(thread.daemon for thread in threading.enumerate()):
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    command()
