"""From descriptors to answers with the recognizer's own parts: cost rows, lines, uniqueness; and SeqSLAM's own way."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, CameraConfig, Config, SequenceConfig
from edge.descriptor import NormalizedRows
from edge.descriptor.open_network import normalized_set
from edge.feed import View
from edge.reference_map.costs import CostMatcher, encode
from edge.sequence.evidence import Neighborhood
from edge.sequence.search import NO_LINE
from edge.sequence.submap import RowMatcher
from sim.evaluation.metrics import Answers
from sim.research.evaluation import seqslam

CANDIDATES = 25
"""Best places that are kept of each query: papers print R@N up to that."""
LARGEST_COST = 1 << 20  # 500 frames of it fit into the sums' int32


@dataclass(frozen=True)
class Matches:
    """A method's answers to the queries of a traverse.

    place: (Q,) best place, -1 while there is no answer. confidence: (Q,) float64, higher is more certain, NaN without
    one. reverse: (Q,) bool, the map was passed backwards. candidates: (Q, CANDIDATES) places, best first, -1 for none.
    costs: (Q, N) float32 cost of each query to each place, before any sequence, for pictures.
    """

    place: NDArray[np.intp]
    confidence: NDArray[np.float64]
    reverse: NDArray[np.bool_]
    candidates: NDArray[np.intp]
    costs: NDArray[np.float32]


CostsOf = Callable[[NDArray[np.float32]], NDArray[np.int32]]
"""Costs (n, orders, N) int32 of query rows (n, R, D), or of whatever the rows are."""


def unit_rows(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """All regions of a frame as one vector of length 1, (N, R * D); zero stays zero."""
    flat = descriptors.reshape(len(descriptors), -1)
    norms = np.linalg.norm(flat, axis=1, keepdims=True)
    return np.asarray(np.divide(flat, norms, out=np.zeros_like(flat), where=norms > 0))


def matching_accuracy(query: NDArray[np.float32], reference: NDArray[np.float32], correct: NDArray[np.bool_]) -> float:
    """Share of query frames (N, R, D), NSD, whose most similar reference frame (M, R, D) is in `correct` (N, M)."""
    similarity = unit_rows(normalized_set(query)) @ unit_rows(normalized_set(reference)).T
    best = similarity.argmax(axis=1)
    return float(correct[np.arange(len(best)), best].mean())


def int8_matcher(descriptors: NDArray[np.float32]) -> CostMatcher:
    """The recognizer's matcher on descriptors (N, R, D), quantized as a map keeps them."""
    encoded = encode(descriptors)
    return CostMatcher.of_encoded(encoded)


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
            found.append((-1, float("nan"), False, np.full(CANDIDATES, -1), newest))
        else:
            candidates = lowest(matcher.lines.costs, NO_LINE)
            found.append((best.place, best.uniqueness, best.direction == "reverse", candidates, newest))
    return gathered(found)


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


def gathered(found: Sequence[tuple[int, float, bool, NDArray[np.intp], NDArray[np.float32]]]) -> Matches:
    """The matches of frames as one; each has the fields of `Matches`, place -1 and NaN where there is none."""
    place, confidence, reverse, candidates, costs = zip(*found, strict=True)
    return Matches(np.array(place), np.array(confidence), np.array(reverse), np.stack(candidates), np.stack(costs))


def match_costs(costs: NDArray[np.floating], sequence: SequenceConfig, window_places: int) -> Matches:
    """Search a cost matrix (reference x query) of any origin; ratios of costs are kept unless some are negative."""
    least, most = float(costs.min()), float(costs.max())
    low = min(least, 0.0)
    scaled = np.rint((costs.T - low) * (LARGEST_COST / max(most - low, 1e-30))).astype(np.int32)
    rows = (NormalizedRows(row[np.newaxis, np.newaxis]) for row in scaled)
    places = np.arange(len(costs), dtype=np.float64)
    matcher = open_matcher(np.full((len(costs), 2), np.nan), places, window_places, sequence)
    return match(rows, lambda row: row.astype(np.int32), matcher)


def match_seqslam(reference: NDArray[np.float32], query: NDArray[np.float32], length: int) -> Matches:
    """SeqSLAM as published, on frames as it describes them, (N, 32, 64) and (Q, 32, 64)."""
    differences = seqslam.difference_matrix(reference, query)
    ds = 2 * ((length - 1) // 2)  # its window is centered, and one frame longer
    found = seqslam.search(seqslam.enhance_contrast(differences, 10), seqslam.SeqslamSettings(length=ds))
    shift = found.place - found.scores.argmin(axis=1)  # of the answer against its trajectory's start
    starts = np.stack([lowest(scores, np.inf) for scores in found.scores])
    candidates = np.where((starts < 0) | (found.place < 0)[:, np.newaxis], -1, starts + shift[:, np.newaxis])
    candidates[candidates >= len(differences)] = -1
    # Best over second best: its inverse is the uniqueness of the other methods.
    return Matches(found.place, -found.ratio, np.zeros(len(query), np.bool_), candidates, differences.T)


def lowest(costs: NDArray[np.generic], none: float) -> NDArray[np.intp]:
    """The CANDIDATES places of lowest cost, -1 where there are no more."""
    order = np.argsort(costs, kind="stable")[:CANDIDATES]
    out = np.full(CANDIDATES, -1)
    out[: len(order)] = np.where(costs[order] == none, -1, order)
    return out


def judge(matches: Matches, errors: NDArray[np.float64], tolerance: float, queries: NDArray[np.intp]) -> Answers:
    """Judge the matches of some queries by the true errors (Q, N)."""
    best = errors_of(matches.place[:, np.newaxis], errors)[queries, 0]
    return Answers(
        confidence=matches.confidence[queries],
        correct=best <= tolerance,
        has_truth=errors[queries].min(axis=1) <= tolerance,
    )


def judged_queries(errors: NDArray[np.float64], length: int, drives: Sequence[slice] = ()) -> NDArray[np.intp]:
    """Queries with a known true position, from the first of each drive on that ends a whole sequence."""
    is_judged: NDArray[np.bool_] = ~np.asarray(np.isnan(errors).all(axis=1))
    for drive in drives or [slice(0, len(errors))]:
        is_judged[drive][: length - 1] = False
    return np.flatnonzero(is_judged)


def errors_of(places: NDArray[np.intp], errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """True error of each candidate, (Q, K) places -> (Q, K); inf where there is none (-1)."""
    picked = np.take_along_axis(errors, np.maximum(places, 0), axis=1)
    return np.where(places < 0, np.inf, picked)
