"""The two regions of a line apart: costs whose two valleys are placed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.sequence.parallax import regions_apart, rows_of_line

ROWS, PLACES, END = 24, 80, 60


def valleys(left: float, right: float, sign: int, depth: float = 0.5) -> NDArray[np.float64]:
    """Costs (2, ROWS, PLACES) that are lowest so many places beyond the line in the map's order, for each region."""
    at = rows_of_line(END if sign > 0 else PLACES - END, 1.0, sign, np.arange(ROWS))[:, np.newaxis]
    away = [np.arange(PLACES) - at - beyond for beyond in (left, right)]
    return np.stack([1 - depth / (1 + (one / 2) ** 2) for one in away])


def apart(costs: NDArray[np.float64], sign: int) -> tuple[float, float] | None:
    places = rows_of_line(END if sign > 0 else PLACES - END, 1.0, sign, np.arange(ROWS))
    found = regions_apart(costs, places, 0, sign)
    return None if found is None else (found.lag_places, found.middle_places)


@given(lag=st.floats(-7, 7), middle=st.floats(-3, 3), sign=st.sampled_from([1, -1]))
def test_the_lag_is_in_the_direction_of_travel_and_the_middle_in_the_maps_order(
    lag: float, middle: float, sign: int
) -> None:
    found = apart(valleys(middle - sign * lag / 2, middle + sign * lag / 2, sign), sign)
    assert found is not None
    assert found == (pytest.approx(lag, abs=0.25), pytest.approx(middle, abs=0.2))


def test_costs_without_a_contrast_say_nothing() -> None:
    assert apart(valleys(1.0, -1.0, 1, depth=0.0), 1) is None
    noise = np.random.default_rng(1).normal(0, 1e-3, (2, ROWS, PLACES))
    assert apart(1 + noise, 1) is None


def test_two_answers_that_are_as_good_are_none() -> None:
    """Each region sees both of two places, so that it is not known which of them belong together."""
    both = np.minimum(valleys(3.0, -3.0, 1), valleys(-3.0, 3.0, 1))
    assert apart(both, 1) is None


def test_a_line_at_the_end_of_what_is_known_says_nothing() -> None:
    costs = valleys(1.0, -1.0, 1)
    places = rows_of_line(END, 1.0, 1, np.arange(ROWS))
    assert regions_apart(costs[:, :, 50:], places, 50, 1) is None


def test_the_rows_of_a_line_by_its_slope() -> None:
    assert rows_of_line(20, 1.0, 1, [0, 1, 5]).tolist() == [20, 19, 15]
    assert rows_of_line(20, 1.0, -1, [0, 1, 5]).tolist() == [20, 21, 25]
    assert rows_of_line(20, 0.5, 1, [0, 4]).tolist() == [20, 18]
