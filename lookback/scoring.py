"""What is right, and how much of what was found is."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from lookback.matching import nearest
from sim.compare.matching import Matches
from sim.compare.traverses import moved_ahead
from sim.compare.truth import errors_between, points_of
from sim.datasets import TruthKind
from sim.datasets.pictures import read_drive
from sim.evaluation.metrics import Answers, PrecisionRecall, average_precision, precision_recall

Curve: TypeAlias = PrecisionRecall
Found: TypeAlias = "Matches | NDArray[np.floating]"
"""What `nearest`, `search` or `believe` gave; or S (Q, N) or (2, Q, N), of which the most similar place counts."""


def truth(
    query: str | Path, reference: str | Path, *, tolerance: float, kind: TruthKind = "positions", ahead: float = 0.0
) -> NDArray[np.bool_]:
    """Which places (Q, N) are right for each frame, of two recordings as `describe` takes them.

    kind: "positions" (latitude and longitude of both), "route_m" (a column of both, meters along one route) or "rows"
    (the same number of the frame, of drives that were aligned frame by frame). tolerance: in meters, or in frames.
    ahead: how far ahead of the query, on its own drive, the right place lies: of a rear and a front camera about 6 m to
    12 m. Raises `Error` for recordings that do not say it.
    """
    reference_at, query_at = points_of(kind, read_drive(Path(reference)), read_drive(Path(query)))
    return np.asarray(errors_between(reference_at, moved_ahead(query_at, ahead)) <= tolerance)


def recall_at(found: Found, truth: NDArray[np.bool_], count: int = 1) -> float:
    """Recall@count: of the frames with a right place (rows of truth (Q, N)), those that have one among their best.

    Up to 10; NaN where no frame has a right place. Of `believe` only recall@1 is known.

    >>> similarity, right = np.array([[0.9, 0.8, 0.1], [0.2, 0.7, 0.3]]), np.eye(3, dtype=bool)[[1, 1]]
    >>> recall_at(similarity, right), recall_at(similarity, right, 2)
    (0.5, 1.0)
    """
    matches = _matches(found, truth)
    ranked = matches.ranked if len(matches.ranked) else matches.place[:, np.newaxis]
    if not 1 <= count <= ranked.shape[1]:
        raise ValueError(f"recall is known at 1 to {ranked.shape[1]} places, not at {count}")
    best, on_map = ranked[:, :count], np.asarray(truth.any(axis=1))
    right = truth[np.arange(len(truth))[:, np.newaxis], best] & (best >= 0)
    return float(right[on_map].any(axis=1).mean()) if on_map.any() else float("nan")


def pr_curve(found: Found, truth: NDArray[np.bool_], soft: NDArray[np.bool_] | None = None) -> Curve:
    """Precision and recall at every confidence: `thresholds`, `precision`, `recall_of_places`, (T,) each.

    Recall counts every frame that has a right place; a frame that has none makes whatever is accepted wrong. soft:
    places (Q, N) that are neither right nor wrong, as GTsoft of VPR_Tutorial.

    >>> curve = pr_curve(np.array([[0.9, 0.1], [0.6, 0.5]]), np.eye(2, dtype=bool))
    >>> curve.precision.tolist(), curve.recall_of_places.tolist()
    ([1.0, 0.5], [0.5, 0.5])
    """
    matches = _matches(found, truth)
    rows = np.arange(len(truth))
    right = truth[rows, matches.place] & (matches.place >= 0)
    counts = np.ones(len(truth), dtype=np.bool_) if soft is None else ~(soft[rows, matches.place] & ~right)
    confidence = np.where(matches.place >= 0, matches.confidence, np.nan)
    answers = Answers(confidence, right, np.asarray(truth.any(axis=1)))
    return precision_recall(answers.take(np.flatnonzero(counts)))


def auc(curve: Curve) -> float:
    """Area under a curve of precision over recall (average precision), 0 to 1; nothing is interpolated.

    >>> auc(pr_curve(np.eye(3), np.eye(3, dtype=bool)))
    1.0
    """
    return average_precision(curve)


def match_pairs(found: Found, least: float = -np.inf) -> NDArray[np.intp]:
    """Pairs (n, 2) of a frame and its place, of at least that confidence.

    >>> match_pairs(np.array([[0.9, 0.1], [0.6, 0.5]]), least=0.8).tolist()
    [[0, 0]]
    """
    matches = found if isinstance(found, Matches) else nearest(found)
    rows = np.flatnonzero((matches.place >= 0) & (matches.confidence >= least))
    return np.column_stack([rows, matches.place[rows]])


def _matches(found: Found, truth: NDArray[np.bool_]) -> Matches:
    """What was found for each row of truth (Q, N). ValueError where the shapes differ."""
    matches = found if isinstance(found, Matches) else nearest(found)
    shape = (len(matches.place), matches.costs.shape[1])
    if truth.shape != shape or truth.dtype != np.bool_:
        raise ValueError(f"truth is bool {shape} (queries, places), not {truth.dtype} {truth.shape}")
    return matches
