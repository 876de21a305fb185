"""The normalized set of descriptors (NSD), equation 1: for a whole set, and online for the query.

The map is normalized over its whole set. The query's mean and deviation are updated with every frame (section
III-B). By default the rows of the ring whose statistics have become stale are normalized again, a few with each
frame: nearly all that the online form loses against the whole set is its first frames, which were normalized with
hardly any data.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

DEAD_DEVIATION = 1e-4
"""A dimension whose deviation is below this fraction of the mean deviation is dead after ReLU, and is set to 0."""

STALE_GROWTH = 0.05
"""A row of the ring is stale when the frames behind the statistics have grown by this share since it was normalized:
below it the mean moves by under a twentieth of a deviation."""
RENEWED_AT_ONCE, RENEWED_EVERY = 5, 3
"""How many stale rows are normalized again together, and after how many frames at the earliest. Matching six rows
takes twice as long as matching one, a ring of forty eight times: so one frame in three takes about 1.4 times as long as
the others, with 10,000 places. With three rows 2 of 5 simulated drives home at night stayed on their lane; with five,
18 of 20 did."""


class RunningStatistics:
    """Mean and deviation of every dimension so far, updated a frame at a time (Welford), in float64."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.count = 0
        self.mean = np.zeros(shape)
        self._squares = np.zeros(shape)

    @classmethod
    def of_another_run(
        cls, count: int, mean: NDArray[np.float64], deviation: NDArray[np.float64], *, at_most: int
    ) -> RunningStatistics:
        """Statistics (R, D) of `count` frames of another run, with the weight of at most `at_most` frames."""
        statistics = cls((mean.shape[0], mean.shape[1]))
        statistics.count = min(count, at_most)
        statistics.mean = mean.copy()
        statistics._squares = deviation**2 * statistics.count
        return statistics

    def update(self, raw: NDArray[np.float32]) -> None:
        """Add one raw descriptor (R, D)."""
        self.count += 1
        difference = raw - self.mean
        self.mean += difference / self.count
        self._squares += difference * (raw - self.mean)

    def update_all(self, raw: NDArray[np.float32]) -> None:
        """Add raw descriptors (n, R, D) at once (Chan et al.)."""
        if not len(raw):
            return
        mean = raw.mean(axis=0, dtype=np.float64)
        difference, count = mean - self.mean, self.count + len(raw)
        self._squares += np.square(raw - mean).sum(axis=0) + difference**2 * (self.count * len(raw) / count)
        self.mean += difference * (len(raw) / count)
        self.count = count

    @property
    def deviation(self) -> NDArray[np.float64]:
        """Standard deviation (R, D) over the frames so far; 0 everywhere after one frame."""
        return np.sqrt(self._squares / max(self.count, 1))


def normalize(
    raw: NDArray[np.float32], mean: NDArray[np.float64], deviation: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Equation 1: (raw - mean) / deviation for raw (..., R, D) and statistics (R, D); dead dimensions become 0."""
    sound = deviation > DEAD_DEVIATION * deviation.mean()
    scale = np.divide(1.0, deviation, out=np.zeros_like(deviation), where=sound).astype(np.float32)
    normalized: NDArray[np.float32] = (raw - mean.astype(np.float32)) * scale
    return normalized


@dataclass(frozen=True)
class NormalizedRows:
    """What one frame changes in the ring.

    rows: (n, R, D) float32, normalized. ages: of each row, how many rows came after it. The new frame's comes first,
    with age 0; the others replace rows that are in the ring already.
    """

    rows: NDArray[np.float32]
    ages: tuple[int, ...] = (0,)


@dataclass
class _RingRow:
    """A raw descriptor (R, D), what it is after normalization, and how many frames the statistics then had."""

    raw: NDArray[np.float32]
    normalized: NDArray[np.float32]
    count: float


class OnlineNormalizer:
    """Normalizes the query frame by frame, and keeps the ring of the last `length` raw descriptors to do so."""

    def __init__(self, length: int) -> None:
        self._ring: deque[_RingRow] = deque(maxlen=length)
        self.statistics: RunningStatistics | None = None
        """Of all frames so far; None before the first."""
        self._frames_since_renewal = 0

    def push(self, raw: NDArray[np.float32]) -> NormalizedRows:
        """Add one raw descriptor (R, D); the rows of the ring that change with it."""
        if self.statistics is None:
            self.statistics = RunningStatistics(raw.shape)
        self.statistics.update(raw)
        self._ring.append(_RingRow(raw, raw, 0))
        ages = (0, *self._stale_ages())
        raws = np.stack([self._ring[-1 - age].raw for age in ages])
        rows = normalize(raws, self.statistics.mean, self.statistics.deviation)
        for age, row in zip(ages, rows, strict=True):
            self._ring[-1 - age].normalized, self._ring[-1 - age].count = row, self.statistics.count
        return NormalizedRows(rows, ages)

    def normalized(self, raw: NDArray[np.float32]) -> NDArray[np.float32]:
        """One raw descriptor (R, D) by the statistics so far, to which it adds nothing."""
        known = self.statistics
        return raw if known is None else normalize(raw, known.mean, known.deviation)

    def _stale_ages(self) -> list[int]:
        """The ages of the rows that are normalized again now: those whose statistics have grown most since."""
        self._frames_since_renewal += 1
        if self.statistics is None or self._frames_since_renewal < RENEWED_EVERY:
            return []
        limit = self.statistics.count / (1 + STALE_GROWTH)
        stale = [age for age in range(1, len(self._ring)) if self._ring[-1 - age].count < limit]
        if stale:
            self._frames_since_renewal = 0
        return sorted(stale, key=lambda age: self._ring[-1 - age].count)[:RENEWED_AT_ONCE]

    def rows(self, newest: int | None = None) -> NDArray[np.float32]:
        """The ring as it was last normalized, (n, R, D), oldest first; only the newest so many rows of it if given."""
        first = 0 if newest is None else max(0, len(self._ring) - newest)
        return np.stack([row.normalized for row in islice(self._ring, first, None)])

    def begin_with(self, statistics: RunningStatistics) -> None:
        """Start with the statistics of an earlier run."""
        self.statistics = statistics

    @property
    def is_full(self) -> bool:
        """Whether there are as many frames as a sequence needs."""
        return len(self._ring) == self._ring.maxlen

    def clear_ring(self) -> None:
        """Discard the recent frames (after a gap); the statistics stay."""
        self._ring.clear()
