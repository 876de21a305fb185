"""Blocks of places: nothing that a position allows is left out."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.reference_map.areas import Areas, widened


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), places=st.integers(1, 700), radius_m=st.floats(0, 300))
def test_every_place_within_the_radius_is_in_the_ranges(seed: int, places: int, radius_m: float) -> None:
    rng = np.random.default_rng(seed)
    east_north_m = rng.normal(size=(places, 2)).cumsum(axis=0) * 3
    east_north_m[rng.random(places) < 0.01] = np.nan
    centre = rng.normal(size=2) * 50
    ranges = Areas(east_north_m).within(centre, radius_m)
    inside = np.zeros(places, dtype=bool)
    for start, end in ranges:
        assert not inside[start:end].any()
        inside[start:end] = True
    with np.errstate(invalid="ignore"):
        must = ~(np.hypot(*(east_north_m - centre).T) > radius_m)
    assert inside[must].all()


def test_far_blocks_are_left_out() -> None:
    route = np.column_stack([np.arange(1000) * 2.0, np.zeros(1000)])
    assert Areas(route).within(np.array([1000.0, 5.0]), 50.0) == [(448, 576)]
    assert Areas(route).within(np.array([1000.0, 500.0]), 50.0) == []


def test_widening_merges_what_touches() -> None:
    assert widened([(100, 200), (230, 300), (900, 990)], 10, [0, 1000]) == [(80, 320), (880, 1000)]
    assert widened([(100, 200), (230, 300)], 10, [0, 220, 1000]) == [(80, 320)]
    assert widened([(100, 215), (240, 300)], 10, [0, 220, 1000]) == [(80, 320)]
    assert widened([(100, 200), (260, 300)], 10, [0, 210, 250, 1000]) == [(80, 210), (250, 320)]
