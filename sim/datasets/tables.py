"""Text files that data sets come with: CSV with named columns, and lines of numbers."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError


@dataclass(frozen=True)
class TableRecord:
    """One line of a CSV file, and where it stands."""

    where: str
    values: Mapping[str, str]

    def number(self, column: str) -> float:
        """A finite number; FeedError names the line and the column."""
        try:
            value = float(self.values[column])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise FeedError(f"{self.where}: {column}: {self.values[column]!r} is not a number")
        return value

    def integer(self, column: str) -> int:
        """A whole number; FeedError names the line and the column."""
        try:
            return int(self.values[column])
        except ValueError:
            raise FeedError(f"{self.where}: {column}: {self.values[column]!r} is not a whole number") from None

    def number_if_there(self, column: str) -> float:
        """A finite number, NaN if the file has no such column."""
        return self.number(column) if column in self.values else math.nan


def parse_time_ns(text: str, what: str = "time") -> int:
    """Nanoseconds since 1970 of an ISO 8601 time, in UTC unless it says otherwise. FeedError names `what` it is of."""
    try:
        # Python 3.10 does not know the Z.
        moment = datetime.fromisoformat(text[:-1] + "+00:00" if text.endswith(("Z", "z")) else text)
    except ValueError:
        raise FeedError(f"{what}: {text!r} is not a time such as 2026-05-04T12:30:00Z") from None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)
    return round(moment.timestamp() * 1e6) * 1000


def read_text(file: Path, hint: str) -> str:
    """A text file; FeedError with a hint where to get it if it is not there."""
    try:
        return file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FeedError(f"{file}: cannot read it: {error.strerror}; {hint}") from None
    except UnicodeDecodeError:
        raise FeedError(f"{file}: not UTF-8 text") from None


def read_records(file: Path, columns: Sequence[str], hint: str) -> list[TableRecord]:
    """The lines of a CSV file that has at least these columns; FeedError names the file, the line or the column."""
    reader = csv.DictReader(read_text(file, hint).splitlines(), skipinitialspace=True)
    missing = [column for column in columns if column not in (reader.fieldnames or ())]
    if missing:
        raise FeedError(f"{file}: no column {missing[0]} in its first line")
    records = []
    for values in reader:
        where = f"{file}: line {reader.line_num}"
        if None in values or None in values.values():
            raise FeedError(f"{where}: not as many values as the first line has columns")
        records.append(TableRecord(where, values))
    if not records:
        raise FeedError(f"{file}: nothing in it but its first line")
    return records


def read_numbers(file: Path, width: int, hint: str) -> NDArray[np.float64]:
    """Lines of `width` numbers each, between white space, (N, width) float64. FeedError names the line."""
    rows: list[list[float]] = []
    for line, text in enumerate(read_text(file, hint).splitlines(), start=1):
        if not text.strip():
            continue
        try:
            row = [float(value) for value in text.split()]
        except ValueError:
            row = []
        if len(row) != width or not all(map(math.isfinite, row)):
            raise FeedError(f"{file}: line {line}: not {width} number{'s' * (width > 1)}: {text.strip()[:40]!r}")
        rows.append(row)
    if not rows:
        raise FeedError(f"{file}: empty")
    return np.array(rows, dtype=np.float64)
