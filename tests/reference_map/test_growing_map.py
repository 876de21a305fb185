"""A map that grows is searched as if it were whole: the same costs within a tolerance, at the same cost a place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import Config, SamplingConfig, SequenceConfig
from edge.descriptor.normalize import normalize
from edge.errors import MapError
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import COST_ONE, MapSet, ModelKey, RegionsKey, Route
from edge.sequence import MotionPrior
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.growing_map import GrowingMap
from tests.map_of import map_of

DIMENSIONS, SPACING_M = 256, 2.0
MODEL = ModelKey("test", "0" * 64, "fc6", DIMENSIONS)
REGIONS = RegionsKey("left-right", 0.4)
LENGTH = 10
CONFIG = Config(sequence=SequenceConfig(length=LENGTH))
TOLERANCE = 0.05
"""Of a cosine distance, the largest difference of any cost from that of the whole set; the mean is a tenth of it."""


def drive(places: int, seed: int = 0) -> NDArray[np.float32]:
    """Raw descriptors (N, 2, D) like fc6 after ReLU, neighbors alike, of a landscape that changes on the way."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(places + 2, 2, DIMENSIONS))
    landscape = np.linspace(0, 1, places)[:, np.newaxis, np.newaxis] * rng.normal(size=(1, 2, DIMENSIONS))
    return np.maximum(noise[:-2] + noise[1:-1] + noise[2:] + landscape, 0).astype(np.float32)


def place(row: int) -> Place:
    return Place(
        row, lat_deg=row * SPACING_M / 110_800, lon_deg=8.0, heading_deg=0.0, route_m=row * SPACING_M,
        position_sigma_m=1.0, position_source="gps",
    )  # fmt: skip


def grown(raw: NDArray[np.float32], path: Path = Path("drive"), capacity: int = 2000) -> GrowingMap:
    kept = raw.astype("<f2").astype(np.float32)

    def rows(wanted: Sequence[int]) -> NDArray[np.float32]:
        return kept[list(wanted)]

    growing = GrowingMap(path, MODEL, REGIONS, SamplingConfig(), rows, capacity=capacity)
    growing.begin_segment("drive", "front")
    for row, one in enumerate(raw):
        growing.add(one, place(row))
    return growing


def built(path: Path, raw: NDArray[np.float32]) -> MapSet:
    return MapSet.of(map_of(path, raw, map(place, range(len(raw)))))


@pytest.mark.parametrize("places", [2, 30, 200, 1500])
def test_costs_are_those_of_the_whole_set_within_the_tolerance(places: int, tmp_path: Path) -> None:
    raw = drive(places)
    growing, whole = grown(raw), built(tmp_path / "map", raw)
    mean, deviation = whole.maps[0].statistics()
    queries = normalize(np.roll(raw, 1, axis=2)[::7] + raw[::7], mean, deviation)
    so_far = MapSet.of(growing.first(places))
    everything = [(0, places)]
    off = np.abs(so_far.costs(queries, everything) - whole.costs(queries, everything)) / COST_ONE
    assert off.max() <= TOLERANCE
    assert off.mean() <= TOLERANCE / 10
    growing.renew()
    np.testing.assert_array_equal(so_far.maps[0].descriptors, whole.maps[0].descriptors)
    np.testing.assert_array_equal(so_far.costs(queries, everything), whole.costs(queries, everything))


def test_each_place_costs_as_many_rows_however_many_there_are() -> None:
    asked: list[int] = []
    raw = drive(600)

    def rows(wanted: Sequence[int]) -> NDArray[np.float32]:
        asked.append(len(wanted))
        return raw[list(wanted)]

    growing = GrowingMap(Path("drive"), MODEL, REGIONS, SamplingConfig(), rows, capacity=600)
    growing.begin_segment("drive", "front")
    for row, one in enumerate(raw):
        growing.add(one, place(row))
    assert set(asked[16:]) == {16}
    assert growing.is_full


