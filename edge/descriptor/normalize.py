"""The normalized set of descriptors (NSD), equation 1: for a whole set, and online for the query.

The map is normalized over its whole set. The query's mean and standard deviation are updated with every frame (section
III-B). By default the ring of recent frames is then normalized again with the newest statistics: most of the online
form's disadvantage comes from the first frames, which were normalized with few data.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.descriptor import NormalizedRows

DEAD_DEVIATION = 1e-4
"""A dimension whose deviation is below this fraction of the mean deviation is dead after ReLU, and is set to 0."""

RENORMALIZE_GROWTH = 0.05
"""The ring is normalized again when the frames behind the statistics have grown by this share: below it the mean
moves by under a twentieth of a deviation, and matching the whole ring again would cost L times a frame."""


def normalize(
    raw: NDArray[np.float32], mean: NDArray[np.float64], deviation: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Equation 1: (raw - mean) / deviation for raw (..., R, D) and statistics (R, D); dead dimensions become 0."""
    sound = deviation > DEAD_DEVIATION * deviation.mean()
    scale = np.divide(1.0, deviation, out=np.zeros_like(deviation), where=sound).astype(np.float32)
    normalized: NDArray[np.float32] = (raw - mean.astype(np.float32)) * scale
    return normalized


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

    @property
    def deviation(self) -> NDArray[np.float64]:
        """Standard deviation (R, D) over the frames so far; 0 everywhere after one frame."""
        return np.sqrt(self._squares / max(self.count, 1))


class OnlineNormalizer:
    """Normalizes the query frame by frame, and keeps the ring of the last `length` raw descriptors to do so."""

    def __init__(self, length: int, *, renormalize_ring: bool, enabled: bool = True) -> None:
        """enabled: if False, raw descriptors are returned unchanged (Raw-fc6 of the paper)."""
        self._length = length
        self._renormalize_ring = renormalize_ring and enabled
        self._enabled = enabled
        self._ring: list[NDArray[np.float32]] = []
        self._normalized: list[NDArray[np.float32]] = []
        self._statistics: RunningStatistics | None = None
        self._count_at_renormalization = 0

    def push(self, raw: NDArray[np.float32]) -> NormalizedRows:
        """Add one raw descriptor (R, D) and return the rows that it changes."""
        self._ring = [*self._ring[1 - self._length :], raw]
        change = self._change(raw)
        self._normalized = list(change.rows) if change.replaces_ring else [*self._normalized, change.rows[0]]
        self._normalized = self._normalized[-self._length :]
        return change

    def skip(self) -> bool:
        """Add a row of NaN for a place without a frame; False if the ring is empty, which needs none.

        The row matches as zeros, and so equally badly with every place.
        """
        if not self._ring:
            return False
        nothing = np.full_like(self._ring[0], np.nan)
        self._ring = [*self._ring[1 - self._length :], nothing]
        self._normalized = [*self._normalized, nothing][-self._length :]
        return True

    def _change(self, raw: NDArray[np.float32]) -> NormalizedRows:
        if not self._enabled:
            return NormalizedRows(raw[np.newaxis], replaces_ring=False)
        if self._statistics is None:
            self._statistics = RunningStatistics(raw.shape)
        statistics = self._statistics
        statistics.update(raw)
        stale = statistics.count > self._count_at_renormalization * (1 + RENORMALIZE_GROWTH)
        if self._renormalize_ring and stale:
            self._count_at_renormalization = statistics.count
            rows = normalize(np.stack(self._ring), statistics.mean, statistics.deviation)
            return NormalizedRows(rows, replaces_ring=True)
        return NormalizedRows(normalize(raw[np.newaxis], statistics.mean, statistics.deviation), replaces_ring=False)

    def rows(self) -> NDArray[np.float32]:
        """The whole ring as it was last normalized, (n, R, D), oldest first."""
        return np.stack(self._normalized)

    @property
    def statistics(self) -> RunningStatistics | None:
        """Of all frames so far; None before the first, and where nothing is normalized."""
        return self._statistics

    def begin_with(self, statistics: RunningStatistics) -> None:
        """Start with the statistics of an earlier run."""
        if self._enabled:
            self._statistics = statistics

    @property
    def is_full(self) -> bool:
        """Whether there are as many frames as a sequence needs."""
        return len(self._ring) == self._length

    def clear_ring(self) -> None:
        """Drop the recent frames (after a gap); the statistics stay."""
        self._ring, self._normalized = [], []
