"""Positions in degrees and in meters, also at the edges of the earth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.geodesy import all_moved, apart_m, east_north, east_north_of, moved

ORIGIN = (-27.4772, 153.0283)
M_PER_DEG_EAST, M_PER_DEG_NORTH = 98_826.0, 110_802.0  # there, of WGS 84: NGA.STND.0036, radii of curvature


def test_meters_are_those_of_the_ellipsoid() -> None:
    east_m, north_m = east_north_of(ORIGIN[0] + 0.001, ORIGIN[1] + 0.001, ORIGIN)
    assert (east_m, north_m) == pytest.approx((M_PER_DEG_EAST / 1000, M_PER_DEG_NORTH / 1000), rel=1e-4)


@given(
    lat_deg=st.floats(-89, 89),
    lon_deg=st.floats(-180, 180),
    east_m=st.floats(-1e5, 1e5),
    north_m=st.floats(-1e5, 1e5),
    alt_m=st.floats(-400, 9000),
)
def test_a_way_leads_back(lat_deg: float, lon_deg: float, east_m: float, north_m: float, alt_m: float) -> None:
    there = moved(lat_deg, lon_deg, east_m, north_m, alt_m)
    assert east_north_of(*there, (lat_deg, lon_deg), alt_m) == pytest.approx((east_m, north_m), abs=1e-6)
    assert -180 <= there[1] <= 180


def test_all_positions_move_as_one_does() -> None:
    moves_m = np.array([(10.0, 0.0), (-3.0, 4.0), (0.0, 0.0), (math.nan, math.nan)])
    lats_deg, lons_deg = all_moved(np.full(4, ORIGIN[0]), np.full(4, ORIGIN[1]), moves_m)
    each = [moved(*ORIGIN, *move_m) for move_m in moves_m.tolist()]
    assert np.column_stack([lats_deg, lons_deg]) == pytest.approx(np.array(each), abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_arrays_of_any_length_stay_arrays(count: int) -> None:
    lats_deg, lons_deg = np.full(count, ORIGIN[0]), np.full(count, ORIGIN[1])
    assert east_north(lats_deg, lons_deg, ORIGIN).shape == (count, 2)
    assert apart_m(*ORIGIN, lats_deg, lons_deg).shape == (count,)
    assert [one.shape for one in all_moved(lats_deg, lons_deg, np.ones((count, 2)))] == [(count,), (count,)]


@pytest.mark.parametrize(("away_m", "at_most_m"), [(1000.0, 1e-5), (10_000.0, 0.005), (50_000.0, 0.6)])
def test_the_plane_and_the_shortest_ways_differ_by_as_much_as_is_said(away_m: float, at_most_m: float) -> None:
    ways_m = [(away_m * math.sin(angle), away_m * math.cos(angle)) for angle in range(6)]
    lats_deg, lons_deg = np.array([moved(*ORIGIN, *way_m) for way_m in ways_m]).T
    off_m = np.hypot(*(east_north(lats_deg, lons_deg, ORIGIN) - ways_m).T)
    assert off_m.max() <= at_most_m


def test_meters_are_longer_high_above_the_earth() -> None:
    there = moved(*ORIGIN, 1000.0, 0.0)
    assert math.hypot(*east_north_of(*there, ORIGIN, 3000.0)) == pytest.approx(1000.47, abs=0.01)


def test_across_the_antimeridian_it_is_west_again() -> None:
    assert moved(-17.0, 179.9999, 100.0, 0.0)[1] == pytest.approx(-179.99916, abs=1e-5)
    assert east_north_of(-17.0, -179.9999, (-17.0, 179.9999))[0] == pytest.approx(21.3, abs=0.1)


def test_what_is_not_known_stays_so() -> None:
    lat_deg, lon_deg = np.array([ORIGIN[0], math.nan]), np.array([ORIGIN[1], math.nan])
    assert np.isnan(east_north(lat_deg, lon_deg)).tolist() == [[False, False], [True, True]]
    assert np.isnan(east_north(lat_deg[1:], lon_deg[1:])).all()
    assert np.isnan(apart_m(*ORIGIN, lat_deg, lon_deg)).tolist() == [False, True]
    assert np.isnan([*east_north_of(math.nan, math.nan, ORIGIN), *moved(*ORIGIN, math.nan, 0.0)]).all()
    assert apart_m(*ORIGIN, lat_deg[:0], lon_deg[:0]).shape == (0,)


def test_the_far_side_of_the_earth_is_far_away() -> None:
    far_deg = np.array([0.0, 0.0, 0.5]), np.array([180.0, 179.5, -179.7])
    assert apart_m(0.0, 0.0, *far_deg).min() > 19.9e6
    assert math.hypot(*east_north_of(0.0, 180.0, (0.0, 0.0))) > 19.9e6
