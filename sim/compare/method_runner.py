"""One method on one pair of traverses: its answers, and which of them are right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import process_time

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, SequenceConfig
from edge.descriptor import NormalizedRows
from edge.errors import ConfigError
from edge.reference_map import COST_ONE
from edge.reference_map.costs import CostMatcher, encode
from edge.sequence.submap import RowMatcher
from sim.compare.as_run import config_of, match_as_run
from sim.compare.descriptions import Descriptions, Verification
from sim.compare.matching import (
    Matches,
    as_costs,
    costs_of_better_order,
    errors_of,
    judge,
    judged_queries,
    match,
    match_alone,
    match_seqslam,
    open_matcher,
)
from sim.compare.methods import SEQUENCES, Method, find_method, query_rows, reference_rows
from sim.compare.plan import Pair, Plan
from sim.compare.traverses import MethodTraverse, place_coordinates, true_errors
from sim.compare.truth import read_matrix
from sim.evaluation.metrics import Answers

FEWEST = 10
"""Matches that an offset is measured on at least, as `lookback calibrate` does."""

FURTHEST = 4
"""Tolerances ahead of the vehicle, or behind it, up to which a match can be right before the offset is known."""


@dataclass(frozen=True)
class MethodResult:
    """Answers of a method on a pair.

    ahead: how far ahead of the query its right place lies, see `Pair.ahead`. errors: (Q, N) distance of every query's
    right place to every place, NaN of one that is neither right nor wrong, which `matches` are without. length: frames
    of a sequence. judged: the queries that `answers` are about, one for one, the same for all methods, see
    `judged_queries`; matches and errors have all. frame_ms: CPU time of a frame of the query, described and matched;
    NaN where descriptors or similarities were made elsewhere.
    """

    pair: Pair
    method: Method
    length: int
    reference: MethodTraverse
    query: MethodTraverse
    matches: Matches
    ahead: float
    errors: NDArray[np.float64]
    judged: NDArray[np.intp]
    answers: Answers
    frame_ms: float = float("nan")

    def recall_within(self, count: int) -> float:
        """Recall@count: share of the queries with a true place that have it among their best; NaN if unknown."""
        ranked, on_map = self.matches.ranked, np.fmin.reduce(self.errors, axis=1) <= self.pair.tolerance
        queries = self.judged[on_map[self.judged]]
        if not queries.size or (not len(ranked) and count > 1):
            return float("nan")
        first = ranked[queries, :count] if len(ranked) else self.matches.place[queries, np.newaxis]
        errors = np.where(first < 0, np.inf, self.errors[queries[:, np.newaxis], np.maximum(first, 0)])
        return float((errors <= self.pair.tolerance).any(axis=1).mean())

    def median_error(self) -> float:
        """Median error of right answers, meters or frames along the road; NaN if none is right."""
        errors = self.error_of_best()[self.judged]
        right = errors[errors <= self.pair.tolerance]
        return float(np.median(right)) if right.size else float("nan")

    def error_of_best(self) -> NDArray[np.float64]:
        """(Q,) true distance of each answer, inf where there is none."""
        return errors_of(self.matches.place, self.errors)

    @property
    def threshold(self) -> float:
        """The default confidence from which a match is accepted; SeqSLAM has the inverse of a uniqueness."""
        default = AcceptanceConfig()
        if self.method.recognizer == "belief":
            return default.confidence_from
        if self.method.single:
            return float("nan")  # nobody says from which similarity on a place is right
        return -1 / default.uniqueness_min if self.method.layer == "pixels" else default.uniqueness_min

    def ahead_of_query(self) -> NDArray[np.float64]:
        """(Q,) how far ahead of the query each match lies in the direction of travel, NaN without one."""
        along = place_coordinates(self.reference, self.pair)[1]
        known = ~np.isnan(self.errors).all(axis=1) & (self.matches.place >= 0)
        out = np.full(len(self.errors), np.nan)
        further = along[self.matches.place[known]] - along[np.nanargmin(self.errors[known], axis=1)]
        if self.pair.loop:
            further = (further + self.pair.loop / 2) % self.pair.loop - self.pair.loop / 2
        out[known] = np.where(self.matches.reverse[known], -further, further) + self.ahead
        return out


class MethodRunner:
    """Runs the methods of a plan; each traverse is read once, and described once, when it is first needed."""

    def __init__(
        self,
        plan: Plan,
        descriptions: Descriptions,
        open_traverse: Callable[[str], MethodTraverse],
        data: Path = Path(),
    ) -> None:
        """open_traverse reads a traverse of the plan by its name. data: folder of the plan's matrices."""
        self._data = data
        self.plan = plan
        self.descriptions = descriptions
        self._verification = Verification()
        self.traverse = cache(open_traverse)
        self._ahead: dict[tuple[str, str], float] = {}

    def method(self, text: str) -> Method:
        """A row of the table; ConfigError if there is none of that name."""
        return find_method(text, list(self.plan.networks), {name for one in self.plan.pairs for name in one.similarity})

    def sequence_length(self, pair: Pair) -> int:
        """Frames of a sequence of this pair."""
        return pair.length or max(1, round((pair.length_m or 0.0) / self.plan.sampling.spacing_m))

    def run(self, pair: Pair, text: str) -> MethodResult:
        """One method on one pair."""
        method = self.method(text)
        reference, query = self.traverse(pair.reference), self.traverse(pair.query)
        length = self.sequence_length(pair)
        described_ms, began_s = self._described_ms(method, reference, query), process_time()
        matches = self.match(pair, method, reference, query, length)
        matched_ms = 1e3 * (process_time() - began_s) / len(query.rows)
        ahead = self.offset(pair, text)
        errors = true_errors(reference, query, pair, ahead, self._data)
        judged = judged_queries(errors, length, query.drives())
        if not judged.size:
            raise ConfigError(f"pair {pair.name!r}: no frame with a known true place ends a sequence of {length}")
        is_neither = np.isnan(errors) & ~np.isnan(errors).all(axis=1, keepdims=True)
        if is_neither.any():
            matches = matches.without(is_neither)
        answers = judge(matches, errors, pair.tolerance, judged)
        frame_ms = described_ms + matched_ms
        return MethodResult(pair, method, length, reference, query, matches, ahead, errors, judged, answers, frame_ms)

    def _described_ms(self, method: Method, reference: MethodTraverse, query: MethodTraverse) -> float:
        """What a frame of the query took to describe; both are described then, so that matching can be timed alone."""
        if method.layer == "pixels":
            return query.pixels_ms
        if method.layer == "matrix":
            return float("nan")
        source = method.network, method.regions
        self.descriptions.raw(reference, *source)
        described_ms = self.descriptions.frame_ms(query, *source)
        if method.keypoints:
            self._verification.keypoints(reference)
            described_ms += self._verification.frame_ms(query)
        return described_ms

    def offset(self, pair: Pair, text: str) -> float:
        """How far ahead the right place lies: as the plan says, or as this method measures it on another drive."""
        if not pair.calibration:
            return pair.ahead
        key = (pair.name, text)
        if key not in self._ahead:
            other = self.run(msgspec.structs.replace(pair, query=pair.calibration, calibration="", ahead=0.0), text)
            ahead = other.ahead_of_query()[other.matches.confidence >= other.threshold]
            # What lies further away than a camera sees is a wrong match, and no offset.
            ahead = ahead[np.abs(ahead) <= FURTHEST * pair.tolerance]
            self._ahead[key] = float(np.median(ahead)) if len(ahead) >= FEWEST else 0.0
        return self._ahead[key]

    def match(
        self, pair: Pair, method: Method, reference: MethodTraverse, query: MethodTraverse, length: int
    ) -> Matches:
        """What a method answers on two traverses by the settings of a pair, before anything is judged."""
        if method.layer == "matrix":
            return self._match_matrix(pair, method, reference, query, length)
        if method.layer == "pixels":
            if len(reference.paths) > 1 or len(query.paths) > 1:
                raise ConfigError(f"pair {pair.name!r}: SeqSLAM needs traverses of one feed")
            return match_seqslam(reference.pixels, query.pixels, length)
        source = method.network, method.regions
        raw = self.descriptions.raw(reference, *source), self.descriptions.raw(query, *source)
        if method.recognizer:
            config = config_of(pair, reference, query, SequenceConfig(length=length, directions=pair.directions))
            model = self.descriptions.model_key(method.network, raw[0].shape[2])
            return match_as_run(reference, query, raw, config, model, method.recognizer)
        described = reference_rows(method, raw[0])
        costs_of = CostMatcher.of_encoded(encode(described)).costs
        starts = {drive.start for drive in query.drives()}
        rows = query_rows(method, raw[1])
        if method.single:
            costs = np.stack([costs_of(one.rows[:1])[0].min(axis=0) for one in rows])
            alone = match_alone(1 - costs / COST_ONE)
            if not method.keypoints:
                return alone
            return self._verification.reordered(alone, reference, query, method.keypoints)
        return match(rows, costs_of_better_order(costs_of), self._open_search(pair, reference, query, length), starts)

    def _match_matrix(
        self, pair: Pair, method: Method, reference: MethodTraverse, query: MethodTraverse, length: int
    ) -> Matches:
        """The answers by similarities (Q, N) that were made elsewhere."""
        name = method.name.removesuffix(SEQUENCES)
        if name not in pair.similarity:
            raise ConfigError(f"pair {pair.name!r}: no similarity of {name!r}")
        shape = len(query.rows), len(reference.rows)
        similarity = read_matrix(self._data / pair.similarity[name], shape, transposed=pair.transposed)
        if not np.isfinite(similarity).all():
            raise ConfigError(f"{pair.similarity[name]}: a similarity that is not a finite number")
        if method.single:
            return match_alone(similarity)
        search, starts = self._open_search(pair, reference, query, length), {one.start for one in query.drives()}
        rows = (NormalizedRows(row[np.newaxis]) for row in as_costs(similarity))
        return match(rows, lambda row: row[:, np.newaxis].astype(np.int32), search, starts)

    def _open_search(self, pair: Pair, reference: MethodTraverse, query: MethodTraverse, length: int) -> RowMatcher:
        return open_matcher(
            *place_coordinates(reference, pair),
            2 * pair.tolerance,  # the second-best match of the uniqueness lies outside
            SequenceConfig(length=length, directions=pair.directions),
            views=(reference.feed.header.view, query.feed.header.view),
            drives=reference.drives(),
        )
