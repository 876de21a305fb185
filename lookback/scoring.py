"""What is right, and how much of what was found is."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lookback import checks
from lookback.matching import nearest
from sim.compare.matching import Matches
from sim.compare.traverses import moved_ahead
from sim.compare.truth import errors_between, points_of
from sim.datasets import TruthKind
from sim.datasets.found import read_drive
from sim.evaluation.metrics import Answers, PrecisionRecall, average_precision, precision_recall

Curve: TypeAlias = PrecisionRecall
Found: TypeAlias = "Matches | ArrayLike"
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
    if kind not in get_args(TruthKind):
        raise ValueError(f"kind is one of {', '.join(map(repr, get_args(TruthKind)))}, not {kind!r}")
    ahead, tolerance = checks.number("ahead", ahead), checks.number("tolerance", tolerance, least=0)
    reference_at, query_at = points_of(kind, read_drive(Path(reference)), read_drive(Path(query)))
    return np.asarray(errors_between(reference_at, moved_ahead(query_at, ahead)) <= tolerance)


def recall_at(found: Found, truth: ArrayLike, count: int = 1, soft: ArrayLike | None = None) -> float:
    """Recall@count: of the frames with a right place (rows of truth (Q, N)), those that have one among their best.

    Up to 10; NaN where no frame has a right place. Of `believe` only recall@1 is known. soft: see `pr_curve`.

    >>> similarity, right = np.array([[0.9, 0.8, 0.1], [0.2, 0.7, 0.3]]), np.eye(3, dtype=bool)[[1, 1]]
    >>> recall_at(similarity, right), recall_at(similarity, right, 2)
    (0.5, 1.0)
    """
    matches, right = judged(found, truth, soft)
    ranked = matches.ranked if len(matches.ranked) else matches.place[:, np.newaxis]
    best, on_map = ranked[:, : checks.count("count", count, ranked.shape[1])], right.any(axis=1)
    hit = right[np.arange(len(right))[:, np.newaxis], best] & (best >= 0)
    return float(hit[on_map].any(axis=1).mean()) if on_map.any() else float("nan")


def pr_curve(found: Found, truth: ArrayLike, soft: ArrayLike | None = None) -> Curve:
    """Precision and recall at every confidence: `thresholds`, `precision`, `recall_of_places`, (T,) each.

    Recall counts every frame that has a right place; a frame that has none makes whatever is accepted wrong. soft:
    places (Q, N) that are neither right nor wrong, GTsoft of VPR_Tutorial as its createPR of 2023 has it: they are
    masked, and the next best place counts. Where `believe` says such a place, it has no other, and no answer.

    >>> curve = pr_curve(np.array([[0.9, 0.1], [0.6, 0.5]]), np.eye(2, dtype=bool))
    >>> curve.precision.tolist(), curve.recall_of_places.tolist()
    ([1.0, 0.5], [0.5, 0.5])
    """
    matches, right = judged(found, truth, soft)
    hit = right[np.arange(len(right)), matches.place] & (matches.place >= 0)
    confidence = np.where(matches.place >= 0, matches.confidence, np.nan)
    return precision_recall(Answers(confidence, hit, np.asarray(right.any(axis=1))))


def auc(curve: Curve) -> float:
    """Area under a curve of precision over recall (average precision), 0 to 1; nothing is interpolated.

    >>> auc(pr_curve(np.eye(3), np.eye(3, dtype=bool)))
    1.0
    """
    if not isinstance(curve, PrecisionRecall):
        raise ValueError(f"a curve is what pr_curve gives, not {type(curve).__name__}")
    return average_precision(curve)


def match_pairs(found: Found, least: float = -np.inf) -> NDArray[np.intp]:
    """Pairs (n, 2) of a frame and its place, of at least that confidence.

    >>> match_pairs(np.array([[0.9, 0.1], [0.6, 0.5]]), least=0.8).tolist()
    [[0, 0]]
    """
    matches = found if isinstance(found, Matches) else nearest(found)
    if isinstance(least, str) or np.isnan(least):
        raise ValueError(f"least is a confidence, not {least!r}")
    rows = np.flatnonzero((matches.place >= 0) & (matches.confidence >= least))
    return np.column_stack([rows, matches.place[rows]])


def judged(found: Found, truth: ArrayLike, soft: ArrayLike | None = None) -> tuple[Matches, NDArray[np.bool_]]:
    """What was found for each row of truth (Q, N), without soft places, and the truth. ValueError for other shapes."""
    matches = found if isinstance(found, Matches) else nearest(found)
    shape = len(matches.place), matches.costs.shape[1]
    right = checks.flags("truth", truth, shape)
    return matches if soft is None else matches.without(checks.flags("soft", soft, shape) & ~right), right
