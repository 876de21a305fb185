"""Confidence intervals of scores: a block bootstrap over the frames of a traverse.

Neighboring frames are nearly the same picture, so that resampling single frames would make every interval too narrow.
Blocks of contiguous frames are drawn instead (circular block bootstrap, Politis and Romano 1992).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim.evaluation.metrics import Answers
from sim.evaluation.report import Interval

Statistic = Callable[[Answers], float]
LEVEL = 0.95


def block_indices(count: int, block: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """`count` indices below `count`, in runs of `block` that start anywhere; after the last comes the first."""
    block = min(block, count)
    starts = rng.integers(0, count, -(-count // block))
    runs = starts[:, np.newaxis] + np.arange(block)
    return np.asarray(runs.ravel()[:count] % count, dtype=np.intp)


def interval(statistic: Statistic, answers: Answers, block: int, resamples: int, seed: int = 0) -> Interval:
    """The interval of one method's score, by resamples of blocks of so many frames."""
    rng, count = np.random.default_rng(seed), len(answers.confidence)
    drawn = np.array([statistic(answers.take(block_indices(count, block, rng))) for _ in range(resamples)])
    drawn = drawn[~np.isnan(drawn)]  # a resample with no query on the map has no recall
    low, high = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) if drawn.size else (np.nan, np.nan)
    return Interval(statistic(answers), float(low), float(high), LEVEL)
