"""From descriptors to answers with the recognizer's own parts: cost rows, lines, uniqueness; and SeqSLAM's own way."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, CameraConfig, Config, SequenceConfig
from edge.descriptor import NormalizedRows
from edge.feed import View
from edge.reference_map import COST_ONE
from edge.sequence.evidence import Neighborhood
from edge.sequence.search import NO_LINE, SequenceCosts
from edge.sequence.submap import RowMatcher
from sim.compare import seqslam
from sim.evaluation.metrics import Answers


@dataclass(frozen=True)
class Matches:
    """A method's answers to the queries of a traverse.

    place: (Q,) best place, -1 while there is no answer. confidence: (Q,) float64, higher is more certain, NaN without
    one. reverse: (Q,) bool, the map was passed backwards.
    costs: (Q, N) float32 cost of each query to each place, before any sequence, for pictures.
    ranking: (Q, N) by which the method puts places in order, least first, inf of those that it does not name; () of one
    that names a single place. confidence_of: what the confidence of a query is in a place that it names.
    """

    place: NDArray[np.intp]
    confidence: NDArray[np.float64]
    reverse: NDArray[np.bool_]
    costs: NDArray[np.float32]
    ranking: NDArray[np.floating] = field(default_factory=lambda: np.zeros((0, 0)))
    confidence_of: Callable[[int, int], float] = field(default=lambda query, place: float("nan"), repr=False)

    @cached_property
    def ranked(self) -> NDArray[np.intp]:
        """The MOST_RANKED best places in order (Q, MOST_RANKED), -1 where there are fewer; () of a single place."""
        return best_places(self.ranking)

    def without(self, masked: NDArray[np.bool_]) -> Matches:
        """The answers where masked places (Q, N) are none: in place of such an answer the next best one counts.

        The method was asked as if it knew nothing of them, as VPR_Tutorial masks its similarities. A method that names
        a single place has no other answer.
        """
        place, confidence = self.place.copy(), self.confidence.copy()
        ranking = np.where(masked, np.inf, self.ranking) if len(self.ranking) else self.ranking
        for query in np.flatnonzero((place >= 0) & masked[np.arange(len(place)), place]).tolist():
            best = int(ranking[query].argmin()) if len(ranking) else -1
            is_known = best >= 0 and np.isfinite(ranking[query, best])
            place[query] = best if is_known else -1
            confidence[query] = self.confidence_of(query, best) if is_known else np.nan
        return replace(self, place=place, confidence=confidence, ranking=ranking)


MOST_RANKED = 10
"""Places of each query that are kept in order, for recall@1, 5 and 10."""


def best_places(costs: NDArray[Any]) -> NDArray[np.intp]:
    """The MOST_RANKED places (Q, MOST_RANKED) of least cost (Q, N), the best first; -1 where fewer are below inf."""
    order = np.argsort(costs, axis=1, kind="stable")[:, :MOST_RANKED]
    order = np.where(np.isfinite(np.take_along_axis(costs, order, axis=1)), order, -1)
    return np.pad(order, [(0, 0), (0, MOST_RANKED - order.shape[1])], constant_values=-1)


def match_alone(similarity: NDArray[np.floating]) -> Matches:
    """The best match of each frame alone by similarities (Q, N), which are its confidence."""
    costs = -similarity if similarity.dtype.kind == "f" else -similarity.astype(np.float64)
    place, is_reverse = costs.argmin(axis=1), np.zeros(len(costs), np.bool_)
    confidence = similarity.max(axis=1).astype(np.float64)
    shown = costs.astype(np.float32, copy=False)
    return Matches(place, confidence, is_reverse, shown, costs, lambda query, place: -float(costs[query, place]))


def as_costs(similarity: NDArray[np.floating]) -> NDArray[np.float32]:
    """Costs (Q, N) for the search of sequences: cosines as 1 less each, all else by its span, its highest as 0.

    The uniqueness of a line is a ratio of costs, which needs a zero.
    """
    low, high = float(similarity.min()), float(similarity.max())
    costs = 1 - similarity if low >= -1 and high <= 1 else (high - similarity) / max(high - low, 1e-12)
    return np.asarray(np.rint(costs * COST_ONE), dtype=np.float32)


CostsOf = Callable[[NDArray[np.float32]], NDArray[np.int32]]
"""Costs (n, orders, N) int32 of query rows (n, R, D), or of whatever the rows are."""


def costs_of_better_order(costs_of: CostsOf) -> CostsOf:
    """Costs (n, 1, N) of each frame in the region order of lower cost, as in the paper."""
    return lambda rows: costs_of(rows).min(axis=1, keepdims=True)


def match(
    rows: Iterable[NormalizedRows], costs_of: CostsOf, matcher: RowMatcher, starts: Collection[int] = ()
) -> Matches:
    """Match every frame of a query with the recognizer's own search; a new sequence begins at each of `starts`."""
    found = []
    for frame, change in enumerate(rows):
        if frame in starts:
            matcher.clear()
        costs = costs_of(change.rows)
        best = matcher.push(costs, change.ages)
        newest = costs[0].min(axis=0).astype(np.float32)
        if best is None or matcher.lines is None:
            found.append(no_match(newest))
        else:
            ranking = line_ranking(matcher.lines)
            found.append((best.place, best.uniqueness, best.direction == "reverse", newest, ranking))
    return gathered(found, matcher.neighborhood)


