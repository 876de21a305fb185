"""Which queries are judged, and costs of any origin."""

from __future__ import annotations

import numpy as np

from edge.config import SequenceConfig
from sim.research.evaluation.matching import CANDIDATES, judge, judged_queries, match_costs

SEQUENCE = SequenceConfig(length=5, region_order="frame")


def test_a_query_of_unknown_position_is_not_judged_and_one_off_the_map_is() -> None:
    errors = np.array([[0.0, 9.0], [np.nan, np.nan], [9.0, 0.0], [99.0, np.inf], [1.0, 8.0]])
    assert judged_queries(errors, length=1).tolist() == [0, 2, 3, 4]
    assert judged_queries(errors, length=3).tolist() == [2, 3, 4]
    matches = match_costs(np.where(np.isnan(errors), 5.0, np.minimum(errors, 9.0)).T, SequenceConfig(length=1), 1)
    answers = judge(matches, errors, 2.0, np.array([0, 2, 3]))
    assert answers.has_truth.tolist() == [True, True, False] and answers.correct.tolist() == [True, True, False]


def test_a_scale_of_the_costs_changes_nothing() -> None:
    costs = np.random.default_rng(0).uniform(1, 2, (20, 15))
    one, other = match_costs(costs, SEQUENCE, 3), match_costs(costs * 1000, SEQUENCE, 3)
    np.testing.assert_array_equal(one.place, other.place)
    np.testing.assert_allclose(one.confidence, other.confidence, rtol=1e-4)


def test_candidates_are_the_places_of_lowest_cost() -> None:
    costs = np.random.default_rng(2).uniform(1, 2, (40, 6))
    found = match_costs(costs, SequenceConfig(length=1, region_order="frame"), 2)
    for query in range(6):
        assert found.candidates[query].tolist() == np.argsort(costs[:, query])[:CANDIDATES].tolist()
