"""Frames whose distance is not known, and holes between frames: what a line may lead through."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import Config, SamplingConfig
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import MapSet, ModelKey
from edge.sequence import MotionPrior
from edge.sequence.search import slopes_around_diagonal
from edge.sequence.submap import MEASURED_SLOPE_RAD, MEASURED_SLOPES
from edge_plugins.mapping.builder import Place
from sim.compare.temporary_map import MappedDrive, temporary_map

PLACES, DIMENSIONS, SPACING_M = 200, 256, 2.0
Floats = NDArray[np.float32]


class Views:
    """A road that was mapped, and what a drive back along it shows; each place resembles the next."""

    def __init__(self, seed: int) -> None:
        rng = self._rng = np.random.default_rng(seed)
        steps = rng.normal(size=(PLACES + 4, 2, DIMENSIONS)).astype(np.float32)
        self.map = sum((steps[lag : PLACES + lag] for lag in range(5)), np.zeros_like(steps[:PLACES])) / np.float32(5)
        self.places = range(180, 40, -1)

    def seen(self, place: int, *, signal: float) -> Floats:
        """While the vehicle is at a place of the map."""
        noise = self._rng.normal(scale=0.45, size=self.map[place].shape)
        return np.asarray(signal * self.map[place] + noise, dtype=np.float32)


@pytest.fixture
def road() -> Views:
    return Views(1)


@pytest.fixture
def maps(road: Views) -> Iterator[MapSet]:
    places = [Place(row, route_m=SPACING_M * row) for row in range(PLACES)]
    drive = MappedDrive(road.map, places, "rear")
    with temporary_map([drive], ModelKey("made", "0" * 64, "fc6", DIMENSIONS)) as found:
        yield found


@pytest.mark.parametrize(("by", "missed"), [("distance", 25), ("frames", 0)])
def test_a_hole_of_over_half_a_sequence_begins_a_new_one(
    road: Views, maps: MapSet, by: Literal["distance", "frames"], missed: int
) -> None:
    """Whether the camera or the odometer noticed it."""
    matcher, driven_m = SequenceMatcher(maps, Config(sampling=SamplingConfig(by=by))), 0.0
    for frame, place in enumerate(road.places[:60]):
        hole = frame == 50
        driven_m += 26 * SPACING_M if hole else SPACING_M
        match = matcher.push(road.seen(place, signal=1.0), MotionPrior(driven_m, missed=missed * hole))
        assert (match is None) == (frame < 15 or hole or frame > 50)


def test_frames_before_the_odometer_is_known_are_in_no_line(road: Views, maps: MapSet) -> None:
    """Nobody knows how far apart they are."""
    seen = [road.seen(place, signal=0.5) for place in road.places]

    def first_answers(unknown: range) -> list[int]:
        matcher, answered = SequenceMatcher(maps, Config()), []
        for frame, raw in enumerate(seen[:70]):
            match = matcher.push(raw, MotionPrior(None if frame in unknown else SPACING_M * frame))
            answered += [frame] if match is not None else []
        return answered

    known = first_answers(range(0))
    for unknown in (3, 30):
        assert first_answers(range(unknown)) == [frame for frame in known if frame >= known[0] + unknown]
    assert first_answers(range(40, 42)) == [frame for frame in known if frame not in (40, 41)], "they end nothing"

    matcher, of_odometer = SequenceMatcher(maps, Config()), slopes_around_diagonal(MEASURED_SLOPE_RAD, MEASURED_SLOPES)
    for frame, raw in enumerate(seen[:40]):
        match = matcher.push(raw, MotionPrior(None if frame < 3 else SPACING_M * frame))
        assert match is None or np.isclose(match.slope, of_odometer).any()
