"""The bench as one page of Markdown: rows of what was measured, the targets, and the machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim.bench.timing import Times
from sim.research.bench.machine import Machine


@dataclass(frozen=True)
class Row:
    """One measured stage. against: name of the rival or the floor; ratio: time of this row over the time of that."""

    what: str
    times: Times | None = None
    against: str = ""
    ratio: float | None = None
    note: str = ""


@dataclass(frozen=True)
class Target:
    """One line of the table of targets; met: None where it was not measured."""

    what: str
    wanted: str
    value: str
    met: bool | None


@dataclass(frozen=True)
class Section:
    """A table of the page, and the targets of its rows."""

    title: str
    rows: list[Row]
    targets: list[Target]


def against(what: str, name: str, times: dict[str, Times], rival: str) -> Row:
    """The row of one racer against another."""
    return Row(what, times[name], rival, times[name].ratio(times[rival]))


MET = {True: "met", False: "**not met**", None: "not measured"}


def page(machine: Machine, sections: Sequence[Section], how_run: str) -> str:
    """The whole page; `how_run` is a sentence about the run."""
    lines = [
        "# Bench",
        "",
        how_run,
        "",
        f"Machine: {machine.name}.",
        f"One core of it reads memory at {machine.bytes_per_ms / 1e6:.1f} GB/s and multiplies int8 in cache at"
        f" {machine.macs_per_ms / 1e6:.0f} G multiply-accumulates a second; both were measured in this run. A floor is"
        " the least time that a stage's bytes and products take at these rates; those of a whole frame run after each"
        " frame.",
        "",
        "Each row was run alternately with the one it is compared with, in one process and on one thread. Times are"
        " least / median / most, in milliseconds of that thread's CPU time unless a row says otherwise. A ratio is the"
        " median of the ratios of consecutive runs; over 1 means slower than the row that stands beside it.",
        "",
        "## Targets",
        "",
        "| what | wanted | measured | |",
        "|---|---|---|---|",
        *(_target(target) for section in sections for target in section.targets),
    ]
    for section in sections:
        lines += ["", f"## {section.title}", "", "| what | ms | ratio | against | |", "|---|---|---|---|---|"]
        lines += [_row(row) for row in section.rows]
    return "\n".join(lines) + "\n"


def _target(target: Target) -> str:
    return f"| {target.what} | {target.wanted} | {target.value} | {MET[target.met]} |"


def _row(row: Row) -> str:
    ratio = "" if row.ratio is None else f"{row.ratio:#.3g}".rstrip(".")
    return f"| {row.what} | {row.times or ''} | {ratio} | {row.against} | {row.note} |"
