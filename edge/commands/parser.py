"""The command line: only the command that is asked for is imported, so that `lookback --help` loads none of them."""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

import edge
from edge.errors import ConfigError
from edge.extras import install_command

COMMANDS = {
    "run": "edge.commands.run",
    "record": "edge_plugins.recording.command",
    "map": "sim.maps.command",
    "replay": "sim.evaluation.replay",
    "home": "sim.home.command",
    "route": "sim.home.route_command",
    "config": "edge.commands.config_file",
    "doctor": "edge_plugins.doctor.command",
    "bundle": "sim.bundle",
    "calibrate": "sim.calibration.command",
    "compare": "sim.compare.command",
    "completion": "sim.completion",
    "demo": "sim.demo.command",
    "eval": "sim.evaluation.command",
    "export": "sim.datasets.export",
    "import": "sim.datasets.commands",
    "model": "sim.model_tools.command",
    "shadow": "sim.shadow.command",
    "try": "sim.first_try.command",
    "where": "sim.evaluation.where_command",
}
"""Module of each command, with its `add_arguments`; entry points `lookback.commands` of other packages name further
ones. Names only: edge imports nothing of sim."""
DEV_COMMANDS = {
    "bench": "sim.bench.board",
    "drive": "sim.trial.drive_command",
    "flights": "sim.research.trial.flights_command",
    "mcap": "sim.datasets.mcap_file",
    "noises": "sim.research.trial.noises_command",
    "sim": "sim.commands",
}
"""The same, below `lookback dev`."""
RESEARCH = "sim.research"
ONLY_IN_A_CLONE = "only in a clone of the repository, not in the package"
DEV = "dev"
MOVED = {
    "check --default": "config --all",
    "doctor --default": "config --all",
    "check": "doctor --offline",
    "sim import": "import",
    "dev model": "model",
    "sim flights": "dev flights",
    **dict.fromkeys((f"{DEV} paper", "eval match", "eval networks", "eval run"), "compare"),
    **{name: f"{DEV} {name}" for name in ("bench", "mcap", "sim")},
    **dict.fromkeys(("golden", "dev golden"), "replay"),  # whose output is the same, byte for byte
}
"""Commands of earlier versions, and what they are now."""
GONE = {
    **dict.fromkeys(("train", "dev train"), "the source of version 0.3.0 has it"),
    "dev ablate": "its questions are answered; the source of version 0.3.0 has it",
    "dev alexnet": "the source at commit 386c0d62 has it; `lookback model import` takes an ONNX file",
    **dict.fromkeys(("dev gps", "sim gps"), "`lookback dev sim fixes --case D` drives wrong GPS through the daemon"),
    "import nsavp": "write its pictures and a CSV file for `import pictures`, docs/evaluation.md",
    "map merge": "copy the maps of both folders into one, docs/mapping.md",
    **dict.fromkeys(("map delta", "map apply"), "copy what is new with rsync, docs/fleet.md"),
}
"""Commands of earlier versions that are none any more, and what one does instead."""


def moved(words: Sequence[str]) -> str | None:
    """Where a command of an older version went, as one line; None for any other."""
    for length in (2, 1):
        old = " ".join(words[:length])
        if old in MOVED:
            return f"`lookback {old}` is now `lookback {MOVED[old]}`"
        if old in GONE:
            return f"`lookback {old}` is gone: {GONE[old]}"
    return None


FIRST = {
    "demo": "watch the main task in simulation, a minute, no hardware",
    "try out.mp4 home.mp4": "is the road of one recording recognized in another?",
    "import out.mp4 -o out": "your video, pictures, ROS bag: what is understood of them",
    "config": "the settings that most vehicles need",
    "run lookback.toml": "recognize places live",
}
"""The commands with which one begins, each with an example."""


def beginning() -> str:
    """What `lookback` alone says."""
    width = max(map(len, FIRST))
    lines = [f"  lookback {words:<{width}}  {about}" for words, about in FIRST.items()]
    return "\n".join([edge.__doc__.splitlines()[0], "", *lines, "", "All commands: lookback --help"])


class _Commands(argparse._SubParsersAction):  # type: ignore[type-arg]  # generic for type checkers alone
    """Commands whose own help begins with the sentence that the list of all has, where they have no longer one."""

    def add_parser(self, name: str, **options: Any) -> Any:
        """As argparse has it."""
        about = str(options.get("help") or "").replace("%%", "%")
        options.setdefault("description", f"{about[:1].upper()}{about[1:]}." if about else None)
        return super().add_parser(name, **options)


class _Parser(argparse.ArgumentParser):
    """Names the nearest command where one is mistyped, instead of all of them."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.register("action", "parsers", _Commands)

    def error(self, message: str) -> NoReturn:
        """As ArgumentParser has it."""
        wrong = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message)
        if wrong:
            near = get_close_matches(wrong[1], re.findall(r"[\w-]+", wrong[2]), n=1)
            hint = f"did you mean `{near[0]}`?" if near else f"see `{self.prog} --help`"
            if re.match(r"argument (COMMAND|\{)", message):
                message = f"{wrong[1]!r} is none of its commands"
            message = f"{message}; {hint}"
        super().error(message)


def build_parser(words: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """The parser of a command line; each leaf sets `run`, a function of the arguments.

    words: the command line, of which the first that is no option names the command. Of all others only the names and
    the lines of help are known. None: every command, with all that it imports.
    """
    parser = _Parser(prog="lookback", description=edge.__doc__.splitlines()[0])
    parser.add_argument("--version", action="version", version=f"lookback {edge.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    asked = None if words is None else [word for word in words if not word.startswith("-")]
    plug_ins = {point.name: point.module for point in entry_points(group="lookback.commands")}
    fill_all(commands, {**COMMANDS, **plug_ins, **COMMANDS}, asked)  # ours first, and none of them replaced
    about = "for work on Lookback itself: simulation, benchmarks, recorded drives"
    dev = commands.add_parser(DEV, help=about, description=about)
    if asked is None or asked[:1] == [DEV]:
        fill_all(dev.add_subparsers(required=True, metavar="COMMAND"), DEV_COMMANDS, asked and asked[1:])
    return parser


def fill_all(
    commands: argparse._SubParsersAction[Any],
    modules: dict[str, str],
    asked: Sequence[str] | None = None,
) -> None:
    """Add the command that `asked` begins with, or all for None; of each other one only what it is for."""
    for name, module in modules.items():
        if asked is None or asked[:1] == [name]:
            _fill(name, module, commands)
        else:
            commands.add_parser(name, help=_about(module))


def _fill(name: str, module: str, commands: argparse._SubParsersAction[Any]) -> None:
    """Add one command; one whose packages are not installed here must not take the others down with it."""
    try:
        add_arguments: Callable[[argparse.ArgumentParser], None] = import_module(module).add_arguments
    except ModuleNotFoundError as error:
        missing = error.name or ""
        needs = f"needs the package {missing}: {install_command('sim')}"
        if missing.startswith(RESEARCH):
            needs = ONLY_IN_A_CLONE

        def refuse(args: argparse.Namespace) -> int:
            raise ConfigError(f"{name}: {needs}")

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
    if not file.exists():
        return ONLY_IN_A_CLONE
    docstring = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0].partition(": ")[2].rstrip(".").replace("%", "%%")
