"""A front camera on a rear camera's map, which passes the same street the same way."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.network import Network
from edge.geodesy import east_north
from edge.keypoints.network import KeypointNetwork
from edge.recognition.structure_matcher import APART_M, StructureMatcher
from edge.reference_map import MapSet, open_map
from edge.sequence import PlaceMatch
from edge.structure import StructureMatch
from tests.recognition.test_keyframe_matcher import Film, _build

FROM_M = 7.0
"""By which the place that is believed is off."""


@pytest.fixture(scope="module")
def street(grid: Network, make_once: Callable[[str, Callable[[Path], object]], Path]) -> MapSet:
    return MapSet.of(open_map(make_once("maps_with_keypoints", partial(_build, grid)) / "street", every_file=True))


def driven(
    maps: MapSet, is_moved: bool = True, accepted: bool = True
) -> list[tuple[NDArray[np.float64], StructureMatch | None]]:
    """Meters east and north (2,) of each frame from the first place of the map, and its match."""
    film, network = Film("again_dusk"), KeypointNetwork()
    places = maps.places
    origin = float(places["lat_deg"][0]), float(places["lon_deg"][0])
    there = east_north(places["lat_deg"], places["lon_deg"], origin)
    matcher, found = StructureMatcher(maps, Config(), lambda: network), []
    for row, image in zip(film.rows, film.images, strict=True):
        assert row.lat_deg is not None and row.lon_deg is not None
        (here,) = east_north(np.array([row.lat_deg]), np.array([row.lon_deg]), origin)
        nearest = int(np.hypot(*(there - here).T).argmin())
        place = int(np.abs(places["route_m"] - places["route_m"][nearest] - FROM_M).argmin())
        believed = PlaceMatch(place, place, "forward", "swapped", 1.0, 0.0, 1.0, accepted=accepted)
        found.append((here, matcher.push(image, (here[0], here[1]) if is_moved else None, believed)))
    return found


def test_it_has_the_vehicle_to_a_meter_where_the_place_is_seven_meters_off(street: MapSet) -> None:
    places = street.places
    there = east_north(places["lat_deg"], places["lon_deg"], (float(places["lat_deg"][0]), float(places["lon_deg"][0])))
    frames, matches = driven(street), []
    for index, (_, seen) in enumerate(frames):
        if seen is None:
            continue
        before = int(index - seen.frames)
        share = index - seen.frames - before
        was = frames[before][0] + share * (frames[before + 1][0] - frames[before][0])
        heading = np.radians(float(places["heading_deg"][seen.place_index]))
        ahead = np.array([np.sin(heading), np.cos(heading)])
        left = np.array([-ahead[1], ahead[0]])
        off = there[seen.place_index] + seen.ahead_m * ahead + seen.left_m * left - was
        matches.append((index, off @ ahead, off @ left, *seen.sigma_m))
    index, along_m, left_m, *_ = np.array(matches).T
    assert len(matches) >= 3
    assert np.abs(along_m).max() < 2.0 and np.abs(left_m).max() < 2.0
    assert np.diff(index).min() * 2.0 >= APART_M - 2.0


def test_without_an_odometer_or_a_place_that_is_believed_there_is_no_match(street: MapSet) -> None:
    assert not any(seen for _, seen in driven(street, is_moved=False))
    assert not any(seen for _, seen in driven(street, accepted=False))
