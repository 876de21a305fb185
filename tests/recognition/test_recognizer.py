"""The recognizer as a whole, on a street driven twice: warm-up, gaps, standing, off the map, both directions."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from edge.config import (
    AcceptanceConfig,
    CameraConfig,
    Config,
    DescriptorConfig,
    MapConfig,
    RigConfig,
    SamplingConfig,
    SequenceConfig,
)
from edge.descriptor.network import Network
from edge.errors import MapError
from edge.feed import Feed, FeedImages, read_feed
from edge.localization.place_fix import match_position
from edge.recognition.recognizer import PlaceRecognizer, model_key, network_for, open_recognizer
from edge.recognition.sequence_matcher import WAY_OUT_COUNTS_AS
from edge.reference_map import MapSet, Route
from edge.reference_map.store import ReferenceMap, open_map
from edge.sequence import MotionPrior, PlaceMatch
from edge_plugins.mapping.builder import Place
from sim.maps.command import build_map
from tests.map_of import map_of

LENGTH = 8
CONFIG = Config(
    sampling=SamplingConfig(by="frames"),
    sequence=SequenceConfig(length=LENGTH),
    acceptance=AcceptanceConfig(uniqueness_min=1.2, window_m=10.0, hold_off_s=0.0),
)
FRAME_NS = 50_000_000


@pytest.fixture(scope="module")
def street(write_traverse: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Feed:
    return read_feed(write_traverse(tmp_path_factory.mktemp("feeds") / "street", range(60)))


@pytest.fixture(scope="module")
def street_map(street: Feed, network: Network, tmp_path_factory: pytest.TempPathFactory) -> ReferenceMap:
    path = tmp_path_factory.mktemp("maps") / "street.map"
    build_map([street], path, CONFIG.descriptor, CONFIG.sampling, network=network)
    return open_map(path)


@pytest.fixture(scope="module")
def frames(write_traverse: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> list[np.ndarray]:
    """The same street on another day: with noise, and on beyond the map's end."""
    feed = read_feed(write_traverse(tmp_path_factory.mktemp("feeds") / "again", range(80), noise=6.0))
    images = FeedImages(feed)
    return [images.read(row) for row in range(80)]


def recognizer_of(network: Network, reference_map: ReferenceMap, config: Config = CONFIG) -> PlaceRecognizer:
    return open_recognizer(config, network=network, map_set=MapSet.of(reference_map))


Opened = Callable[..., PlaceRecognizer]
Frames = list[np.ndarray]


@pytest.fixture
def opened(network: Network, street_map: ReferenceMap) -> Opened:
    """Opens a recognizer on the map of the street, with another config."""
    return lambda config=CONFIG: recognizer_of(network, street_map, config)


def drive(recognizer: PlaceRecognizer, images: list[np.ndarray], start_ns: int = 0) -> list[PlaceMatch | None]:
    return [recognizer.observe(image, start_ns + row * FRAME_NS) for row, image in enumerate(images)]


def test_along_the_map(opened: Opened, street_map: ReferenceMap, frames: Frames) -> None:
    matches = drive(opened(), frames[:60])
    assert matches[: LENGTH - 1] == [None] * (LENGTH - 1)
    places = [match.place for match in matches if match]
    assert np.abs(np.array(places) - np.arange(LENGTH - 1, 60)).max() <= 1
    assert all(match.direction == "forward" and match.order == "same" for match in matches if match)
    last = matches[-1]
    assert last and last.accepted and last.event
    assert (last.map, last.place_index) == (None, last.place)
    position = match_position(last, Route(MapSet.of(street_map)), CONFIG.rig)
    assert position is not None
    assert position.lat_deg == pytest.approx(-27.0 + last.place * 2 / 110_800)
    assert position.heading_deg == 0.0


