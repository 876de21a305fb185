"""Two cameras on one map: the second one votes for the place where a line of the first one would end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import CameraConfig, Config, MappingConfig, RigConfig, SamplingConfig
from edge.feed import View
from edge.reference_map import MapSet, ModelKey
from edge.reference_map.builder import Place
from edge.sequence import PlaceMatch, Travel
from edge.sequence.place_search import MEASURED_SLOPE_RAD, MEASURED_SLOPES
from edge.sequence.search import slopes_around_diagonal
from edge.sequence_matcher import SequenceMatcher
from sim.research.evaluation.temporary_map import MappedDrive, temporary_map

PLACES, DIMENSIONS, SPACING_M = 200, 256, 2.0
AHEAD_PLACES = 10
"""How far ahead the place lies that the first camera recognizes from behind, where the second one sees it as mapped."""
Floats = NDArray[np.float32]
SIGNAL = {True: 1.0, False: 0.45}


class Road:
    """A road mapped by the rear camera, and what both cameras see on a drive along it; each place resembles the next.

    A camera sees a place from behind with left and right exchanged, weakly, and from elsewhere.
    """

    def __init__(self, way: Literal["forward", "reverse"], seed: int) -> None:
        rng = self._rng = np.random.default_rng(seed)
        steps = rng.normal(size=(PLACES + 4, 2, DIMENSIONS)).astype(np.float32)
        self.map = sum((steps[lag : PLACES + lag] for lag in range(5)), np.zeros_like(steps[:PLACES])) / np.float32(5)
        self._way = way
        self.places = range(20, 160) if way == "forward" else range(180, 40, -1)

    def seen(self, place: int, view: View, *, signal: float) -> Floats:
        """By one of the cameras while the vehicle is at a place of the map."""
        looks_as_mapped = (view == "rear") == (self._way == "forward")
        if looks_as_mapped:
            shown = self.map[place]
        else:
            sign = 1 if (view == "front") == (self._way == "forward") else -1
            shown = self.map[place + sign * (AHEAD_PLACES if self._way == "forward" else -AHEAD_PLACES), ::-1]
        noise = self._rng.normal(scale=0.45, size=shown.shape)
        return np.asarray(signal * shown + noise, dtype=np.float32)


@pytest.fixture
def road(request: pytest.FixtureRequest) -> Road:
    return Road(*request.param)


@pytest.fixture
def maps(road: Road) -> Iterator[MapSet]:
    config = Config()
    places = [Place(row, route_m=SPACING_M * row) for row in range(PLACES)]
    drive = MappedDrive(road.map, places, "rear")
    with temporary_map([drive], ModelKey("made", "0" * 64, "fc6", DIMENSIONS), config.descriptor) as found:
        yield found


def drive(road: Road, maps: MapSet, *, recognize: bool, signal: float, second: float = 1.0) -> list[PlaceMatch | None]:
    """The answers; both cameras expose at one moment. signal, second: how much the two see of the road."""
    rig = RigConfig(ahead_forward_swapped_m=AHEAD_PLACES * SPACING_M)
    camera = CameraConfig(view="rear")
    mapping = MappingConfig(folder="maps", recognize=recognize, camera=camera)
    matcher = SequenceMatcher(maps, Config(rig=rig, mapping=mapping))
    answers = []
    for frame, place in enumerate(road.places):
        driven_m = SPACING_M * frame
        if recognize:
            matcher.push_second(road.seen(place, "rear", signal=second), Travel(driven_m))
        answers.append(matcher.push(road.seen(place, "front", signal=signal), Travel(driven_m)))
    return answers


def accepted(answers: list[PlaceMatch | None]) -> list[int]:
    return [frame for frame, match in enumerate(answers) if match is not None and match.accepted]


@pytest.mark.parametrize("road", [("forward", 1)], indirect=True)
def test_a_road_is_believed_sooner_where_the_second_camera_sees_it_as_it_was_mapped(road: Road, maps: MapSet) -> None:
    alone = accepted(drive(road, maps, recognize=False, signal=0.05))
    answers = drive(road, maps, recognize=True, signal=0.05)
    both = accepted(answers)
    assert both
    assert len(both) > len(alone) + 25
    for frame in both:
        match = answers[frame]
        assert match is not None
        assert (match.direction, match.order) == ("forward", "swapped"), "a line of the first camera"
        assert abs(match.place - road.places[frame] - AHEAD_PLACES) <= 10


@pytest.mark.parametrize("road", [("reverse", 1)], indirect=True)
def test_on_the_way_home_the_second_camera_changes_little(road: Road, maps: MapSet) -> None:
    alone = accepted(drive(road, maps, recognize=False, signal=0.5))
    both = accepted(drive(road, maps, recognize=True, signal=0.5))
    assert len(alone) > 50
    assert len(both) >= len(alone) - 10


@pytest.mark.parametrize("road", [("forward", seed) for seed in (1, 4, 9, 18)], indirect=True)
def test_a_first_camera_that_sees_nothing_is_not_followed(road: Road, maps: MapSet) -> None:
    """On three of these roads its matches agree with the second camera's for a while, by chance."""
    assert not accepted(drive(road, maps, recognize=True, signal=0.0))


