"""The rows of the bench, the page of them in Markdown, the file, and the name of the machine."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numkong
import numpy as np

from sim.bench.timing import Clock, Times, digits, race, thread_ns

Run = Callable[[], object]


@dataclass(frozen=True)
class Row:
    """One stage. floor: what takes as long as the bytes and products that no way saves. rival: another way.

    most: how many times its floor it should take at most, or its rival where it has no floor.
    """

    stage: str
    size: str
    times: Times
    floor: Times | None = None
    rival: str = ""
    rival_times: Times | None = None
    most: float | None = None

    @property
    def is_missed(self) -> bool:
        """It takes longer than it should."""
        beside = self.floor or self.rival_times
        return self.most is not None and beside is not None and self.times.ratio(beside) > self.most


def raced(
    stage: str,
    size: str,
    rounds: int,
    ours: Run,
    *,
    floor: Run | None = None,
    rival: tuple[str, Run] | None = None,
    most: float | None = None,
    clock: Clock = thread_ns,
) -> Row:
    """A row of all that run in turns."""
    racers = {"ours": ours} | ({"floor": floor} if floor else {}) | ({"rival": rival[1]} if rival else {})
    times = race(racers, rounds, clock)
    return Row(stage, size, times["ours"], times.get("floor"), rival[0] if rival else "", times.get("rival"), most)


def page(rows: Sequence[Row], how_run: str, file: str) -> str:
    """The page, with the rows that have an aim; `how_run` is a sentence about the run, `file` has all rows."""
    aimed = [row for row in rows if row.most is not None]
    lines = [
        "# Bench",
        "",
        f"{how_run} Machine: {machine_name()}.",
        "",
        "Medians of one thread's CPU time. A floor is what the bytes of a stage take to be read, and its products to",
        "be multiplied, on the same core. Ratios are medians over runs in turns: above 1, ours is slower. **Bold** is",
        f"over what was aimed for, in brackets ({sum(row.is_missed for row in aimed)} of {len(aimed)} rows)."
        f" [{file}]({file}) has all stages.",
        "",
    ]
    return "\n".join([*lines, table(aimed)]) + "\n"


def table(rows: Sequence[Row]) -> str:
    """In Markdown."""
    head = "| stage | of | ms | of its floor | of its rival | rival |\n|---|---|---|---|---|---|"
    return "\n".join([head, *map(_line, rows)])


def cells(rows: Sequence[Row]) -> Iterator[list[str]]:
    """Of a file, below one of their names; at_most: see `Row.most`."""
    yield ["stage", "of", "ms", "of_its_floor", "of_its_rival", "rival", "at_most"]
    for row in rows:
        most = "" if row.most is None else f"{row.most:g}"
        yield [
            row.stage.strip("*").replace("`", ""),
            row.size,
            digits(row.times.median_ms),
            *_ratios(row),
            row.rival,
            most,
        ]


def _line(row: Row) -> str:
    ratios = _ratios(row)
    if row.most is not None:
        at = 0 if row.floor else 1
        ratios[at] = f"{f'**{ratios[at]}**' if row.is_missed else ratios[at]} ({row.most:g})"
    return f"| {row.stage} | {row.size} | {digits(row.times.median_ms)} | {' | '.join([*ratios, row.rival])} |"


def _ratios(row: Row) -> list[str]:
    return [f"{row.times.ratio(one):.2f}" if one else "" for one in (row.floor, row.rival_times)]


def machine_name() -> str:
    """Processor, cores, memory, system and the versions of the kernels in use."""
    cpu = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith(("model name", "Model")):
            cpu = line.partition(":")[2].strip()
            break
    memory_kb = int(Path("/proc/meminfo").read_text().split()[1])
    cores = len([line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("processor")])
    kernels = [name for name, on in numkong.get_capabilities().items() if on and name != "serial"]
    return (
        f"{cpu}, {cores} cores, {memory_kb / 2**20:.0f} GiB, {platform.system()} {platform.machine()}, Python"
        f" {platform.python_version()}, NumPy {np.__version__}, ONNX Runtime {version('onnxruntime')}, numkong for"
        f" {', '.join(kernels) or 'any processor'}"
    )
