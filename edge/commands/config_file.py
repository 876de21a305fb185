"""`lookback config`: print a config file to start from, or with every key."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import msgspec
import tomli_w

from edge.config import DEFAULT_TOML, SHIPPED, START_TOML, Section, plugin_points, section_kind
from edge.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback config`."""
    parser.description = "Prints a config file with the keys that most vehicles set, each with its unit and default."
    parser.add_argument("--all", action="store_true", help="print every key with its unit, range and default")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    print((DEFAULT_TOML if args.all else START_TOML).read_text(encoding="utf-8"), end="")
    for name, points in plugin_points().items() if args.all else ():
        if name not in SHIPPED:
            try:
                print("", *_lines(name, section_kind(name, points)), sep="\n")
            except ConfigError as error:
                print(f"\n# {error}")
    return 0


def _lines(name: str, kind: type[Section]) -> Iterator[str]:
    """The section of another package's plug-in: its keys at their defaults, and what it is."""
    about = " ".join((kind.__doc__ or "").split())
    yield f"[{name}]  # {about}" if about else f"[{name}]"
    for field in msgspec.structs.fields(kind):
        if field.required:
            yield f"# {field.encode_name} =   # without a default"
            continue
        default = field.default_factory() if field.default is msgspec.NODEFAULT else field.default
        if default is not msgspec.UNSET:
            yield tomli_w.dumps({field.encode_name: msgspec.to_builtins(default)}).rstrip()
