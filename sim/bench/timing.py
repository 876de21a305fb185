"""Several functions run alternately (A B C A B C), so that other load on the machine affects all of them alike.

timeit and pytest-benchmark run all rounds of one function before the next, which gives no paired ratios. Times are CPU
times of the calling thread, so other processes do not count; wall-clock time where the disk matters.
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
        """Median of the runs."""
        return statistics.median(self.runs_ms)

    def ratio(self, to: Times) -> float:
        """Median of the ratios of consecutive runs."""
        return statistics.median(ours / theirs for ours, theirs in zip(self.runs_ms, to.runs_ms, strict=True))


def time_ms(racer: Callable[[], object], clock: Clock = thread_ns) -> float:
    """Run a function once: milliseconds."""
    start_ns = clock()
    racer()
    return (clock() - start_ns) / 1e6


def race(racers: Mapping[str, Callable[[], object]], rounds: int, clock: Clock = thread_ns) -> dict[str, Times]:
    """Run every function once to warm up, then all of them alternately, `rounds` times."""
    for racer in racers.values():
        racer()
    runs: dict[str, list[float]] = {name: [] for name in racers}
    for _ in range(rounds):
        for name, racer in racers.items():
            runs[name].append(time_ms(racer, clock))
    return {name: Times(tuple(times)) for name, times in runs.items()}


def digits(value_ms: float) -> str:
    """Three significant digits."""
    return f"{value_ms:.0f}" if value_ms >= 100 else f"{value_ms:#.3g}"
