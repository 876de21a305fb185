"""Races: several functions in turns (A B C A B C), so that whatever else the machine does hits all of them alike.

Times are CPU times of the calling thread, which is the only one that works: a process that takes the core away for a
while does not count. Where the disk matters, wall-clock time is asked for.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Clock = Callable[[], int]
thread_ns: Clock = time.thread_time_ns
wall_ns: Clock = time.perf_counter_ns


@dataclass(frozen=True)
class Times:
    """Milliseconds of the runs of one racer, in their order."""

    runs_ms: tuple[float, ...]

    @property
    def median_ms(self) -> float:
        """The run that as many were faster than as were slower."""
        return statistics.median(self.runs_ms)

    @property
    def least_ms(self) -> float:
        """The fastest run."""
        return min(self.runs_ms)

    def __str__(self) -> str:
        """Least, median and most."""
        return f"{_digits(self.least_ms)} / {_digits(self.median_ms)} / {_digits(max(self.runs_ms))}"

    def ratio(self, to: Times) -> float:
        """Median of the ratios of runs that followed each other."""
        return statistics.median(ours / theirs for ours, theirs in zip(self.runs_ms, to.runs_ms, strict=True))


def race(racers: Mapping[str, Callable[[], object]], rounds: int, clock: Clock = thread_ns) -> dict[str, Times]:
    """Run every racer once to warm up, then all in turns `rounds` times."""
    for racer in racers.values():
        racer()
    runs: dict[str, list[float]] = {name: [] for name in racers}
    for _ in range(rounds):
        for name, racer in racers.items():
            start = clock()
            racer()
            runs[name].append((clock() - start) / 1e6)
    return {name: Times(tuple(times)) for name, times in runs.items()}


def _digits(value_ms: float) -> str:
    """Three digits that count."""
    return f"{value_ms:.0f}" if value_ms >= 100 else f"{value_ms:#.3g}"
