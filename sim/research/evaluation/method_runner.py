"""One method on one pair of traverses: its answers, and which of them are right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, SequenceConfig
from edge.errors import ConfigError
from edge.recognizer import model_key
from edge.reference_map.costs import CostMatcher, encode
from sim.evaluation.metrics import Answers, answers_within
from sim.research.evaluation.as_run import config_of, match_as_run
from sim.research.evaluation.descriptions import Descriptions
from sim.research.evaluation.matching import (
    Matches,
    errors_of,
    judge,
    judged_queries,
    match,
    match_seqslam,
    open_matcher,
)
from sim.research.evaluation.methods import Method, find_method, query_rows, reference_rows
from sim.research.evaluation.plan import Pair, Plan
from sim.research.evaluation.traverses import Traverse, place_coordinates, true_errors

FEWEST = 10
"""Matches that an offset is measured on at least, as `lookback calibrate` does."""

FURTHEST = 4
"""Tolerances ahead of the vehicle, or behind it, up to which a match can be right before the offset is known."""


@dataclass(frozen=True)
class Outcome:
    """Answers of a method on a pair.

    ahead: how far ahead of the query its right place lies, see `Pair.ahead`. errors: (Q, N) distance of every query's
    right place to every place. length: frames of a sequence. judged: the queries that `answers` are about, see
    `judged_queries`; matches and errors have all.
    """

    pair: Pair
    method: Method
    length: int
    reference: Traverse
    query: Traverse
    matches: Matches
    ahead: float
    errors: NDArray[np.float64]
    judged: NDArray[np.intp]
    answers: Answers

    def error_of_best(self) -> NDArray[np.float64]:
        """(Q,) true distance of each answer, inf where there is none."""
        return errors_of(self.matches.place, self.errors)

    def within_twice(self) -> Answers:
        """The same answers by twice the tolerance."""
        answers, error = self.answers, self.error_of_best()[self.judged]
        return answers_within(answers.confidence, error, answers.has_truth, 2 * self.pair.tolerance)

    @property
    def threshold(self) -> float:
        """The default confidence from which a match is accepted; SeqSLAM has the inverse of a uniqueness."""
        default = AcceptanceConfig()
        if self.method.recognizer == "belief":
            return default.confidence_from
        return -1 / default.uniqueness_min if self.method.layer == "pixels" else default.uniqueness_min

    def ahead_of_query(self) -> NDArray[np.float64]:
        """(Q,) how far ahead of the query each match lies in the direction of travel, NaN without one."""
        along = place_coordinates(self.reference, self.pair)[1]
        known = ~np.isnan(self.errors).all(axis=1) & (self.matches.place >= 0)
        out = np.full(len(self.errors), np.nan)
        further = along[self.matches.place[known]] - along[self.errors[known].argmin(axis=1)]
        if self.pair.loop:
            further = (further + self.pair.loop / 2) % self.pair.loop - self.pair.loop / 2
        out[known] = np.where(self.matches.reverse[known], -further, further) + self.ahead
        return out


class MethodRunner:
    """Runs the methods of a plan; each traverse is read once, and described once, when it is first needed."""

    def __init__(self, plan: Plan, descriptions: Descriptions, open_traverse: Callable[[str], Traverse]) -> None:
        """open_traverse reads a traverse of the plan by its name."""
        self.plan = plan
        self.descriptions = descriptions
        self.traverse = cache(open_traverse)
        self._ahead: dict[tuple[str, str], float] = {}

    def method(self, text: str) -> Method:
        """A row of the table; ConfigError if there is none of that name."""
        return find_method(text, list(self.plan.networks))

    def sequence_length(self, pair: Pair) -> int:
        """Frames of a sequence of this pair."""
        return pair.length or max(1, round((pair.length_m or 0.0) / self.plan.sampling.spacing_m))

    def run(self, pair: Pair, text: str, length: int | None = None) -> Outcome:
        """One method on one pair; length: frames of a sequence, where they are others than the plan has."""
        method = self.method(text)
        reference, query = self.traverse(pair.reference), self.traverse(pair.query)
        length = length or self.sequence_length(pair)
        matches = self.match(pair, method, reference, query, length)
        ahead = self.offset(pair, text)
        errors = true_errors(reference, query, pair, ahead)
        judged = judged_queries(errors, length, query.drives())
        if not judged.size:
            raise ConfigError(f"pair {pair.name!r}: no frame with a known true place ends a sequence of {length}")
        answers = judge(matches, errors, pair.tolerance, judged)
        return Outcome(pair, method, length, reference, query, matches, ahead, errors, judged, answers)

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

    def match(self, pair: Pair, method: Method, reference: Traverse, query: Traverse, length: int) -> Matches:
        """What a method answers on two traverses by the settings of a pair, before anything is judged."""
        if method.layer == "pixels":
            if len(reference.paths) > 1 or len(query.paths) > 1:
                raise ConfigError(f"pair {pair.name!r}: SeqSLAM needs traverses of one feed")
            return match_seqslam(reference.pixels, query.pixels, length)
        source = method.network, method.layer, method.regions
        raw = self.descriptions.raw(reference, *source), self.descriptions.raw(query, *source)
        if method.recognizer:
            config = config_of(pair, reference, query, SequenceConfig(length=length), self.plan.region_width)
            network = self.descriptions.network(method.network, "fc6")
            return match_as_run(reference, query, raw, config, model_key(network), method.recognizer)
        described = reference_rows(method, raw[0])
        costs_of = CostMatcher.of_encoded(encode(described)).costs
        starts = {drive.start for drive in query.drives()}
        search = open_matcher(
            *place_coordinates(reference, pair),
            2 * pair.tolerance,  # the second-best match of the uniqueness lies outside
            SequenceConfig(length=length, region_order="frame"),
            regions=described.shape[1],
            views=(reference.feed.header.view, query.feed.header.view),
            drives=reference.drives(),
        )
        return match(query_rows(method, raw[1], length, starts), costs_of, search, starts)
