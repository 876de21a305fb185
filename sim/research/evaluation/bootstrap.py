"""Confidence intervals of scores: a block bootstrap over the frames of a traverse.

Neighboring frames are nearly the same picture, so that resampling single frames would make every interval too narrow.
Blocks of contiguous frames are drawn instead (circular block bootstrap, Politis and Romano 1992).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.evaluation.metrics import Answers
from sim.evaluation.report import Interval

Statistic = Callable[[Answers], float]


@dataclass(frozen=True)
class Resampling:
    """How to resample: frames a block, how many resamples, the interval's level, and the seed."""

    block: int
    resamples: int = 1000
    level: float = 0.95
    seed: int = 0


def block_indices(count: int, block: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """`count` indices below `count`, in runs of `block` that start anywhere; after the last comes the first."""
    block = min(block, count)
    starts = rng.integers(0, count, -(-count // block))
    runs = starts[:, np.newaxis] + np.arange(block)
    return np.asarray(runs.ravel()[:count] % count, dtype=np.intp)


def interval(statistic: Statistic, answers: Answers, how: Resampling) -> Interval:
    """The interval of one method's score."""
    rng, count = np.random.default_rng(how.seed), len(answers.confidence)
    drawn = np.array([statistic(answers.take(block_indices(count, how.block, rng))) for _ in range(how.resamples)])
    drawn = drawn[~np.isnan(drawn)]  # a resample with no query on the map has no recall
    value = statistic(answers)
    if not drawn.size:
        return Interval(value, float("nan"), float("nan"), how.level)
    tail = (1 - how.level) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail])
    return Interval(value, float(low), float(high), how.level)
