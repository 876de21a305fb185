"""One HTML page that needs nothing beside it, and its tables as CSV and its figures as PNG."""

from __future__ import annotations

import base64
import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import jinja2
import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from edge.errors import ConfigError
from sim.output import refusing

TEMPLATE = Path(__file__).with_name("report.html.j2")


def write_report(
    folder: Path, title: str, about: Mapping[str, str], sections: Sequence[ReportSection], lead: Sequence[str] = ()
) -> Path:
    """Write report.html, NAME.csv and NAME.png into `folder` and return the page's path. ConfigError if it cannot."""
    page = folder / "report.html"
    with refusing(ConfigError, f"{folder}: cannot write the report"):
        folder.mkdir(parents=True, exist_ok=True)
        for section in sections:
            _write_files(folder, section)
        page.write_text(render_page(title, about, sections, lead), encoding="utf-8")
    return page


def render_page(
    title: str, about: Mapping[str, str], sections: Sequence[ReportSection], lead: Sequence[str] = ()
) -> str:
    """The page with its pictures inside. lead: lines under the title; about: terms at the end (versions, hashes)."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters.update(data=lambda data: base64.b64encode(data).decode(), cell=format_cell, words=as_words)
    environment.tests["number"] = lambda cell: not isinstance(cell, str)
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(title=title, about=about, sections=sections, lead=lead)


def as_words(text: str) -> Markup:
    """Text with what stands between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def format_cell(cell: Cell, column: str = "") -> str:
    """A cell as people read it: meters to a tenth, shares to a thousandth."""
    if isinstance(cell, Interval):
        value, low, high = (format_cell(one, column) for one in (cell.value, cell.low, cell.high))
        return f"{value} ({low} to {high})"
    if isinstance(cell, ScoreGroup):
        return ", ".join(f"{one:.2f}" for one in cell.parts.values())
    if isinstance(cell, float):
        return "–" if math.isnan(cell) else f"{cell:.{1 if column.endswith(', m') else 3}f}"
    return str(cell)


def as_markdown(table: Table) -> str:
    """The table as the docs have it."""

    def cells(row: Sequence[Cell]) -> str:
        known = (isinstance(cell, float) and not math.isnan(cell) for cell in row)
        shown = (f"{cell:.2f}" if is_known else format_cell(cell) for cell, is_known in zip(row, known, strict=True))
        return "| " + " | ".join(shown) + " |"

    return "\n".join([cells(table.columns), "|" + "---|" * len(table.columns), *map(cells, table.rows)])


LATEX = str.maketrans(
    {letter: f"\\{letter}" for letter in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "–": "--"}
)


def as_latex(table: Table) -> str:
    """The table for a paper, by the package booktabs."""

    def cells(row: Sequence[Cell]) -> str:
        return " & ".join(format_cell(cell).translate(LATEX) for cell in row) + r" \\"

    sides = "".join("l" if isinstance(cell, str) else "r" for cell in table.rows[0])
    lines = [rf"\begin{{tabular}}{{{sides}}}", r"\toprule", cells(table.columns), r"\midrule"]
    return "\n".join([*lines, *map(cells, table.rows), r"\bottomrule", r"\end{tabular}"])


def _write_files(folder: Path, section: ReportSection) -> None:
    for table in (*section.tables, *section.files):
        with (folder / f"{table.name}.csv").open("w", newline="", encoding="utf-8") as stream:
            csv.writer(stream, lineterminator="\n").writerows(_of_single_numbers(table))
    for figure in section.figures:
        (folder / f"{figure.name}.png").write_bytes(figure.png)


def _of_single_numbers(table: Table) -> Iterator[list[str | int | float]]:
    """The names of the columns and the rows, with a column for each number of an interval or of several."""
    kinds: list[dict[str, str | int | float]]
    kinds = [{part: "" for cell in column for part in _parts(cell)} for column in zip(*table.rows, strict=True)]
    kinds = kinds or [{"": ""} for _ in table.columns]
    yield [f"{name} {part}".strip() for name, parts in zip(table.columns, kinds, strict=True) for part in parts]
    for row in table.rows:
        cells = zip(row, kinds, strict=True)
        yield [one for cell, parts in cells for one in (parts | _parts(cell)).values()]


def _parts(cell: Cell) -> dict[str, str | int | float]:
    if isinstance(cell, Interval):
        return {"": cell.value, "low": cell.low, "high": cell.high}
    return {**cell.parts} if isinstance(cell, ScoreGroup) else {"": cell}


@dataclass(frozen=True)
class Interval:
    """A score on the traverse as driven, and the percentile interval of its resamples at `level`."""

    value: float
    low: float
    high: float
    level: float


@dataclass(frozen=True)
class ScoreGroup:
    """Scores in one cell, by what each of them is."""

    parts: dict[str, float]


Cell = str | int | float | Interval | ScoreGroup


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

    @classmethod
    def of(cls, image: NDArray[np.uint8], caption: str) -> Picture:
        """Of an image (H, W, 3) uint8 BGR."""
        return cls(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes(), caption)


@dataclass(frozen=True)
class ReportSection:
    """One experiment: heading, plain words, tables, figures, and rows of pictures that belong together.

    film: MP4. folded: shown when it is clicked. files: tables that are CSV files alone.
    """

    title: str
    text: str = ""
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    pictures: Sequence[Sequence[Picture]] = field(default_factory=list)
    film: bytes = b""
    film_words: str = ""
    folded: bool = False
    files: Sequence[Table] = ()
