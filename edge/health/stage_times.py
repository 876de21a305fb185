"""Duration of each stage of a frame: medians over the recent frames."""

from __future__ import annotations

import statistics
import time
from collections import deque
from collections.abc import Callable

RECENT_FRAMES = 1000


class StageTimes:
    """A stopwatch with named laps."""

    def __init__(self, clock_ns: Callable[[], int] = time.perf_counter_ns) -> None:
        self._clock_ns = clock_ns
        self._last_ns = clock_ns()
        self._laps_ns: dict[str, deque[int]] = {}

    def start(self) -> None:
        """Start timing a frame."""
        self._last_ns = self._clock_ns()

    def lap(self, stage: str) -> None:
        """Record the time since the last lap as the duration of a stage."""
        now_ns = self._clock_ns()
        self._laps_ns.setdefault(stage, deque(maxlen=RECENT_FRAMES)).append(now_ns - self._last_ns)
        self._last_ns = now_ns

    def medians_ms(self) -> dict[str, float]:
        """Median milliseconds of each stage, in the order in which they run."""
        return {stage: round(statistics.median(laps) / 1e6, 3) for stage, laps in self._laps_ns.items()}
