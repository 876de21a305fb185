"""TOML files as typed records; each mistake is one line that names the file, the key, and what it may be."""

from __future__ import annotations

import copy
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec.inspect import LiteralType, Metadata, StructType, UnionType, type_info

from edge.errors import ConfigError, SetupError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Line = Annotated[str, msgspec.Meta(pattern=r"^[^\n\r\x0b\x0c\x85\u2028\u2029]*\Z")]
"""A text without line breaks, which would forge lines of output."""
Record = TypeVar("Record", bound=msgspec.Struct)
MOST_NESTED = 20
"""Levels of tables and lists in a file; no key of ours is deeper than 4."""
TOO_DEEP = f"tables or lists are nested more than {MOST_NESTED} deep; remove them"
WORDS = {
    "array": "a list",
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "object": "a section",
    "str": "text in quotes",
}
"""msgspec's names of types, for people."""


def read_toml(path: Path, kind: type[Record], error: type[SetupError] = ConfigError) -> Record:
    """The file as a record of that kind; `error` where it cannot be read or is not one."""
    return parse_toml(read_text(path, error), path, kind, error)


def read_text(path: Path, error: type[SetupError] = ConfigError) -> str:
    """The text of a file, without the mark that some editors put before it; `error` where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as failure:
        raise error(f"{path}: cannot read it: {failure.strerror}") from None
    except UnicodeDecodeError:
        raise error(f"{path}: not UTF-8 text") from None


def parse_toml(text: str, path: Path, kind: type[Record], error: type[SetupError] = ConfigError) -> Record:
    """The text of a file as a record of that kind; `path` is for the errors, of which each mistake has a line."""
    return convert_toml(toml_values(text, path, error), path, kind, error)


def toml_values(text: str, path: Path, error: type[SetupError] = ConfigError) -> dict[str, Any]:
    """The text of a file as nested tables."""
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as failure:
        raise error(f"{path}: not TOML: {failure}") from None
    except ValueError:
        raise error(f"{path}: a whole number in it has thousands of digits; correct it") from None
    except RecursionError:
        raise error(f"{path}: {TOO_DEEP}") from None
    if _is_too_deep(values):
        raise error(f"{path}: {TOO_DEEP}")
    return values


def _is_too_deep(values: dict[str, Any]) -> bool:
    """Level by level: a function that calls itself would end in a RecursionError, as what reads the values would."""
    level: list[Any] = [values]
    for _ in range(MOST_NESTED):
        inside = ((one.values() if isinstance(one, dict) else one) for one in level if isinstance(one, dict | list))
        level = [value for values in inside for value in values]
    return bool(level)


def convert_toml(
    values: dict[str, Any], path: Path, kind: type[Record], error: type[SetupError] = ConfigError
) -> Record:
    """Nested tables as a record of that kind."""
    mistakes = list(mistakes_in(values, kind))
    if mistakes:
        raise error(*(f"{path}: {mistake}" for mistake in mistakes))
    return msgspec.convert(values, kind)


def mistakes_in(values: dict[str, Any], kind: type[msgspec.Struct]) -> Iterator[str]:
    """Every mistake in nested tables, each as one line.

    What is missing, and a rule between keys, is only judged where all that is there is right.
    """
    values, is_first = copy.deepcopy(values), True
    while True:
        try:
            msgspec.convert(values, kind)
        except msgspec.ValidationError as failure:
            where, unknown = _place(str(failure))
            is_of_value = bool(unknown) or str(failure).startswith(("Expected `", "Invalid enum value"))
            if is_of_value or is_first:
                yield explain(str(failure), values, kind)
            if not (is_of_value and _remove(values, [*where, unknown] if unknown else where)):
                return
            is_first = False
        else:
            return


def explain(message: str, values: dict[str, Any], kind: type[msgspec.Struct]) -> str:
    """Turn msgspec's "Expected `int` - at `$.camera.fps`" into "[camera] fps: expected a whole number".

    values: the whole file, to distinguish sections from keys. kind: what it should be, to name what is allowed.
    """
    where, unknown = _place(message)
    what = message.partition(" - at `$")[0]
    what = re.sub("`(\\w+)`", lambda word: WORDS.get(word[1], word[1]), what[:1].lower() + what[1:])
    if what.startswith("object missing required field"):
        what = _missing(values, kind, where)
    elif unknown:
        is_section = not where and isinstance(values.get(unknown), dict)
        what = f"unknown {'section' if is_section else 'key'} `{unknown}`"
    elif (wrong := re.fullmatch("invalid enum value '?(.*?)'?", what)) and (allowed := _allowed(kind, where)):
        what = f'"{wrong[1]}" is none of {", ".join(f"{chr(34)}{one}{chr(34)}" for one in allowed)}'
    if not where:
        return what
    section, key = where[0], ".".join(where[1:])
    if isinstance(values.get(section), dict) or (not key and (unknown or what.startswith("expected a section"))):
        return f"[{section}] {key}: {what}" if key else f"[{section}] {what}"
    if unknown:
        return f"[{'.'.join(where)}] {what}"
    return f"{'.'.join(where)}: {what}"


def _missing(values: dict[str, Any], kind: type[msgspec.Struct], where: list[str]) -> str:
    """All required keys that are not in the table at a place, in words."""
    table: Any = values
    for key in where:
        name, *items = key.split("[")
        table = table[name]
        for item in items:
            table = table[int(item.rstrip("]"))]
    needed = [field for field in _type_at(kind, where).fields if field.required]
    names = [f"`{field.encode_name}`" for field in needed if field.encode_name not in table]
    return f"the key {names[0]} is missing" if len(names) == 1 else f"the keys {', '.join(names)} are missing"


def _place(message: str) -> tuple[list[str], str]:
    """Where msgspec found a mistake, as keys from the top, an index being part of its key; and an unknown field."""
    what, _, where = message.partition(" - at `$")
    unknown = re.fullmatch("Object contains unknown field `(.*)`", what)
    return [key for key in where.strip(".`").split(".") if key], unknown[1] if unknown else ""


def _remove(values: dict[str, Any], where: list[str]) -> bool:
    """Remove the value at a place, a list as a whole; False if there is none."""
    table: Any = values
    for key in where:
        name, is_item, _ = key.partition("[")
        if not isinstance(table, dict) or name not in table:
            return False
        if is_item or key == where[-1] or not isinstance(table[name], dict):
            del table[name]
            return True
        table = table[name]
    return False


def _type_at(kind: type[msgspec.Struct], where: list[str]) -> Any:
    """The type of the value at a place, None where nothing is known of it."""
    info: Any = type_info(kind)
    for key in where:
        name, *items = key.split("[")
        info = _fields_of(info).get(name)
        for _ in items:
            info = getattr(info, "item_type", None) or getattr(info, "value_type", None)
    return info.type if isinstance(info, Metadata) else info


def _fields_of(info: Any) -> dict[str, Any]:
    """The fields of a struct, none of what is no struct."""
    for one in info.types if isinstance(info, UnionType) else (info,):
        if isinstance(one, StructType):
            return {field.encode_name: field.type for field in one.fields}
    return {}


def _allowed(kind: type[msgspec.Struct], where: list[str]) -> list[str]:
    """The texts that the value at a place may be, none where it may be any."""
    info = _type_at(kind, where)
    kinds = info.types if isinstance(info, UnionType) else (info,)
    return [str(value) for one in kinds if isinstance(one, LiteralType) for value in one.values]
