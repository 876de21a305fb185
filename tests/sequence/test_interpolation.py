"""Where between places a line ends, and how sharp a match is, on costs whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from edge.sequence.evidence import REACH, end_between_places, places_nearly_as_good
from edge.sequence.search import NO_LINE


def valley(bottom: float, count: int = 40, *, noise: float = 0.0) -> np.ndarray:
    costs = 1000 + 50 * (np.arange(count) - bottom) ** 2
    return (costs + np.random.default_rng(3).normal(0, noise, count)).astype(np.int32)


@pytest.mark.parametrize("bottom", [20.0, 20.25, 19.6, 20.49])
def test_the_bottom_of_a_valley_is_found_between_places(bottom: float) -> None:
    costs = valley(bottom)
    place = int(costs.argmin())
    assert place + end_between_places(costs, place) == pytest.approx(bottom, abs=0.02)


def test_noise_is_averaged_over_the_places_around() -> None:
    costs = valley(20.3, noise=100.0)
    place = int(costs.argmin())
    assert place + end_between_places(costs, place) == pytest.approx(20.3, abs=0.4)


def test_places_at_which_no_line_ends_are_left_out() -> None:
    costs = valley(20.3)
    costs[:18] = NO_LINE
    assert 20 + end_between_places(costs, 20) == pytest.approx(20.3, abs=0.02)
    costs[22:] = NO_LINE
    costs[18] = NO_LINE
    assert end_between_places(costs, 20) == 0.0, "three places say nothing"


def test_at_the_end_of_a_drive_and_where_costs_only_fall() -> None:
    falling = np.arange(40, 0, -1).astype(np.int32) ** 2
    assert 0.0 <= end_between_places(falling, 39) <= REACH
    assert end_between_places(np.full(40, 7, np.int32), 20) == 0.0
    hill = -valley(20.0)
    assert end_between_places(hill, 20) == 0.0


def test_the_width_is_that_of_the_valley_below_a_fifth_of_its_depth() -> None:
    costs = valley(20.0)
    assert places_nearly_as_good(costs, 20, elsewhere=3000) == 2.5, "those within 2 places cost less than 1400"
    assert places_nearly_as_good(costs, 20, elsewhere=1010) == 0.5, "only itself"
    assert places_nearly_as_good(costs, 20, elsewhere=NO_LINE) == 20.0, "all of them"
