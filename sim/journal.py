"""Reads what the daemon's journal, or `lookback replay`, has written."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar, Union

import msgspec

from edge.journal.journal import earlier_files
from edge.journal.records import KINDS, RENAMED, SCHEMA, FrameUsed, JournalOpened, Record, with_todays_keys

GPS_STATES = {
    "agrees": "consistent",
    "doubtful": "suspect",
    "disagrees": "inconsistent",
    "wrong": "faulty",
    "map wrong": "map faulty",
}
"""Values of schema 2 of the journal, as they are called now."""
R = TypeVar("R", bound=Record)


class UnknownRecord(msgspec.Struct, frozen=True):
    """A line that is whole, but no record of this schema; `fields` is all that it says."""

    fields: dict[str, Any]


class JournalLine(NamedTuple):
    """A record, and when it was written: Unix time in seconds, None in the output of `lookback replay`."""

    unix_s: float | None
    record: Record | UnknownRecord


def read_journal(path: Path, *others: type[Record]) -> Iterator[JournalLine]:
    """The records of a journal, with those of its earlier files, or of what `lookback replay` wrote, in order.

    others: kinds to read besides those of edge, of plug-ins. Lines that a crash or a full disk has torn are skipped,
    and keys of schema 2 have the names of today.
    What is of another kind is an `UnknownRecord`: of plug-ins that are not asked for or not installed, of other
    versions, and everything that a run with a newer schema has written.
    """
    known: Any = Union[tuple({*KINDS, *others})]  # noqa: UP007  # as many as there are
    is_known = True
    with ExitStack() as parts:
        for line in itertools.chain.from_iterable(_open_all(path, parts)):
            try:
                fields = _decode_fields(line)
            except (msgspec.DecodeError, UnicodeDecodeError):
                continue
            record = _as_record(fields, known)
            if isinstance(record, JournalOpened):
                is_known = record.schema <= SCHEMA
            elif not is_known:
                record = UnknownRecord(fields)
            yield JournalLine(fields.get("unix_s"), record)


_decode_fields = msgspec.json.Decoder(dict[str, Any]).decode


def _as_record(fields: dict[str, Any], known: Any) -> Record | UnknownRecord:
    # The lines of replay are frames without a tag.
    try:
        record: Record = msgspec.convert(in_todays_words(fields), known if "event" in fields else FrameUsed)
        return record
    except msgspec.ValidationError:
        return UnknownRecord(fields)


def in_todays_words(fields: dict[str, Any]) -> dict[str, Any]:
    """The keys and words of a record of schema 2 as those of today; any other as it is."""
    if fields.get("event") == "gps_judged":
        return {**fields, "state": GPS_STATES.get(fields.get("state", ""), fields.get("state"))}
    today: dict[str, Any] = fields if RENAMED.keys().isdisjoint(fields) else with_todays_keys(fields)
    return today


def records_of(path: Path, kind: type[R]) -> Iterator[R]:
    """The records of one kind, in order."""
    return (line.record for line in read_journal(path, kind) if isinstance(line.record, kind))


def _open_all(path: Path, parts: ExitStack) -> list[BinaryIO]:
    """All files of a journal for reading, the oldest first; `parts` closes them.

    PATH is opened first: if it is renamed while the others are opened, it is met again, and not opened twice.
    """
    streams: dict[tuple[int, int], BinaryIO] = {}
    for file in (path, *earlier_files(path)):
        try:
            stream = parts.enter_context(file.open("rb"))
        except FileNotFoundError:
            if file == path and not earlier_files(path):
                raise
            continue  # a crash between two renames, or the oldest file, which was deleted meanwhile
        status = os.fstat(stream.fileno())
        streams.setdefault((status.st_dev, status.st_ino), stream)
    return list(reversed(streams.values()))
