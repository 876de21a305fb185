"""The command `lookback`: one module a sub-command, see `edge.commands.parser`.

Exit codes: 0 done, 1 a device or link is lost, a disk is full, or a check failed, 2 wrong usage, 78 bad configuration,
map, model or feed (a restart would not help).
"""

from __future__ import annotations

import signal

# Ctrl-C ends the process at once while modules are still being imported: their traceback would say nothing.
IS_CAUGHT = signal.getsignal(signal.SIGINT) is signal.default_int_handler
if IS_CAUGHT:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import logging
import os
import sys
import threading
from collections.abc import Sequence
from typing import Any, NoReturn, TextIO, cast

from edge.commands.parser import beginning, build_parser, moved
from edge.errors import EXIT_SETUP, ConfigError, LookbackError, SetupError, one_line, reason

INTERRUPTED = 130
LEVELS = ("debug", "info", "warning", "error")


class PlainText:
    """A text stream in which control characters are spelled out: a name in a map must not move a terminal's cursor."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """As TextIO has it, with escapes that JSON knows as well."""
        return self._stream.write(
            "".join(one if one.isprintable() or one in "\n\r\t" else _spelled(one) for one in text)
        )

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class AboveBars(logging.StreamHandler):  # type: ignore[type-arg]  # generic from Python 3.11 on
    """Writes each line above the bars that tqdm draws, if there are any."""

    def emit(self, record: logging.LogRecord) -> None:
        """As StreamHandler has it."""
        tqdm = getattr(sys.modules.get("tqdm"), "tqdm", None)
        if tqdm is None or not getattr(tqdm, "_instances", None):
            super().emit(record)
        else:
            tqdm.write(self.format(record), file=self.stream)


class OneLine(logging.Formatter):
    """A message is one line, whatever names are in it; the lines of a traceback stay."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the name that logging calls
        """As Formatter has it."""
        return one_line(super().formatMessage(record))


def _spelled(character: str) -> str:
    return f"\\u{ord(character):04x}" if ord(character) <= 0xFFFF else "?"


def _at_home(word: str) -> str:
    """An option's ~ as the home folder: a shell leaves it as it is in --map=~/street."""
    option, equals, path = word.partition("=")
    return f"{option}={os.path.expanduser(path)}" if equals and option.startswith("--") else word  # noqa: PTH111  # never raises


def _open_log() -> None:
    """Log to standard error, from the level on that LOOKBACK_LOG names."""
    level = os.environ.get("LOOKBACK_LOG", "info")
    if level not in LEVELS:
        raise ConfigError(f"LOOKBACK_LOG={level}: expected {', '.join(LEVELS)}")
    handler = AboveBars(sys.stderr)
    handler.setFormatter(OneLine("lookback: %(message)s"))
    logging.basicConfig(level=level.upper(), handlers=[handler])


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; errors that Lookback raises on purpose become one line on standard error."""
    try:
        words = [_at_home(word) for word in (sys.argv[1:] if argv is None else argv)]
        if there := moved(words):
            print(f"lookback: {there}", file=sys.stderr)
            return 2
        _open_log()
        if not words:
            print(beginning())
        args = build_parser(words).parse_args(words) if words else None
        return int(args.run(args)) if args else 0
    except LookbackError as error:
        print(f"lookback: {error}", file=sys.stderr)
        return EXIT_SETUP if isinstance(error, SetupError) else 1
    except BrokenPipeError:
        # The reader of our output went away (`| head`); the interpreter must not try to flush to it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:  # of a path on the command line, or of a full disk
        where = f"{error.filename}: " if error.filename else ""
        print(f"lookback: {where}{reason(error)}", file=sys.stderr)
        logging.debug("where it came from", exc_info=True)
        return EXIT_SETUP if isinstance(error, PermissionError) else 1
    except KeyboardInterrupt:
        return INTERRUPTED


def _flushed(code: str | int | None) -> str | int | None:
    """Write what is still buffered; the exit code, 1 where standard output cannot take it.

    The interpreter would try again at its end, print what it raises, and end with 120.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            if stream is sys.stdout:
                code = code or 1
                if not isinstance(error, BrokenPipeError):
                    print(f"lookback: {reason(error)}", file=sys.stderr)
    return code


def command() -> NoReturn:
    """`main`, and the end of the process.

    While it finalizes, the interpreter ends threads that still run in a driver or in the network by unwinding their C++
    code, which may abort the process. So where there are any, the process ends at once, when all is written. The thread
    of a progress bar is none of those, and what the bar leaves behind is a warning on Python 3.14.
    """
    sys.stdout, sys.stderr = (cast("TextIO", PlainText(one)) for one in (sys.stdout, sys.stderr))
    code: str | int | None
    try:
        code = main()
    except SystemExit as stop:
        code = stop.code
    hanging = [one for one in threading.enumerate() if one.daemon and not type(one).__module__.startswith("tqdm.")]
    code = _flushed(code)
    if isinstance(code, int) and (hanging or code == INTERRUPTED):  # a library may be half loaded, or half closed
        logging.shutdown()
        os._exit(code)
    sys.exit(code)


if IS_CAUGHT:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if __name__ == "__main__":
    command()
