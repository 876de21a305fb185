"""Scores of a method's answers: F1, areas, recall; and their intervals. See `sim.evaluation.metrics`.

Neighboring frames are nearly the same picture, so that resampling single frames would make every interval too narrow.
Blocks of contiguous frames are drawn instead (circular block bootstrap, Politis and Romano 1992).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sim.evaluation.metrics import Answers, average_precision, precision_recall, recall_at_precision
from sim.evaluation.report import Interval

LEVEL = 0.95
"""Of the intervals."""


def joined(several: Sequence[Answers]) -> Answers:
    """The answers of several traverses, one after the other."""
    columns = ((one.confidence, one.correct, one.has_truth) for one in several)
    return Answers(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def at_threshold(answers: Answers, threshold: float) -> tuple[float, float]:
    """Precision and recall_of_places of what is accepted from a threshold on; NaN where there is nothing."""
    accepted = answers.confidence >= threshold  # NaN is not
    hits = float((accepted & answers.correct).sum())
    total, on_map = float(accepted.sum()), float(answers.has_truth.sum())
    return hits / total if total else float("nan"), hits / on_map if on_map else float("nan")


def recall_at_1(answers: Answers) -> float:
    """Right best matches over the queries that have a true place, at any confidence; NaN without such a query."""
    right, on_map = answers.correct & ~np.isnan(answers.confidence), int(answers.has_truth.sum())
    return float(right.sum()) / on_map if on_map else float("nan")


def recall_at_100(answers: Answers) -> float:
    """Highest recall_of_places without a wrong answer."""
    return recall_at_precision(precision_recall(answers), 1.0)


def block_indices(count: int, block: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """`count` indices below `count`, in runs of `block` that start anywhere; after the last comes the first."""
    block = min(block, count)
    starts = rng.integers(0, count, -(-count // block))
    runs = starts[:, np.newaxis] + np.arange(block)
    return np.asarray(runs.ravel()[:count] % count, dtype=np.intp)


def intervals(
    statistics: Callable[[Answers], tuple[float, ...]], answers: Answers, block: int, resamples: int, seed: int = 0
) -> list[Interval]:
    """The intervals of several scores, by resamples of blocks of so many frames."""
    rng, count = np.random.default_rng(seed), len(answers.confidence)
    drawn = np.array([statistics(answers.take(block_indices(count, block, rng))) for _ in range(resamples)])
    found = []
    for value, column in zip(statistics(answers), drawn.T, strict=True):
        known = column[~np.isnan(column)]  # a resample with no query on the map has no recall
        low, high = np.quantile(known, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) if known.size else (np.nan, np.nan)
        found.append(Interval(value, float(low), float(high), LEVEL))
    return found


def of_curve(answers: Answers) -> tuple[float, float, float, float]:
    """Recall@1, area, recall at 100 % precision, and highest F1 with recall_of_places (0 if nothing is correct)."""
    curve = precision_recall(answers)
    precision, recall = curve.precision, curve.recall_of_places
    total = precision + recall
    f1 = np.divide(2 * precision * recall, total, out=np.zeros_like(precision), where=total > 0)
    best = float(f1.max(initial=0.0))
    return recall_at_1(answers), average_precision(curve), recall_at_precision(curve, 1.0), best