def open_matcher(
    ground: NDArray[np.float64],
    along: NDArray[np.float64],
    window: float,
    sequence: SequenceConfig,
    *,
    regions: int = 1,
    views: tuple[View, View] = ("front", "front"),
    drives: Sequence[slice] = (),
) -> RowMatcher:
    """A matcher of places that are where `place_coordinates` says.

    window: places within it of each other, in the same unit, are the same place. views: of reference and query.
    drives: the places of each; all are of one by default.
    """
    segments = [(drive.start, drive.stop) for drive in drives] or [(0, len(along))]
    drive_of = np.repeat(np.arange(len(segments), dtype=np.int32), [end - start for start, end in segments])
    acceptance = AcceptanceConfig(window_m=window)
    config = Config(camera=CameraConfig(view=views[1]), sequence=sequence, acceptance=acceptance)
    near = Neighborhood(ground, along, drive_of, acceptance)
    return RowMatcher(segments, [views[0]] * len(segments), regions, near, config)


OfFrame = tuple[int, float, bool, NDArray[np.float32], NDArray[np.float32]]
"""The fields of `Matches` of one frame."""


def no_match(costs: NDArray[np.float32]) -> OfFrame:
    """Of a frame with these costs (N,) that has no answer."""
    return -1, float("nan"), False, costs, np.full(len(costs), np.inf, np.float32)


def line_ranking(lines: SequenceCosts) -> NDArray[np.float32]:
    """The costs (N,) of the lines that end at each place, inf where none does; float32 has them exactly."""
    return np.where(lines.costs == NO_LINE, np.inf, lines.costs).astype(np.float32)


def gathered(found: Sequence[OfFrame], neighborhood: Neighborhood) -> Matches:
    """The matches of frames as one, by the uniqueness of their lines. neighborhood: of the places."""
    place, confidence, reverse, costs, rows = zip(*found, strict=True)
    ranking = np.stack(rows)

    def uniqueness(query: int, place: int) -> float:
        """As `match_at` has it."""
        second = float(np.where(neighborhood.around(place), np.inf, ranking[query]).min())
        return second / max(float(ranking[query, place]), 1.0) if np.isfinite(second) else 1.0

    return Matches(np.array(place), np.array(confidence), np.array(reverse), np.stack(costs), ranking, uniqueness)


def match_seqslam(reference: NDArray[np.float32], query: NDArray[np.float32], length: int) -> Matches:
    """SeqSLAM as published, on frames as it describes them, (N, 32, 64) and (Q, 32, 64)."""
    differences = seqslam.difference_matrix(reference, query)
    ds = 2 * ((length - 1) // 2)  # its window is centered, and one frame longer
    place, ratio, scores = seqslam.search(seqslam.enhance_contrast(differences), ds)
    # Best over second best: its inverse is the uniqueness of the other methods.
    return Matches(
        place,
        -ratio,
        np.zeros(len(query), np.bool_),
        differences.T,
        scores,
        lambda query, place: -seqslam.uniqueness(scores[query], place),
    )


def judge(matches: Matches, errors: NDArray[np.float64], tolerance: float, queries: NDArray[np.intp]) -> Answers:
    """Judge the matches of some queries by the true errors (Q, N); an answer for each of the queries."""
    return Answers(
        confidence=matches.confidence[queries],
        correct=errors_of(matches.place, errors)[queries] <= tolerance,
        has_truth=np.fmin.reduce(errors[queries], axis=1) <= tolerance,
    )


def judged_queries(errors: NDArray[np.float64], length: int, drives: Sequence[slice] = ()) -> NDArray[np.intp]:
    """Queries with a known true position, from the first of each drive on that ends a whole sequence."""
    is_judged: NDArray[np.bool_] = ~np.asarray(np.isnan(errors).all(axis=1))
    for drive in drives or [slice(0, len(errors))]:
        is_judged[drive][: length - 1] = False
    return np.flatnonzero(is_judged)


def errors_of(places: NDArray[np.intp], errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """True error of the place of each query, (Q,); inf where there is none (-1), NaN where the truth is not known."""
    picked = errors[np.arange(len(places)), np.maximum(places, 0)]
    return np.where(places < 0, np.inf, picked)