@pytest.mark.parametrize("road", [("forward", 1)], indirect=True)
@pytest.mark.parametrize(("missed", "begins_anew"), [(19, False), (25, True)])
def test_half_a_sequence_that_was_missed_begins_the_second_cameras_anew(
    road: Road, maps: MapSet, missed: int, begins_anew: bool
) -> None:
    """As long a one as of the first camera, although it has half as many frames. The first one's goes on."""
    mapping = MappingConfig(folder="maps", recognize=True, camera=CameraConfig(view="rear"))
    matcher = SequenceMatcher(maps, Config(mapping=mapping))
    found = []
    for frame, place in enumerate(road.places):
        lost = missed if frame == 60 else 0
        found.append(matcher.push_second(road.seen(place, "rear", signal=1.0), Travel(SPACING_M * frame, missed=lost)))
        matcher.push(road.seen(place, "front", signal=1.0), Travel(SPACING_M * frame))
    assert found[58] is not None
    assert (found[60] is None) == begins_anew
    assert matcher.best is not None


@pytest.mark.parametrize("road", [("reverse", 1)], indirect=True)
@pytest.mark.parametrize(("by", "missed"), [("distance", 25), ("frames", 0)])
def test_a_hole_of_over_half_a_sequence_begins_a_new_one(
    road: Road, maps: MapSet, by: Literal["distance", "frames"], missed: int
) -> None:
    """Whether the camera or the odometer noticed it."""
    matcher, driven_m = SequenceMatcher(maps, Config(sampling=SamplingConfig(by=by))), 0.0
    for frame, place in enumerate(road.places[:60]):
        hole = frame == 50
        driven_m += 26 * SPACING_M if hole else SPACING_M
        match = matcher.push(road.seen(place, "front", signal=1.0), Travel(driven_m, missed=missed * hole))
        assert (match is None) == (frame < 15 or hole or frame > 50)


@pytest.mark.parametrize("road", [("reverse", 1)], indirect=True)
def test_frames_before_the_odometer_is_known_are_in_no_line(road: Road, maps: MapSet) -> None:
    """Nobody knows how far apart they are."""
    seen = [road.seen(place, "front", signal=0.5) for place in road.places]

    def first_answers(unknown: range) -> list[int]:
        matcher, answered = SequenceMatcher(maps, Config()), []
        for frame, raw in enumerate(seen[:70]):
            match = matcher.push(raw, Travel(None if frame in unknown else SPACING_M * frame))
            answered += [frame] if match is not None else []
        return answered

    known = first_answers(range(0))
    for unknown in (3, 30):
        assert first_answers(range(unknown)) == [frame for frame in known if frame >= known[0] + unknown]
    assert first_answers(range(40, 42)) == [frame for frame in known if frame not in (40, 41)], "they end nothing"

    matcher, of_odometer = SequenceMatcher(maps, Config()), slopes_around_diagonal(MEASURED_SLOPE_RAD, MEASURED_SLOPES)
    for frame, raw in enumerate(seen[:40]):
        match = matcher.push(raw, Travel(None if frame < 3 else SPACING_M * frame))
        assert match is None or np.isclose(match.slope, of_odometer).any()
