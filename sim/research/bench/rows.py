"""The bench as one page of Markdown: rows of what was measured, the targets, and the machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim.bench.timing import Times, digits
from sim.research.bench.machine import Machine


@dataclass(frozen=True)
class Row:
    """One measured stage. against: name of the rival or the floor; ratio: time of this row over the time of that.

    size: rows of a section that differ in it alone are one line of its table, with a column for each size. The cell has
    the note of a row without times.
    """

    what: str
    times: Times | None = None
    against: str = ""
    ratio: float | None = None
    note: str = ""
    size: str = ""


@dataclass(frozen=True)
class Target:
    """What a measured value should be."""

    what: str
    wanted: str
    value: str
    met: bool


@dataclass(frozen=True)
class Section:
    """A table of the page, and the targets of its rows."""

    title: str
    rows: list[Row]
    targets: list[Target]


def at_most(what: str, wanted: float, ratio: float) -> Target:
    """A ratio that should not be greater."""
    return Target(what, f"{wanted:g}x or less", f"{ratio:.2f}x", ratio <= wanted)


def against(what: str, name: str, times: dict[str, Times], rival: str, size: str = "") -> Row:
    """The row of one racer against another."""
    return Row(what, times[name], rival, times[name].ratio(times[rival]), size=size)


OTHER_PROCESSORS = (
    "On x86-64 the int8 times need VNNI (AVX-512 VNNI or AVX-VNNI). With AVX2 only, the int8 network is 1.44 times as"
    " fast as in float32, and nothing else was measured. No time on aarch64 has been measured"
    " ([boards.md](boards.md))."
)
"""Which times hold where; the network's without VNNI was measured once, on an x86-64 with AVX2 only."""


def page(machine: Machine, sections: Sequence[Section], how_run: str) -> str:
    """The whole page; `how_run` is a sentence about the run."""
    lines = [
        "# Bench",
        "",
        how_run,
        "",
        f"Machine: {machine.name}.",
        f"A floor is the least time that a stage's bytes and products take at {machine.bytes_per_ms / 1e6:.1f} GB/s and"
        f" {machine.macs_per_ms / 1e6:.0f} G int8 multiply-accumulates a second, as one core reached.",
        "",
        "Times are medians of one thread's CPU time, unless a row says otherwise. A ratio is the median of the ratios"
        " of runs in turns with the row that stands beside it: over 1 is slower.",
        "",
        OTHER_PROCESSORS,
        "",
        _targets([target for section in sections for target in section.targets]),
    ]
    for section in sections:
        lines += ["", f"## {section.title}", ""]
        lines += _table_of_sizes(section.rows) if any(row.size for row in section.rows) else _table(section.rows)
    return "\n".join(lines) + "\n"


def _targets(targets: Sequence[Target]) -> str:
    """How many are met, and a list of those that are not."""
    missed = [f"- {one.what}: {one.value} (wanted: {one.wanted})" for one in targets if not one.met]
    met = f"{len(targets) - len(missed)} of {len(targets)} targets (`sim/research/bench`) are met."
    return "\n".join([f"{met} **Not met:**", "", *missed]) if missed else met


def _table(rows: Sequence[Row]) -> list[str]:
    lines = [f"| {row.what} | {_cell(row)} | {_beside(row)} |" for row in rows]
    return ["| | ms (ratio) | against |", "|---|---|---|", *lines]


def _beside(row: Row) -> str:
    """What the row is compared with, and its note unless that is its cell."""
    return "; ".join(filter(None, [row.against, row.note if row.times else ""]))


def _table_of_sizes(rows: Sequence[Row]) -> list[str]:
    sizes = list(dict.fromkeys(row.size for row in rows))
    lines = ["| ms (ratio) | " + " | ".join(sizes) + " | against |", "|---" * (len(sizes) + 2) + "|"]
    for what, rival in dict.fromkeys((row.what, row.against) for row in rows):
        cells = {row.size: _cell(row) for row in rows if row.what == what}
        lines.append(f"| {what} | " + " | ".join(cells.get(size, "") for size in sizes) + f" | {rival} |")
    return lines


def _cell(row: Row) -> str:
    if row.times is None:
        return row.note
    return digits(row.times.median_ms) + (f" ({row.ratio:#.3g})".replace(".)", ")") if row.ratio is not None else "")
