"""How right a confidence is: what counts how much."""

from __future__ import annotations

import numpy as np
import pytest

from sim.evaluation.metrics import Answers
from sim.research.evaluation.reliability import Confidences, rows_of


def test_frames_on_the_map_count_as_much_as_all_off_it() -> None:
    on_map = np.array([True, True, True, True, False])
    mapped = Answers(np.array([0.55, 0.55, 0.55, 0.95, 0.55]), np.array([True, True, False, True, False]), on_map)
    claims = Confidences.of(mapped, np.array([0.0, 0.0, 0.55, np.nan]))
    tenths = list(claims.tenths())
    # Three of four on the map, of which two are right, and two of five off it.
    assert tenths[5][1:] == pytest.approx((0.55, 2 / 4 / (3 / 4 + 2 / 5)))
    assert tenths[9][1:] == pytest.approx((0.95, 1.0))
    assert [count for count, _, _ in tenths] == [0, 0, 0, 0, 0, 5, 0, 0, 0, 1]
    rows = list(rows_of({"roads": claims}))
    assert rows[2:] == ["| 0.7 to 0.8 | - |", "| 0.8 to 0.9 | - |", "| 0.9 to 1.0 | 1, 0.95, 1.00 |"]
