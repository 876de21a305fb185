"""A front camera on a rear camera's map, which passes the same street the same way."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from edge.config import CameraConfig, Config
from edge.descriptor.network import Network
from edge.feed import read_feed
from edge.keypoints.network import KeypointNetwork
from edge.recognition.structure_matcher import APART_M, StructureMatcher
from edge.reference_map import MapSet, open_map
from edge.sequence import PlaceMatch
from edge.structure import StructureMatch
from sim.research.evaluation.structure import DriveTruth
from tests.recognition.test_keyframe_matcher import RECORDINGS, Film, _build

BELIEVED_OFF_M = 7.0
SURE = 1.1
"""Uniqueness of a vote."""
LEAVES_M = 255.0
"""Along the drive of the map, where the vehicle leaves it."""


@pytest.fixture(scope="module")
def street(grid: Network, make_once: Callable[[str, Callable[[Path], object]], Path]) -> MapSet:
    return MapSet.of(open_map(make_once("maps_with_keypoints", partial(_build, grid)) / "street", every_file=True))


def driven(
    maps: MapSet, truth: DriveTruth, *, is_moved: bool = True, accepted: bool = True
) -> dict[int, StructureMatch]:
    """The matches, by their frames, while the vehicle is on the first drive of the map."""
    film, network = Film("again_dusk"), KeypointNetwork()
    matcher, found = StructureMatcher(maps, Config(), lambda: network), dict[int, StructureMatch]()
    for index, image in enumerate(film.images[: int(truth.along_m.argmax())]):
        place = int(np.abs(truth.route_m - truth.along_m[index] - BELIEVED_OFF_M).argmin())
        believed = PlaceMatch(place, place, "forward", "swapped", 1.0, 0.0, 1.0, accepted=accepted)
        ground_m = float(truth.ground_m[index, 0]), float(truth.ground_m[index, 1])
        matcher.add(image, ground_m if is_moved else None)
        seen = matcher.match(believed)
        found |= {} if seen is None else {index: seen}
    return found


def test_it_has_the_vehicle_to_a_meter_where_the_place_is_seven_meters_off(street: MapSet) -> None:
    truth = DriveTruth(street, read_feed(RECORDINGS / "again_dusk"))
    matches = driven(street, truth)
    assert len(matches) >= 3 and np.diff([truth.driven_m[index] for index in matches]).min() >= APART_M - 0.1
    off = np.array([truth.off(index, seen) for index, seen in matches.items()])
    assert np.abs(off[:, :2]).max() < 1.5 and np.abs(off[:, :2] / off[:, 2:]).max() < 3.0


def test_without_an_odometer_or_a_place_that_is_believed_there_is_no_match(street: MapSet) -> None:
    truth = DriveTruth(street, read_feed(RECORDINGS / "again_dusk"))
    assert not driven(street, truth, is_moved=False)
    assert not driven(street, truth, accepted=False)


def votes(maps: MapSet, config: Config) -> list[tuple[float, PlaceMatch]]:
    """Where the vehicle was, and its votes, on the first drive of the map."""
    film, network, truth = Film("again_dusk"), KeypointNetwork(), DriveTruth(maps, read_feed(RECORDINGS / "again_dusk"))
    matcher, found = StructureMatcher(maps, config, lambda: network), []
    for index, image in enumerate(film.images[: int(truth.along_m.argmax())]):
        vote = matcher.add(image, (float(truth.ground_m[index, 0]), float(truth.ground_m[index, 1])))
        found += [] if vote is None else [(float(truth.along_m[index]), vote)]
    return found


def test_it_votes_for_the_place_without_any_that_is_believed(street: MapSet) -> None:
    found = votes(street, Config())
    assert {vote.direction for _, vote in found} == {"forward"}
    route_m = street.places["route_m"]
    sure = [(along_m, float(route_m[vote.place_index])) for along_m, vote in found if vote.uniqueness > SURE]
    off_m = [place_m - along_m for along_m, place_m in sure if along_m < LEAVES_M]
    assert len(off_m) >= 10 and np.abs(off_m).max() < 10.0


def test_votes_are_unsure_where_the_vehicle_passes_nothing_of_the_map(street: MapSet) -> None:
    """As far as it knows its camera is the map's, so that it looks for the way back, and drives the same way again."""
    found = votes(street, Config(camera=CameraConfig(view="rear")))
    assert {vote.direction for _, vote in found} == {"reverse"}
    assert not any(vote.uniqueness > SURE for _, vote in found)


def test_a_map_that_is_too_large_for_votes_gets_none(street: MapSet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.recognition.structure_search.MOST_PLACES", len(street.places) - 1)
    assert not votes(street, Config())
