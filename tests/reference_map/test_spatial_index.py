"""Blocks of places: nothing that a position allows is left out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.geodesy import apart_m
from edge.reference_map.place_index import widened
from edge.reference_map.place_records import PLACE
from edge.reference_map.spatial_index import SpatialIndex, bounds_of


def in_ranges(index: SpatialIndex, lat_deg: float, lon_deg: float, radius_m: float, places: int) -> np.ndarray:
    inside = np.zeros(places, dtype=bool)
    for start, end in index.within(lat_deg, lon_deg, radius_m):
        assert not inside[start:end].any()
        inside[start:end] = True
    return inside


def some_places(rng: np.random.Generator, lat_deg: float, lon_deg: float, step_deg: float, count: int) -> np.ndarray:
    """A drive that wanders about, some of it without positions."""
    places = np.zeros(count, dtype=PLACE)
    places["lat_deg"] = lat_deg + rng.normal(size=count).cumsum() * step_deg
    places["lon_deg"] = (lon_deg + rng.normal(size=count).cumsum() * step_deg + 180) % 360 - 180
    unknown = rng.random(count) < 0.01
    places["lat_deg"][unknown] = places["lon_deg"][unknown] = np.nan
    return places


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    counts=st.lists(st.integers(1, 300), min_size=1, max_size=3),
    lat_deg=st.floats(-80, 80),
    lon_deg=st.sampled_from([0.0, 179.9999, -179.9995, 180.0, 77.7]),
    step_deg=st.sampled_from([1e-5, 1e-3]),
    radius_m=st.floats(0, 5_000),
    around=st.sampled_from([-360, 0, 360]),
)
def test_every_place_within_the_radius_is_in_the_ranges(
    seed: int, counts: list[int], lat_deg: float, lon_deg: float, step_deg: float, radius_m: float, around: int
) -> None:
    rng = np.random.default_rng(seed)
    of_maps = [some_places(rng, lat_deg, lon_deg, step_deg, count) for count in counts]
    places = np.concatenate(of_maps)
    starts = np.cumsum([0, *counts]).tolist()
    index = SpatialIndex(places, [(*rows, bounds_of(one)) for rows, one in zip(pairwise(starts), of_maps, strict=True)])
    lat, lon = lat_deg + rng.normal() * 10 * step_deg, lon_deg + rng.normal() * 10 * step_deg + around
    inside = in_ranges(index, lat, lon, radius_m, len(places))
    known = ~np.isnan(places["lat_deg"])
    away_m = apart_m(lat, lon, places["lat_deg"][known], places["lon_deg"][known])
    assert inside[known][away_m <= radius_m].all()
    assert index.is_known == known.any()
    if known.any():
        assert not in_ranges(index, lat, lon + 90, 1000.0, len(places)).any()


def test_far_blocks_are_excluded() -> None:
    places = np.zeros(1000, dtype=PLACE)
    places["lat_deg"] = np.arange(1000) * 2.0 / 110_600
    index = SpatialIndex(places, [(0, 1000, bounds_of(places))])
    assert index.within(1000.0 / 110_600, 0.0, 50.0) == [(448, 576)]
    assert index.within(1000.0 / 110_600, 500.0 / 111_320, 50.0) == []


def test_widening_merges_what_touches() -> None:
    assert widened([(100, 200), (230, 300), (900, 990)], 10, [0, 1000]) == [(80, 320), (880, 1000)]
    assert widened([(100, 200), (230, 300)], 10, [0, 220, 1000]) == [(80, 320)]
    assert widened([(100, 215), (240, 300)], 10, [0, 220, 1000]) == [(80, 320)]
    assert widened([(100, 200), (260, 300)], 10, [0, 210, 250, 1000]) == [(80, 210), (250, 320)]