def test_what_is_recognized_while_the_map_grows_is_what_the_whole_map_gives(tmp_path: Path) -> None:
    """A second lap over the first, of which more and more is searched, beside an old map of another road."""
    lap = drive(300)
    old, growing = built(tmp_path / "old", drive(100, seed=5)), grown(lap, tmp_path / "drive")
    queries = lap[:150] + np.random.default_rng(2).normal(0, 0.2, (150, 2, DIMENSIONS)).astype(np.float32)
    growing_matcher = SequenceMatcher(old.with_newest(growing.first(100)), CONFIG)
    whole_matcher = SequenceMatcher(old.with_newest(growing.first(300)), CONFIG)
    places = []
    for frame, query in enumerate(queries):
        one, another = (
            matcher.push(query, MotionPrior(frame * SPACING_M)) for matcher in (growing_matcher, whole_matcher)
        )
        if frame % 8 == 0:
            growing_matcher.grow(old.with_newest(growing.first(100 + frame)))
        if frame >= 2 * LENGTH:
            assert one is not None
            assert another is not None
            places.append((one.place_index - 100, another.place_index - 100, frame))
    ours, theirs, frames = np.array(places).T
    np.testing.assert_allclose(ours, theirs, atol=1)
    np.testing.assert_allclose(theirs, frames, atol=2)


def test_a_map_may_grow_before_a_new_sequence_has_a_frame() -> None:
    """As it does where the second camera's next frame comes later than the first one's."""
    raw = drive(100)
    growing = grown(raw)
    matcher = SequenceMatcher(MapSet.of([growing.first(80)], Path("maps")), CONFIG)
    for row in range(20):
        matcher.push(raw[row], MotionPrior(row * SPACING_M))
    matcher.reset()
    matcher.grow(matcher.map_set.with_newest(growing.first(96)))
    found = [matcher.push(raw[row], MotionPrior(row * SPACING_M)) for row in range(76, 96)]
    assert [one.place_index for one in found[LENGTH:] if one is not None] == list(range(76 + LENGTH, 96))


def test_growing_copies_no_place_that_was_there(tmp_path: Path) -> None:
    """A map of a million places took 0.3 s to grow by 16, in which no frame was recognized."""
    old, growing = built(tmp_path / "old", drive(100, seed=5)), grown(drive(300), tmp_path / "drive")
    before = MapSet.of(old.maps, tmp_path).with_newest(growing.first(100))
    after = before.with_newest(growing.first(150))
    assert np.shares_memory(before.places, after.places)
    afresh = MapSet.of([*old.maps, growing.first(150)], tmp_path)
    assert after.places.tobytes() == afresh.places.tobytes()
    assert (len(before.places), after.index.rows, after.laps) == (200, afresh.index.rows, afresh.laps)
    for lat_deg in np.linspace(0.0, 0.003, 20):
        for radius_m in (1.0, 100.0):
            assert after.blocks.within(lat_deg, 8.0, radius_m) == afresh.blocks.within(lat_deg, 8.0, radius_m)


def test_a_route_goes_on_as_the_map_does() -> None:
    growing = grown(drive(50))
    maps = MapSet.of([growing.first(20)], Path())
    route = Route(maps)
    assert route.drive(3).to_m == 19 * SPACING_M
    route.grow(maps.with_newest(growing.first(50)))
    assert route.drive(3).to_m == 49 * SPACING_M
    assert not route.reaches(3, 100.0)


def test_a_map_without_places_is_searched_without_an_answer() -> None:
    growing = grown(drive(0))
    maps = MapSet.of([growing.first(0)], Path())
    with pytest.raises(MapError, match="no place yet"):
        maps.maps[0].statistics()
    matcher = SequenceMatcher(maps, CONFIG)
    assert [matcher.push(raw) for raw in drive(30)] == [None] * 30


def test_drives_of_a_growing_map_are_its_segments() -> None:
    growing = grown(drive(5))
    growing.begin_segment("drive", "front")  # of which nothing came
    growing.begin_segment("drive", "rear")
    raw = drive(8)
    growing.add_all(raw[5:], [replace(place(row), row=row) for row in range(5, 8)])
    header = growing.first(7).header
    assert [(one.start, one.end, one.view) for one in header.segments] == [(0, 5, "front"), (5, 7, "rear")]
    assert [one.end for one in growing.first(5).header.segments] == [5]