def test_backwards_along_the_map(opened: Opened, street_map: ReferenceMap, frames: Frames) -> None:
    # The camera looks back and drives home: the same view, the map in reverse.
    rear = msgspec.structs.replace(CONFIG, camera=CameraConfig(view="rear"), rig=RigConfig(ahead_reverse_same_m=4.0))
    matches = drive(opened(rear), frames[59:0:-1])
    last = matches[-1]
    assert last and last.accepted
    position = match_position(last, Route(MapSet.of(street_map)), rear.rig)
    assert position is not None
    assert (last.direction, last.order, position.heading_deg) == ("reverse", "same", 180.0)
    assert abs(last.place - 1) <= 1
    # The place lies 4 m ahead, which is towards the start: the vehicle is 2 places further along.
    assert position.lat_deg == pytest.approx(-27.0 + (last.place + 2) * 2 / 110_800)


def test_beyond_the_end_of_the_map_nothing_is_believed(opened: Opened, frames: Frames) -> None:
    recognizer = opened()
    matches = drive(recognizer, frames)
    assert recognizer.state == "off the map"
    assert not any(match.accepted for match in matches[60 + LENGTH :] if match)


def halt(recognizer: PlaceRecognizer, picture: np.ndarray, count: int) -> None:
    """Frames of a standing vehicle, each with its own noise."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        noisy = (picture + rng.normal(0, 1, picture.shape)).clip(0, 255).astype(np.uint8)
        assert recognizer.observe(noisy, 20 * FRAME_NS) is None
        assert recognizer.state == "standing"


def test_standing_still_changes_nothing(opened: Opened, frames: Frames) -> None:
    config = msgspec.structs.replace(CONFIG, sampling=SamplingConfig(by="time"))
    moving, halting = opened(config), opened(config)
    expected = drive(moving, frames[:30])
    drive(halting, frames[:20])
    halt(halting, frames[19], 30)
    assert drive(halting, frames[20:30], 21 * FRAME_NS)[-1] == expected[-1]


def test_a_line_leads_through_no_frame_that_stands_or_whose_distance_is_not_known(
    opened: Opened, frames: Frames
) -> None:
    config = msgspec.structs.replace(CONFIG, sampling=SamplingConfig(by="distance"))
    recognizer = opened(config)
    for index, (picture, driven_m, is_in_line) in enumerate(
        [(0, 0.0, True), (0, 0.2, False), (1, 2.0, True), (2, None, False), (3, 6.0, True)]
    ):
        recognizer.observe(frames[picture], index * FRAME_NS, MotionPrior(driven_m))
        assert recognizer.is_in_line == is_in_line, picture


def test_where_each_frame_is_a_place_one_that_looks_like_the_last_was_passed_without_a_frame(
    opened: Opened, frames: Frames
) -> None:
    recognizer, expected = opened(), opened()
    for one in (recognizer, expected):
        drive(one, frames[:20])
    halt(recognizer, frames[19], 3)
    found = recognizer.observe(frames[23], 23 * FRAME_NS)
    assert found == expected.observe(frames[23], 23 * FRAME_NS, MotionPrior(missed=3))
    assert recognizer.observe(frames[24], 24 * FRAME_NS) == expected.observe(frames[24], 24 * FRAME_NS), "once"


def test_a_vehicle_that_moved_does_not_stand_however_alike_its_pictures_are(opened: Opened, frames: Frames) -> None:
    recognizer = opened()
    for index in range(20):
        recognizer.observe(frames[index], index * FRAME_NS, MotionPrior(2.0 * index))
    recognizer.observe(frames[19], 20 * FRAME_NS, MotionPrior(38.1))
    assert recognizer.state == "standing"
    recognizer.observe(frames[19], 21 * FRAME_NS, MotionPrior(40.0))
    assert recognizer.state != "standing"


def test_a_vehicle_that_stands_is_searched_for_once_its_odometer_is_known(opened: Opened, frames: Frames) -> None:
    recognizer = opened(msgspec.structs.replace(CONFIG, sampling=SamplingConfig(by="distance")))
    for index, travel in enumerate((MotionPrior(), MotionPrior(7.0), MotionPrior(7.0))):
        recognizer.observe(frames[5], index * FRAME_NS, travel)
        assert recognizer.matcher.search.nearest(1).size == (index > 0)
    assert recognizer.state == "standing"


@pytest.mark.parametrize(("moved_m", "is_kept"), [(2.0, True), (60.0, False), (None, False), (-20.0, False)])
def test_a_long_halt_keeps_the_sequence_where_the_odometer_says_that_nothing_was_passed(
    opened: Opened, frames: Frames, moved_m: float | None, is_kept: bool
) -> None:
    recognizer = opened()
    for index in range(20):
        recognizer.observe(frames[index], index * FRAME_NS, MotionPrior(2.0 * index))
    after_m = None if moved_m is None else 38.0 + moved_m
    found = recognizer.observe(frames[20], 20 * FRAME_NS + 60 * 10**9, MotionPrior(after_m))
    assert (found is not None) == is_kept
    again = opened()
    for index in range(20):
        again.observe(frames[index], index * FRAME_NS, MotionPrior(2.0 * index))
    again.restart_odometer()
    assert again.observe(frames[20], 20 * FRAME_NS + 60 * 10**9, MotionPrior(40.0)) is None


@pytest.mark.parametrize(("shown", "is_carried"), [(26, False), (48, True)])
def test_a_vehicle_that_was_carried_while_its_wheels_stood_begins_anew(
    opened: Opened, frames: Frames, shown: int, is_carried: bool
) -> None:
    """After a halt of 10 s it shows the next place, or one that is 44 m further."""
    recognizer = opened()
    for index in range(26):
        recognizer.observe(frames[index], index * FRAME_NS, MotionPrior(2.0 * index))
    later_ns = 25 * FRAME_NS + 10_000_000_000
    match = recognizer.observe(frames[shown], later_ns, MotionPrior(52.0))
    assert recognizer.was_carried == is_carried
    assert (match is None) == is_carried, "no line has frames of both sides"
    recognizer.observe(frames[shown + 1], later_ns + FRAME_NS, MotionPrior(54.0))
    assert not recognizer.was_carried


@pytest.mark.parametrize(("further", "halt_ns", "is_carried"), [(8, 10_000_000_000, True), (16, 0, False)])
def test_a_halt_whose_end_was_not_seen_may_have_been_a_tow(
    opened: Opened, frames: Frames, further: int, halt_ns: int, is_carried: bool
) -> None:
    """The camera shows nothing for some places, which the vehicle passes at its usual pace, after a halt or without."""
    recognizer, period_ns = opened(), 250_000_000
    for index in range(26):
        recognizer.observe(frames[index], index * period_ns, MotionPrior(2.0 * index))
    now, missed = 25 + further, further - 1
    recognizer.observe(frames[now], now * period_ns + halt_ns, MotionPrior(2.0 * now, missed=missed))
    assert recognizer.was_carried == is_carried


def test_after_turning_around_no_line_goes_on_and_the_way_out_s_statistics_do(opened: Opened, frames: Frames) -> None:
    recognizer = opened()
    drive(recognizer, frames[:60] * 2)
    out = recognizer.matcher.statistics
    assert out is not None and out.count > 120
    recognizer.begin_way_back()
    after = recognizer.matcher.statistics
    assert after is not None and after.count == WAY_OUT_COUNTS_AS
    np.testing.assert_allclose((after.mean, after.deviation), (out.mean, out.deviation))
    back = drive(recognizer, frames[58:38:-1], 121 * FRAME_NS)
    assert [match is None for match in back] == [True] * (LENGTH - 1) + [False] * (20 - LENGTH + 1)


def test_places_passed_unseen_leave_room_in_the_line(opened: Opened, frames: Frames) -> None:
    """Three frames are lost on the way: every later line through the hole ends where the vehicle is."""
    recognizer = opened()
    drive(recognizer, frames[:20])
    rows = range(23, 23 + LENGTH)
    matches = [
        recognizer.observe(frames[row], row * FRAME_NS, MotionPrior(missed=3 if row == rows[0] else 0)) for row in rows
    ]
    assert [match.place for match in matches if match] == pytest.approx(list(rows), abs=1)


def test_lost_frames_leave_room_in_a_line(opened: Opened, frames: Frames) -> None:
    recognizer = opened()
    drive(recognizer, frames[:12])
    answer = recognizer.observe(frames[14], 14 * FRAME_NS, MotionPrior(missed=2))
    assert answer and abs(answer.place - 14) <= 1


def test_when_too_much_was_missed_a_sequence_begins_anew(opened: Opened, frames: Frames) -> None:
    recognizer = opened()
    drive(recognizer, frames[:20])
    assert recognizer.observe(frames[30], 30 * FRAME_NS, MotionPrior(missed=LENGTH // 2 + 1)) is None
    assert recognizer.state == "warming up"


@pytest.mark.parametrize("next_s", [100.0, -5.0])
def test_after_a_gap_a_sequence_begins_anew(opened: Opened, frames: Frames, next_s: float) -> None:
    recognizer = opened()
    drive(recognizer, frames[:20])
    after = drive(recognizer, frames[40:55], round(next_s * 1e9))
    assert after[: LENGTH - 1] == [None] * (LENGTH - 1)
    assert after[-1] and abs(after[-1].place - 54) <= 1


def test_regions_of_another_width(network: Network, street: Feed, frames: list[np.ndarray], tmp_path: Path) -> None:
    descriptor = DescriptorConfig(region_width=0.5)
    build_map([street], tmp_path / "m", descriptor, CONFIG.sampling, network=network)
    reference_map = open_map(tmp_path / "m")
    config = msgspec.structs.replace(CONFIG, descriptor=descriptor)
    matches = drive(recognizer_of(network, reference_map, config), frames[:60])
    places = np.array([match.place for match in matches[2 * LENGTH :] if match])
    assert (np.abs(places - np.arange(2 * LENGTH, 60)) <= 2).mean() > 0.9


def test_a_map_of_other_regions_is_refused(network: Network, street: Feed, tmp_path: Path) -> None:
    build_map([street], tmp_path / "m", DescriptorConfig(region_width=0.5), CONFIG.sampling, network=network)
    with pytest.raises(MapError, match=r"regions left-right of width 0\.5"):
        recognizer_of(network, open_map(tmp_path / "m"))
    raw = np.ones((2, 1, network.info.dimensions), np.float32)
    whole = map_of(tmp_path / "whole", raw, [Place(0), Place(1)], model=model_key(network))
    with pytest.raises(MapError, match=r"regions whole of width 1, but .* build the map again"):
        recognizer_of(network, whole)


def test_the_same_frames_give_the_same_answers(opened: Opened, frames: Frames) -> None:
    assert drive(opened(), frames) == drive(opened(), frames)


def test_a_config_that_names_no_network_goes_on_with_that_of_its_maps(
    street: Feed, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    grid = DescriptorConfig(model="grid")
    assert network_for(Config(map=MapConfig(path=str(tmp_path / "maps")))) == grid
    build_map([street], tmp_path / "maps/street", grid, SamplingConfig(by="frames"))
    for path in ("maps", "maps/street"):
        assert network_for(Config(map=MapConfig(path=str(tmp_path / path)))) == grid
    assert open_recognizer(Config(map=MapConfig(path=str(tmp_path / "maps")))).model_name == "grid"
    assert len([line for line in caplog.messages if "[descriptor] model is not set, so it is grid" in line]) == 1
    assert network_for(Config(descriptor=DescriptorConfig(model="fc6"))).model == "fc6"


def test_a_map_that_cannot_be_read_does_not_choose_the_network(street_map: ReferenceMap, tmp_path: Path) -> None:
    for name in ("a", "b"):
        shutil.copytree(street_map.path, tmp_path / name)
    config = Config(map=MapConfig(path=str(tmp_path)))
    expected = network_for(config).model
    (tmp_path / "a/map.json").write_text("{")
    assert network_for(config).model == expected == "fc6"
    (tmp_path / "b/map.json").write_text("{")
    assert network_for(config).model == "grid"
