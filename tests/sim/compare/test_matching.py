"""Which queries are judged, and how."""

from __future__ import annotations

import numpy as np

from sim.compare.matching import Matches, judge, judged_queries


def test_a_query_of_unknown_position_is_not_judged_and_one_off_the_map_is() -> None:
    errors = np.array([[0.0, 9.0], [np.nan, np.nan], [9.0, 0.0], [99.0, np.inf], [1.0, 8.0]])
    assert judged_queries(errors, length=1).tolist() == [0, 2, 3, 4]
    assert judged_queries(errors, length=3).tolist() == [2, 3, 4]
    place = np.array([0, 0, 1, 0, -1])
    matches = Matches(place, np.ones(5), np.zeros(5, np.bool_), np.zeros((5, 2), np.float32))
    answers = judge(matches, errors, 2.0, np.array([0, 2, 3, 4]))
    assert answers.has_truth.tolist() == [True, True, False, True]
    assert answers.correct.tolist() == [True, True, False, False]
