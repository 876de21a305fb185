"""Positions along a drive where longitudes jump, and where the map knows no heading."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pytest

from edge.geodesy import apart_m, east_north_of, moved
from edge.reference_map import MapSet, Route
from edge_plugins.mapping.builder import NAN, Place
from tests.map_of import map_of

SPACING_M = 20.0


def route_of(path: Path, places: list[Place], starts: Collection[int] = (0,)) -> Route:
    raw = np.random.default_rng(0).random((len(places), 1, 4))
    return Route(MapSet.of(map_of(path, raw, places, starts=starts)))


def drive_east(path: Path, lat_deg: float, lon_deg: float, *, heading_deg: float = 90.0, places: int = 11) -> Route:
    """The route of a map of one drive going east, of which that longitude is the middle."""
    driven = []
    for index in range(places):
        lat, lon = moved(lat_deg, lon_deg, (index - places // 2) * SPACING_M, 0.0)
        lon = (lon + 180) % 360 - 180
        driven.append(Place(index, lat, lon, heading_deg=heading_deg, route_m=index * SPACING_M))
    return route_of(path, driven)


@pytest.mark.parametrize("lon_deg", [180.0, -179.9999, 179.9999, 0.0, 12.0])
def test_positions_across_the_antimeridian(tmp_path: Path, lon_deg: float) -> None:
    route = drive_east(tmp_path / "map", -17.0, lon_deg)
    for offset_m in np.linspace(-100, 100, 41):
        position = route.position(5, float(offset_m))
        assert position is not None
        assert -180 <= position.lon_deg <= 180
        east_m, north_m = east_north_of(position.lat_deg, position.lon_deg, (-17.0, lon_deg))
        assert (east_m, north_m) == pytest.approx((offset_m, 0.0), abs=0.01)


def test_the_heading_of_a_map_without_any_is_the_course_of_its_drive(tmp_path: Path) -> None:
    route = drive_east(tmp_path / "map", -17.0, 180.0, heading_deg=NAN)
    for place in range(11):
        for offset_m in (0.0, 3.0, -500.0):
            position = route.position(place, offset_m)
            assert position is not None
            assert position.heading_deg == pytest.approx(90.0, abs=0.1)


def test_a_heading_that_nobody_knows_is_none(tmp_path: Path) -> None:
    """All places at one spot, as where a vehicle stood, or no meters along the drive: no course."""
    places = [Place(row, 1.0, 2.0, route_m=route_m) for row, route_m in enumerate((0.0, 1.0, NAN, NAN))]
    route = route_of(tmp_path / "map", places, starts=(0, 2))
    for place in range(4):
        position = route.position(place, 0.5)
        assert position is not None
        assert apart_m(1.0, 2.0, np.array([position.lat_deg]), np.array([position.lon_deg]))[0] < 1e-6
        assert position.heading_deg is None


def test_a_line_is_as_long_as_its_steps_are_on_average(tmp_path: Path) -> None:
    """As of a video: most steps are 2.06 m, some shorter, and one is a gap. A median would be 39 times 6 cm off."""
    steps_m = [2.06, 2.06, 1.88, 2.06, 1.94] * 20
    route_m = np.cumsum([0.0, *steps_m[:50], 30.0, *steps_m[50:]])
    places = [
        Place(index, *moved(-17.0, 30.0, along_m, 0.0), heading_deg=90.0, route_m=along_m)
        for index, along_m in enumerate(route_m.tolist())
    ]
    assert route_of(tmp_path / "map", places).drive(0).spacing_m == pytest.approx(2.0, abs=1e-6)
