"""Blocks of places: nothing that a position allows is left out."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.reference_map.spatial_index import MapBounds, SpatialIndex, apart_m, bounds_of, widened
from edge.reference_map.store import PLACE


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), places=st.integers(1, 700), radius_m=st.floats(0, 300))
def test_every_place_within_the_radius_is_in_the_ranges(seed: int, places: int, radius_m: float) -> None:
    rng = np.random.default_rng(seed)
    east_north_m = rng.normal(size=(places, 2)).cumsum(axis=0) * 3
    east_north_m[rng.random(places) < 0.01] = np.nan
    centre = rng.normal(size=2) * 50
    ranges = SpatialIndex(east_north_m).within(centre, radius_m)
    inside = np.zeros(places, dtype=bool)
    for start, end in ranges:
        assert not inside[start:end].any()
        inside[start:end] = True
    with np.errstate(invalid="ignore"):
        must = ~(np.hypot(*(east_north_m - centre).T) > radius_m)
    assert inside[must].all()


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    lat_deg=st.floats(-85, 85),
    lon_deg=st.sampled_from([0.0, 179.99, -179.995, 180.0, 77.7]),
    spread_deg=st.sampled_from([1e-4, 0.01, 0.3]),
    radius_m=st.floats(1, 50_000),
    around=st.sampled_from([-360, 0, 360]),
)
def test_a_map_is_near_if_any_of_its_places_is(
    seed: int, lat_deg: float, lon_deg: float, spread_deg: float, radius_m: float, around: int
) -> None:
    rng = np.random.default_rng(seed)
    places = np.zeros(20, dtype=PLACE)
    places["lat_deg"] = lat_deg + rng.uniform(-spread_deg, spread_deg, 20)
    places["lon_deg"] = (lon_deg + rng.uniform(-spread_deg, spread_deg, 20) + 180) % 360 - 180
    places["lat_deg"][:3] = np.nan
    lat, lon = lat_deg + rng.normal(0, 2 * spread_deg), lon_deg + rng.normal(0, 2 * spread_deg) + around
    known = places[3:]
    away_m = apart_m(lat, lon, known["lat_deg"], known["lon_deg"])
    nowhere = places[:3]
    areas = MapBounds([bounds_of(nowhere), bounds_of(places)])
    assert areas.are_known
    near, inside = areas.within(lat, lon, radius_m).tolist(), areas.inside(lat, lon, radius_m).tolist()
    assert near in ([], [1])
    assert inside in ([], [1])
    assert near or away_m.min() > radius_m
    assert not inside or away_m.max() <= radius_m + 1e-6
    assert near or not inside
    assert areas.within(lat, lon, 0.5 * away_m.min() - 50_000).tolist() == []
    assert not MapBounds([None]).are_known


def test_far_blocks_are_left_out() -> None:
    route = np.column_stack([np.arange(1000) * 2.0, np.zeros(1000)])
    assert SpatialIndex(route).within(np.array([1000.0, 5.0]), 50.0) == [(448, 576)]
    assert SpatialIndex(route).within(np.array([1000.0, 500.0]), 50.0) == []


def test_widening_merges_what_touches() -> None:
    assert widened([(100, 200), (230, 300), (900, 990)], 10, [0, 1000]) == [(80, 320), (880, 1000)]
    assert widened([(100, 200), (230, 300)], 10, [0, 220, 1000]) == [(80, 320)]
    assert widened([(100, 215), (240, 300)], 10, [0, 220, 1000]) == [(80, 320)]
    assert widened([(100, 200), (260, 300)], 10, [0, 210, 250, 1000]) == [(80, 210), (250, 320)]
