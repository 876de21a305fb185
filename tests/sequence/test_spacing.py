"""Frames that are not as far apart as the places of the map."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import Config, SamplingConfig
from edge.feed.sampling import Steps
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import ModelKey
from edge.sequence import MotionPrior
from edge_plugins.mapping.builder import Place
from sim.compare.temporary_map import MappedDrive, temporary_map

LENGTH_M, DIMENSIONS, NOISE = 600, 96, 1.0
ALIKE_M = 6
"""Meters within which the road shows about the same."""
NEAR_M = 10.0


@pytest.fixture(scope="module")
def road() -> NDArray[np.float32]:
    """What the road shows at each meter (LENGTH_M, 2, DIMENSIONS)."""
    rough = np.random.default_rng(3).normal(size=(LENGTH_M + ALIKE_M, 2, DIMENSIONS)).astype(np.float32)
    return np.abs(sum(rough[lag : LENGTH_M + lag] for lag in range(ALIKE_M)) / np.float32(ALIKE_M**0.5))


def frames_at_m(spacing_m: int, irregular: bool) -> NDArray[np.int64]:
    """Where frames are exposed on the second half of the road."""
    steps = np.random.default_rng(7).uniform(*((0.4, 1.6) if irregular else (1.0, 1.0)), 4 * LENGTH_M // spacing_m)
    at_m = LENGTH_M // 3 + np.cumsum(np.maximum(1, np.rint(spacing_m * steps))).astype(np.int64)
    return at_m[at_m < LENGTH_M]


@pytest.mark.parametrize("irregular", [False, True], ids=["regular", "irregular"])
@pytest.mark.parametrize("odometer", [1.0, 1.08])
@pytest.mark.parametrize(("map_m", "frame_m"), [(2, 4), (2, 1), (4, 1), (1, 4)])
def test_places_are_right_whatever_the_spacing(
    road: NDArray[np.float32], map_m: int, frame_m: int, odometer: float, irregular: bool
) -> None:
    """A straight line through places and frames would be four times too steep, or too flat."""
    mapped = road[::map_m]
    places = [Place(row, route_m=float(map_m * row)) for row in range(len(mapped))]
    config = Config(sampling=SamplingConfig(by="frames" if irregular else "distance", spacing_m=frame_m))
    rng = np.random.default_rng(1)
    at_m = frames_at_m(frame_m, irregular)
    with temporary_map([MappedDrive(mapped, places, "front")], ModelKey("m", "0" * 64, "fc6", DIMENSIONS)) as maps:
        matcher = SequenceMatcher(maps, config)
        found = []
        for here_m in at_m.tolist():
            raw = road[here_m] + rng.normal(scale=NOISE, size=road[here_m].shape).astype(np.float32)
            match = matcher.push(raw, MotionPrior(odometer * here_m))
            found.append(np.nan if match is None or not match.accepted else map_m * match.place_index - here_m)
    assert match is not None
    assert match.step == pytest.approx(odometer * frame_m / map_m, rel=0.15 if irregular else 0.01)
    believed = ~np.isnan(found)
    assert believed[len(found) // 2 :].mean() > 0.9
    assert np.nanmax(np.abs(found)) <= NEAR_M


def steps_of(sampling: SamplingConfig, odometer_m: list[float | None], missed: int = 0) -> list[float]:
    steps = Steps(sampling)
    return [steps.next(at_m, missed, 2.0) for at_m in odometer_m]


def test_frames_sampled_as_the_map_was_are_a_place_apart_though_each_is_a_little_late() -> None:
    late_m = np.random.default_rng(2).uniform(0, 0.3, 50)
    steps = steps_of(SamplingConfig(spacing_m=2.0), [2.0 * frame + late for frame, late in enumerate(late_m)])
    assert steps == [1.0] * 50


def test_a_frame_far_from_where_it_was_due_is_where_it_was_exposed() -> None:
    assert steps_of(SamplingConfig(spacing_m=2.0), [0.0, 2.0, 5.0, 6.0]) == [1.0, 1.0, 1.5, 0.5]


def test_steps_are_in_places_of_the_map() -> None:
    assert steps_of(SamplingConfig(spacing_m=4.0), [0.0, 4.1, 8.0, 16.2]) == [1.0, 2.0, 2.0, 4.0]
    assert steps_of(SamplingConfig(by="frames"), [0.0, 3.0, 4.0]) == [1.0, 1.5, 0.5]


def test_without_the_odometer_steps_are_as_usual() -> None:
    assert steps_of(SamplingConfig(by="frames"), [0.0, 6.0, None, 20.0]) == [1.0, 3.0, 3.0, 3.0]
    assert steps_of(SamplingConfig(spacing_m=4.0), [None, None]) == [1.0, 1.0], "sampled by time"
    assert steps_of(SamplingConfig(by="frames"), [None, None], missed=1) == [2.0, 2.0]
    restarted = steps_of(SamplingConfig(by="frames"), [10.0, 14.0, 1.0, 3.0])
    assert restarted == [1.0, 2.0, 2.0, 1.0]


def test_a_matcher_without_the_odometer_says_what_must_be_alike(road: NDArray[np.float32]) -> None:
    places = [Place(row, route_m=4.0 * row) for row in range(len(road[::4]))]
    config = Config(sampling=SamplingConfig(by="time"))
    model = ModelKey("made", "0" * 64, "fc6", DIMENSIONS)
    with temporary_map([MappedDrive(road[::4], places, "front")], model) as maps:
        matcher = SequenceMatcher(maps, config)
        lacks = []
        for raw in road[: config.sequence_frames]:
            matcher.push(raw)
            lacks.append(matcher.lacks_odometer)
        assert lacks == [False] * (config.sequence_frames - 1) + [True]
        assert matcher.spacing == "a frame every 0.5 s, and the map has a place every 4 m"
        matcher.push(road[0], MotionPrior(0.0))
        assert not matcher.lacks_odometer


def test_a_known_distance_is_not_missed_where_the_map_knows_no_meters(road: NDArray[np.float32]) -> None:
    """As on a first drive, whose map has no places yet: the pilot was warned that the speed is unknown."""
    model = ModelKey("made", "0" * 64, "fc6", DIMENSIONS)
    config, places = Config(), [Place(row) for row in range(len(road))]
    with temporary_map([MappedDrive(road, places, "front")], model) as maps:
        matcher = SequenceMatcher(maps, config)
        for row in range(config.sequence_frames):
            matcher.push(road[row], MotionPrior(float(row)))
            assert not matcher.lacks_odometer


def test_without_the_odometer_places_are_believed_on_each_of_two_drives_of_unequal_spacing(
    road: NDArray[np.float32],
) -> None:
    """A step counted in the mean of 1.5 m, where 4 m were driven: no place was believed though every line was right."""
    ways_m = [range(0, LENGTH_M // 2), range(LENGTH_M // 2, LENGTH_M, 4)]
    drives = [
        MappedDrive(road[way_m], [Place(row, route_m=float(at_m)) for row, at_m in enumerate(way_m)], "front")
        for way_m in ways_m
    ]
    rng, model = np.random.default_rng(1), ModelKey("m", "0" * 64, "fc6", DIMENSIONS)
    with temporary_map(drives, model) as maps:
        places_m = maps.places["route_m"]
        for way_m in ways_m:
            matcher, off_m = SequenceMatcher(maps, Config(sampling=SamplingConfig(by="time"))), []
            for here_m in way_m:
                raw = road[here_m] + rng.normal(scale=NOISE, size=road[here_m].shape)
                match = matcher.push(raw.astype(np.float32))
                if match is not None and match.accepted:
                    off_m.append(abs(places_m[match.place_index] - here_m))
            assert len(off_m) > len(way_m) / 4
            assert max(off_m) <= NEAR_M


@pytest.mark.parametrize(("map_m", "frame_m"), [(2, 1), (4, 1), (4, 2), (2, 4), (1, 4)])
def test_without_the_odometer_nothing_wrong_is_believed_at_another_spacing(
    road: NDArray[np.float32], map_m: int, frame_m: int
) -> None:
    """No line that is searched is as steep, or as flat: places would be ahead of the vehicle, or behind it."""
    places = [Place(row, route_m=float(map_m * row)) for row in range(len(road[::map_m]))]
    rng, model, far_m = np.random.default_rng(1), ModelKey("m", "0" * 64, "fc6", DIMENSIONS), []
    with temporary_map([MappedDrive(road[::map_m], places, "front")], model) as maps:
        matcher = SequenceMatcher(maps, Config(sampling=SamplingConfig(by="time")))
        for here_m in frames_at_m(frame_m, irregular=False).tolist():
            raw = road[here_m] + rng.normal(scale=NOISE, size=road[here_m].shape)
            match = matcher.push(raw.astype(np.float32))
            if match is not None and match.accepted and abs(map_m * match.place_index - here_m) > NEAR_M:
                far_m.append(map_m * match.place_index - here_m)
    assert not far_m


@pytest.mark.parametrize("before_m", [1, LENGTH_M // 2], ids=["at once", "under way"])
def test_a_hole_of_3_km_costs_no_memory_and_the_place_is_known_again(road: NDArray[np.float32], before_m: int) -> None:
    """The step over the hole counted as if each of the 40 rows were so far: every drive was padded by 126 km."""
    places, model = (
        [Place(row, route_m=float(row)) for row in range(LENGTH_M)],
        ModelKey("m", "0" * 64, "fc6", DIMENSIONS),
    )
    config, rng = Config(sampling=SamplingConfig(spacing_m=1.0)), np.random.default_rng(1)
    others = [MappedDrive(np.abs(rng.normal(size=road.shape)).astype(np.float32), places, "front") for _ in range(4)]
    with temporary_map([MappedDrive(road, places, "front"), *others], model) as maps:
        matcher, peaks, off_m = SequenceMatcher(maps, config), [], []
        tracemalloc.start()
        for hole_m, way_m in ((0, range(before_m)), (3000, range(100, 400))):
            tracemalloc.reset_peak()
            for here_m in way_m:
                raw = road[here_m] + rng.normal(scale=NOISE, size=road[here_m].shape)
                match = matcher.push(raw.astype(np.float32), MotionPrior(float(hole_m + here_m)))
                if hole_m:
                    off_m.append(abs(match.place - here_m) if match is not None and match.accepted else np.nan)
            peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert max(peaks) < 40e6
    assert np.nanmax(off_m) <= NEAR_M
    assert np.mean(~np.isnan(off_m[2 * config.sequence_frames :])) > 0.9


def test_room_for_a_frame_that_was_missed_is_given_back(road: NDArray[np.float32]) -> None:
    """Of what a hole of 16 m takes, over half, by the time that no line reaches back to it."""
    places, model = (
        [Place(row, route_m=float(row)) for row in range(LENGTH_M)],
        ModelKey("m", "0" * 64, "fc6", DIMENSIONS),
    )

    def held(first_m: range) -> NDArray[np.int64]:
        """Bytes after each frame: some, and those from 120 m on."""
        with temporary_map([MappedDrive(road, places, "front")], model) as maps:
            tracemalloc.start()
            matcher, found = SequenceMatcher(maps, Config(sampling=SamplingConfig(spacing_m=1.0))), []
            for here_m in (*first_m, *range(120, 300)):
                matcher.push(road[here_m], MotionPrior(float(here_m)))
                found.append(tracemalloc.get_traced_memory()[0])
            tracemalloc.stop()
        return np.array(found)

    held(range(115, 120))  # what is loaded once
    further = held(range(100, 105)) - held(range(115, 120))
    assert further[-1] < 0.5 * further.max()
