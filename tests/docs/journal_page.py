"""docs/journal.md, made from the records: `python -m tests.docs.journal_page` writes it anew."""

from __future__ import annotations

from collections import Counter
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

`[telemetry] journal` names a file to which the daemon appends one JSON object per line: version {SCHEMA} of the
records. `lookback export` makes maps and tracks of it. In Python, `sim.journal.read_journal` skips lines that
a crash has torn.

- Each line begins with `unix_s`, the time of writing (seconds since 1970, UTC), and `event`, the kind of the record.
  `lookback replay` writes records of kind `frame` without both.
- Readers should ignore keys and records that they do not know: new ones do not change the version.
- Values without a type are strings.
- Stamps are on CLOCK_MONOTONIC of the vehicle's computer: they only increase, and start anew with each boot.

`python -m tests.docs.journal_page` makes this page from [edge/journal/records.py](../edge/journal/records.py).

## Keys of several records
"""


def journal_page() -> str:
    """The whole page: keys that several records share stand once, before the records."""
    kinds = {kind: _rows(kind) for kind in get_args(Record)}
    uses = Counter(row for rows in kinds.values() for row in rows.values())
    shared = [row for row, count in uses.items() if count > 1]
    return HEAD + "\n" + "".join(shared) + "".join(_section(kind, rows, shared) for kind, rows in kinds.items())


def _section(kind: type[msgspec.Struct], rows: dict[str, str], shared: list[str]) -> str:
    text = " ".join((kind.__doc__ or "").split())
    own = [row for row in rows.values() if row not in shared]
    also = ", ".join(f"`{name}`" for name, row in rows.items() if row in shared)
    about = f"{text} Also: {also}." if also else text
    return f"\n## {kind.__struct_config__.tag}\n\n{about}\n" + ("\n" + "".join(own) if own else "")


def _rows(kind: type[msgspec.Struct]) -> dict[str, str]:
    """Key to its line of the list."""
    info = type_info(kind)
    assert isinstance(info, StructType)
    return {field.encode_name: _row(field) for field in info.fields}


def _row(field: Field) -> str:
    meta = _meta(field.type)
    is_left_away = field.default is NODEFAULT and not field.required
    kind = _spell(field.type) + (", or absent" if is_left_away else "")
    kind = ", ".join(filter(None, [kind, meta["unit"]]))
    return f"- `{field.encode_name}`{'' if kind == 'string' else f' ({kind})'}: {meta['about']}\n"


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
