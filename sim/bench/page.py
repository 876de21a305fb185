"""The bench as one page of Markdown: the machine, the targets, and a table for each stage."""

from __future__ import annotations

from collections.abc import Sequence

from sim.bench.machine import Machine
from sim.bench.rows import Row, Section, Target

MET = {True: "met", False: "**not met**", None: "not measured"}


def page(machine: Machine, sections: Sequence[Section], told: str) -> str:
    """All of it; `told` says how it was run."""
    lines = [
        "# Bench",
        "",
        told,
        "",
        f"Machine: {machine.name}.",
        f"One core of it reads memory at {machine.bytes_per_ms / 1e6:.1f} GB/s and multiplies int8 in cache at"
        f" {machine.macs_per_ms / 1e6:.0f} G multiply-accumulates a second; both were measured in this run. A floor is"
        " what a stage's bytes and products take at these rates.",
        "",
        "Each row was run in turns with what it is held against, in one process and on one thread. Times are least /"
        " median / most, in milliseconds of that thread's CPU time unless a row says otherwise. A ratio is the median"
        " of the ratios of runs that followed each other; over 1 means slower than what stands beside it.",
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
