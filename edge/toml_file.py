"""TOML files as typed records; every error is one line that names the file and the key."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from edge.errors import ConfigError, SetupError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Record = TypeVar("Record", bound=msgspec.Struct)


def read_toml(path: Path, kind: type[Record], error: type[SetupError] = ConfigError) -> Record:
    """The file as a record of that kind; `error` where it cannot be read or is not one."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as failure:
        raise error(f"{path}: cannot read it: {failure.strerror}") from None
    except UnicodeDecodeError:
        raise error(f"{path}: not UTF-8 text") from None
    return parse_toml(text, path, kind, error)


def parse_toml(text: str, path: Path, kind: type[Record], error: type[SetupError] = ConfigError) -> Record:
    """The text of a file as a record of that kind; `path` is for the errors."""
    values: dict[str, Any] = {}
    try:
        values = tomllib.loads(text)
        return msgspec.convert(values, kind)
    except tomllib.TOMLDecodeError as failure:
        raise error(f"{path}: not TOML: {failure}") from None
    except msgspec.ValidationError as failure:
        raise error(f"{path}: {explain(str(failure), values)}") from None


def explain(message: str, values: dict[str, Any]) -> str:
    """Turn msgspec's "Expected `int` - at `$.camera.fps`" into "[camera] fps: expected `int`".

    values: the whole file, to distinguish sections from keys.
    """
    what, _, where = message.partition(" - at `$")
    unknown = re.fullmatch(r"Object contains unknown field `(.*)`", what)
    what = what[:1].lower() + what[1:]
    section, _, key = where.strip(".`").partition(".")
    if unknown:
        is_section = not section and isinstance(values.get(unknown[1]), dict)
        what = f"unknown {'section' if is_section else 'key'} `{unknown[1]}`"
    if not section:
        return what
    if isinstance(values.get(section), dict):
        return f"[{section}] {key}: {what}" if key else f"[{section}] {what}"
    if unknown or (not key and what.startswith("expected `object`")):
        return f"[{section}] {what}"
    return f"{section}{'.' if key else ''}{key}: {what}"
