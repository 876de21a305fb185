"""Precision and recall of a method's answers, at exact thresholds.

Two definitions of recall are in use in the field, and papers seldom say which. Here it is recall_of_places: correct and
accepted / queries that have a true place in the map. A query whose best match is wrong is missed at every threshold.
The other, of all correct best matches, reads higher, since it reaches 1 at the lowest threshold by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
TOLERANCE_M = 40.0
"""The paper's, for a road (section IV-B)."""
OFFSET_SHARE = 0.5
"""Share of the tolerance by which half of the places found may lie ahead of where they are expected, or behind it,
without a warning. Beyond it, the curve says more of the camera's offset than of the places."""


@dataclass(frozen=True)
class Answers:
    """One method's answer to every query of a traverse, in the order of driving.

    confidence: (Q,) float64, higher is more certain; NaN where the method gave no answer, which no threshold accepts.
    correct: (Q,) bool, the best match is within the tolerance of the truth.
    has_truth: (Q,) bool, some place of the map is; where none is, accepting anything is a false positive.
    """

    confidence: Floats
    correct: Flags
    has_truth: Flags

    def __post_init__(self) -> None:
        shapes = {self.confidence.shape, self.correct.shape, self.has_truth.shape}
        if len(shapes) != 1 or self.confidence.ndim != 1:
            raise ValueError(f"answers need one shape (Q,), got {sorted(shapes)}")
        if (self.correct & ~self.has_truth).any():
            raise ValueError("a query off the map cannot have a correct match")

    def take(self, queries: NDArray[np.intp]) -> Answers:
        """The answers to these queries, which may repeat (a bootstrap's resample)."""
        return Answers(self.confidence[queries], self.correct[queries], self.has_truth[queries])


def answers_within(confidence: Floats, error: Floats, on_map: Flags, radius: float) -> Answers:
    """Answers by a radius beyond the tolerance that `on_map` is known by; all (Q,), in one unit.

    Where the map has no place within the tolerance, an answer within the radius is neither right nor wrong: it does not
    count.
    """
    right = error <= radius
    counts = np.flatnonzero(on_map | ~right)
    return Answers(confidence, right & on_map, on_map).take(counts)


@dataclass(frozen=True)
class PrecisionRecall:
    """The whole curve: one point for every distinct confidence, from the highest to the lowest.

    thresholds: (T,) a match is accepted if its confidence is at least this. precision: (T,) correct of accepted;
    accepted queries that are off the map count as wrong. recall_of_places: (T,) see the module; NaN where nothing
    is on the map.
    """

    thresholds: Floats
    precision: Floats
    recall_of_places: Floats


def precision_recall(answers: Answers) -> PrecisionRecall:
    """The exact curve; empty if no query was answered."""
    answered = ~np.isnan(answers.confidence)
    confidence, correct = answers.confidence[answered], answers.correct[answered]
    order = np.argsort(-confidence, kind="stable")
    confidence, hits = confidence[order], correct[order].cumsum()
    # Equal confidences are accepted together: a point lies after the last of each run of equals.
    last = np.flatnonzero(np.diff(confidence, append=np.nan) != 0)
    true_positives, on_map = hits[last].astype(np.float64), int(answers.has_truth.sum())
    return PrecisionRecall(
        thresholds=confidence[last],
        precision=true_positives / (last + 1.0),
        recall_of_places=true_positives / on_map if on_map else np.full_like(true_positives, np.nan),
    )


def recall_at_precision(curve: PrecisionRecall, precision: float) -> float:
    """Highest recall_of_places at any threshold of at least this precision; 0 if there is none."""
    return float(curve.recall_of_places[curve.precision >= precision].max(initial=0.0))


def average_precision(curve: PrecisionRecall) -> float:
    """Area under the steps of the curve over recall_of_places; nothing is interpolated."""
    gains = np.diff(curve.recall_of_places, prepend=0.0)
    return float(gains @ curve.precision) if gains.size else 0.0
