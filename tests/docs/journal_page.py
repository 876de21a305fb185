"""docs/journal.md, made from the records: `python -m tests.docs.journal_page` writes it anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import msgspec
from msgspec import NODEFAULT
from msgspec.inspect import (
    BoolType,
    DictType,
    Field,
    FloatType,
    IntType,
    LiteralType,
    Metadata,
    NoneType,
    StrType,
    StructType,
    UnionType,
    type_info,
)

from edge.journal.records import SCHEMA, Record

PAGE = Path(__file__).parents[2] / "docs/journal.md"
NAMES = {IntType: "integer", FloatType: "number", StrType: "string", BoolType: "boolean", DictType: "object"}
HEAD = f"""# The journal

`[telemetry] journal` names a file to which the daemon appends one JSON object per line. Read it with any JSON tool, or
in Python with `edge.journal.journal.read_journal`, which skips lines that a crash has torn and passes on what it does
not know. `lookback export` makes maps and tracks of it.

Each line begins with `unix_s`, the time at which it was written (seconds since 1970, UTC), and `event`, the kind of the
record. This page describes version {SCHEMA} of the records. A new record or key does not change the version, so readers
should ignore what they do not know; the version grows when a key is removed or changes its meaning.

`place` is the row of a place in its map. Where `[map] path` is a folder of maps, `map` is the name of that map. Stamps
are on CLOCK_MONOTONIC of the vehicle's computer: they only increase, and start anew with each boot.

`lookback replay` writes records of kind `frame` without `unix_s` and `event`.

This page is made from [edge/journal/records.py](../edge/journal/records.py) by `python -m tests.docs.journal_page`.
"""


def journal_page() -> str:
    """The whole page."""
    return HEAD + "".join(_section(kind) for kind in get_args(Record))


def _section(kind: type[msgspec.Struct]) -> str:
    info = type_info(kind)
    assert isinstance(info, StructType)
    text = " ".join((kind.__doc__ or "").split())
    rows = [_row(field) for field in info.fields]
    return f"\n## {info.tag}\n\n{text}\n\n| key | type | unit | meaning |\n| --- | --- | --- | --- |\n" + "".join(rows)


def _row(field: Field) -> str:
    meta = _meta(field.type)
    is_left_away = field.default is NODEFAULT and not field.required
    kind = _spell(field.type) + (", or absent" if is_left_away else "")
    return f"| `{field.encode_name}` | {kind} | {meta['unit']} | {meta['about']} |\n"


def _meta(kind: Any) -> dict[str, str]:
    """Unit and meaning, of the type or of the one that stands in a union with null."""
    if isinstance(kind, Metadata):
        return {"unit": (kind.extra or {})["unit"], "about": (kind.extra_json_schema or {})["description"]}
    if isinstance(kind, UnionType):
        return next(_meta(one) for one in kind.types if isinstance(one, Metadata))
    raise ValueError(f"{kind}: a field without its unit")


def _spell(kind: Any) -> str:
    if isinstance(kind, Metadata):
        return _spell(kind.type)
    if isinstance(kind, UnionType):
        return " or ".join(_spell(one) for one in kind.types)
    if isinstance(kind, LiteralType):
        return " or ".join(f'"{value}"' for value in kind.values)
    if isinstance(kind, NoneType):
        return "null"
    names: dict[Any, str] = {**NAMES}
    return names[type(kind)]


if __name__ == "__main__":
    PAGE.write_text(journal_page(), encoding="utf-8")
