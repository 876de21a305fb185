"""Uniqueness with its window in meters, and hold-off."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import AcceptanceConfig
from edge.sequence import PlaceMatch
from edge.sequence.evidence import HoldOff, Neighborhood, lowest_around, match_at
from edge.sequence.search import SequenceCosts, SequenceSearch

UNKNOWN, NOTHING = np.full(100, np.nan), np.zeros(100)
CONFIG = AcceptanceConfig(window_m=10.0, window_places=3)


def match(
    costs: NDArray[np.float64],
    neighborhood: Neighborhood,
    newest: NDArray[np.float64] = NOTHING,
    *,
    frames: int = 5,
    step: float = 1.0,
) -> PlaceMatch:
    search = SequenceSearch([(0, 100)], [("forward", "same")], frames, (1.0,))
    search.refill(np.zeros((frames, 1, 100), dtype=np.int32), [step * frame for frame in range(frames)])
    lines = SequenceCosts(costs.astype(np.int32), (costs.astype(np.int32),), frames)  # as the search would give them
    return match_at(int(costs.argmin()), 0, search, lines, newest[np.newaxis].astype(np.int32), neighborhood)


def neighbors_by_route(spacing_m: float) -> Neighborhood:
    none = np.full((100, 2), np.nan)
    return Neighborhood(none, np.arange(100.0) * spacing_m, np.zeros(100, dtype=np.int32), CONFIG)


def test_second_best_is_looked_for_outside_the_window() -> None:
    costs = np.full(100, 1500)
    costs[40], costs[45], costs[80] = 1000, 1010, 1300
    found = match(costs, neighbors_by_route(2.0))  # 10 m are 5 places
    assert found.place == 40
    assert found.uniqueness == pytest.approx(1.3)
    found = match(costs, neighbors_by_route(3.0))  # 10 m are 3 places: 45 is elsewhere now
    assert found.uniqueness == pytest.approx(1.01)


@pytest.mark.parametrize(("frames", "step"), [(20, 2.0), (40, 1.0), (40, 0.5)])
def test_windows_are_as_long_as_what_is_driven_and_have_a_place_for_each_frame(frames: int, step: float) -> None:
    costs, newest = np.full(100, 1500), np.full(100, 500)
    costs[50], costs[38], costs[62] = 1000, 1400, 1300
    newest[45], newest[80] = 300, 400
    found = match(costs, neighbors_by_route(2.0), newest, frames=frames, step=step)
    assert found.sharpness == pytest.approx(0.3), "of the line that ends 12 places further on"
    assert found.row_share == 0.0, "no place is more like the newest frame than the one 5 places back"


def test_without_meters_the_window_is_in_places() -> None:
    costs = np.full(100, 1500)
    costs[40], costs[43], costs[44] = 1000, 1001, 1250
    unknown = Neighborhood(np.full((100, 2), np.nan), UNKNOWN, np.zeros(100, dtype=np.int32), CONFIG)
    assert match(costs, unknown).uniqueness == pytest.approx(1.25)


@pytest.mark.parametrize(("beside_m", "uniqueness"), [(0.0, 1.5), (9.0, 1.5), (11.0, 1.001)])
def test_the_same_street_in_another_segment_is_not_elsewhere(beside_m: float, uniqueness: float) -> None:
    costs = np.full(100, 1500)
    costs[10], costs[60] = 1000, 1001
    segment_of = np.repeat(np.arange(2, dtype=np.int32), 50)
    position = np.tile(np.column_stack([np.arange(50) * 2.0, np.zeros(50)]), (2, 1))
    position[50:, 1] = beside_m
    route = np.tile(np.arange(50) * 2.0, 2)
    known = Neighborhood(position, route, segment_of, CONFIG)
    unknown = Neighborhood(np.full((100, 2), np.nan), route, segment_of, CONFIG)
    assert match(costs, known).uniqueness == pytest.approx(uniqueness)
    assert match(costs, unknown).uniqueness == pytest.approx(1.001)


@pytest.mark.parametrize("route", [UNKNOWN, np.arange(100) * 3.0])
def test_around_a_closed_lap_the_first_places_are_near_the_last(route: NDArray[np.float64]) -> None:
    """The last ten places are the first ones again."""
    segment_of = np.zeros(100, dtype=np.int32)
    lap = Neighborhood(np.full((100, 2), np.nan), route, segment_of, CONFIG, {0: 90})
    near = {1: [*range(5), *range(88, 95)], 60: range(57, 64), 97: [*range(4, 11), *range(94, 100)]}
    for place, expected in near.items():
        assert np.flatnonzero(lap.around(place)).tolist() == list(expected)


def test_nothing_is_claimed_where_there_is_nothing_to_compare_with() -> None:
    everything_near = msgspec.structs.replace(CONFIG, window_m=1e6)
    around = Neighborhood(np.zeros((100, 2)), UNKNOWN, np.zeros(100, dtype=np.int32), everything_near)
    found = match(np.arange(100.0)[::-1], around)
    assert found.uniqueness == 1.0


@pytest.mark.parametrize(("cheaper_at", "lowest"), [(1, 9), (2, 5), (4, 5), (5, 9)])
def test_a_neighbor_on_either_side_is_around_a_place(cheaper_at: int, lowest: int) -> None:
    row = np.full(7, 9, np.int32)
    row[cheaper_at] = 5
    assert lowest_around(row, 3, 8.0) == lowest


def test_hold_off_counts_from_the_last_event_that_passed() -> None:
    hold_off = HoldOff(1.0)
    assert [hold_off.passes(round(t * 1e9)) for t in (0.0, 0.5, 0.99, 1.0, 1.5, 2.0)] == [
        True,
        False,
        False,
        True,
        False,
        True,
    ]
    assert hold_off.passes(0)  # time went back: a new traverse
