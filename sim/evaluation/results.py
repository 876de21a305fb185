"""What an experiment hands to the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from sim.evaluation.bootstrap import Interval

Cell = str | int | float | Interval


@dataclass(frozen=True)
class Table:
    """A table of the report and a CSV file; `name` is the file's, and each row has as many cells as `columns`."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: Sequence[Sequence[Cell]]
    note: str = ""


@dataclass(frozen=True)
class Figure:
    """A picture of the report and a PNG file."""

    name: str
    title: str
    png: bytes
    note: str = ""


@dataclass(frozen=True)
class Picture:
    """One picture of a match: JPEG and what is said under it."""

    jpeg: bytes
    caption: str


@dataclass(frozen=True)
class Section:
    """One experiment: heading, plain words, tables, figures, and rows of pictures that belong together."""

    title: str
    text: str = ""
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    pictures: Sequence[Sequence[Picture]] = field(default_factory=list)
