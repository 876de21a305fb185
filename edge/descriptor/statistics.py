"""Mean and deviation of raw descriptors, frame by frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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
