"""The rows of a line with each region alone: costs whose two valleys are placed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.localization.region_lines import BEYOND_PLACES, region_line
from edge.sequence import Parallax
from edge.sequence.parallax import REACH, along_line
from sim.calibration.sightings import lag_places

ROWS, PLACES, END = 24, 90, 60
AGES = np.arange(ROWS)
EVERY_PLACE = np.arange(float(PLACES))


def line_at(sign: int) -> NDArray[np.float64]:
    """Where a line of one place a frame lies (ROWS,), in places."""
    return (END if sign > 0 else PLACES - END) - sign * AGES.astype(np.float64)


def valleys(
    left: float,
    right: float,
    sign: int,
    depth: float = 0.5,
    drifts: float = 0.0,
    route: NDArray[np.float64] = EVERY_PLACE,
) -> NDArray[np.float64]:
    """Costs (2, ROWS, places) that are lowest so many places beyond the line in the direction of travel.

    drifts: by how many places more with each row of age. route: where the places lie.
    """
    away = [route - (line_at(sign) + sign * (beyond + drifts * AGES))[:, np.newaxis] for beyond in (left, right)]
    return np.stack([1 - depth / (1 + (one / 2) ** 2) for one in away])


def line(costs: NDArray[np.float64], sign: int, first: int = 0) -> Parallax:
    return Parallax(AGES, along_line(costs[:, :, first:], line_at(sign), EVERY_PLACE[first:], 1.0, sign))


@given(lag=st.floats(-14, 14), middle=st.floats(-5, 5), sign=st.sampled_from([1, -1]))
def test_each_region_says_where_its_line_lies_in_the_direction_of_travel(lag: float, middle: float, sign: int) -> None:
    found = line(valleys(middle - lag / 2, middle + lag / 2, sign), sign)
    assert lag_places(found) == pytest.approx(lag, abs=0.35)
    for costs, beyond in zip(found.costs, (middle - lag / 2, middle + lag / 2), strict=True):
        of_region = region_line(costs, np.zeros((1, ROWS)))
        assert of_region is not None
        assert of_region.likely.sum() == pytest.approx(1.0)
        assert BEYOND_PLACES[of_region.likely.argmax()] == pytest.approx(beyond, abs=0.3)
        assert of_region.contrast == pytest.approx(0.48, abs=0.03)


def test_rows_are_compared_where_the_vehicle_was() -> None:
    """Of a vehicle that leaves its lane, each row lies elsewhere; where that is known, all show the same place."""
    found = line(valleys(3.0, 3.0, 1, depth=0.1, drifts=-0.3), 1)
    aside = -0.3 * AGES.astype(np.float64)
    straight, moved = (region_line(found.costs[0], places[np.newaxis]) for places in (np.zeros(ROWS), aside))
    assert straight is not None and moved is not None
    assert moved.likely.max() > 2 * straight.likely.max()
    assert moved.contrast > straight.contrast
    assert BEYOND_PLACES[moved.likely.argmax()] == pytest.approx(3.0, abs=0.3)


def test_rows_are_compared_at_every_scale_that_the_odometer_may_have() -> None:
    """Of an odometer that is wrong by 0.3 places a row, the rows agree where the line truly is, unlikely as that is."""
    found = line(valleys(3.0, 3.0, 1, depth=0.2, drifts=-0.3), 1)
    back = AGES - AGES.mean()
    motions, priors = np.array([-0.3 * back, 0.0 * back, 0.3 * back]), np.array([0.05, 1.0, 0.05])
    of_known, of_any = region_line(found.costs[0], motions[1:2]), region_line(found.costs[0], motions, priors)
    assert of_known is not None and of_any is not None
    truth = 3.0 - 0.3 * AGES.mean()
    is_there = np.abs(BEYOND_PLACES - truth) <= 0.75
    assert of_known.likely[is_there].sum() < 0.5
    assert of_any.likely[is_there].sum() > 0.7


def test_costs_without_a_contrast_may_be_anywhere() -> None:
    flat = line(valleys(1.0, -1.0, 1, depth=0.0), 1).costs[0]
    alike = region_line(np.zeros_like(flat), np.zeros((1, ROWS)))
    found = region_line(flat, np.zeros((1, ROWS)))
    assert found is not None and alike is not None
    assert found.contrast == alike.contrast == 0.0
    assert found.likely == pytest.approx(1 / len(BEYOND_PLACES))
    assert np.isnan(lag_places(line(valleys(1.0, -1.0, 1, depth=0.0), 1)))


def test_two_places_that_are_as_good_are_both_likely_and_their_lag_is_not_clear() -> None:
    both = line(np.minimum(valleys(6.0, 6.0, 1), valleys(-6.0, -6.0, 1)), 1)
    found = region_line(both.costs[0], np.zeros((1, ROWS)))
    assert found is not None
    assert found.likely[BEYOND_PLACES < 0].sum() == pytest.approx(0.5, abs=0.01)
    assert np.isnan(lag_places(both))


def test_beyond_the_map_a_line_is_not_looked_for() -> None:
    found = line(valleys(1.0, -1.0, 1), 1, first=50)
    assert np.isnan(found.costs[0, -1]).sum() > REACH
    assert region_line(found.costs[0], np.zeros((1, ROWS))) is None


@pytest.mark.parametrize("sign", [1, -1])
def test_places_need_not_be_regularly_spaced(sign: int) -> None:
    route = np.cumsum(np.random.default_rng(1).uniform(0.5, 2.5, PLACES)) - 20.0
    found = Parallax(AGES, along_line(valleys(-3.0, 4.0, sign, route=route), line_at(sign), route, 1.0, sign))
    assert lag_places(found) == pytest.approx(7.0, abs=0.35)
