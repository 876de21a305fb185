"""Places that are believed by keypoints: standing, from the second match on, in one direction, and of no other road."""

from __future__ import annotations

import dataclasses
import math
import shutil
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import Config, DescriptorConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.errors import MapError
from edge.feed import Feed, FeedImages, read_feed
from edge.geodesy import east_north
from edge.keypoints import Keypoints
from edge.keypoints.network import MOST, KeypointNetwork
from edge.recognition.keyframe_matcher import KeyframeMatcher
from edge.recognition.place_verification import PlaceVerification
from edge.recognition.recognizer import PlaceRecognizer, open_recognizer
from edge.reference_map import Drives, MapSet, open_map
from edge.reference_map.keypoint_file import KEYPOINT
from edge.reference_map.store import KEYPOINTS
from edge.sequence import DeadReckoningPosition, KeyframeMatch, MotionPrior, PlaceMatch
from edge.sequence.consensus import PlaceBelief
from edge_plugins.mapping.keypoint_rows import keypoints_key
from sim.maps.command import build_map
from tests.common import S

RECORDINGS = Path(__file__).parents[1] / "golden/recordings"
CONFIG = Config(descriptor=DescriptorConfig(model="grid"))
TWICE_DEG = 0.01
BESIDE_M = 9.0
"""Of the place, in another lane, of which a picture may be 8 m ahead or behind where the next one is not mapped."""


@pytest.fixture(scope="module")
def maps(grid: Network, make_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """Of the way out by day with a rear camera, and of another road."""
    return make_once("maps_with_keypoints", partial(_build, grid))


def _build(grid: Network, folder: Path) -> None:
    for name, feeds in {"street": ("out_first", "out_second"), "elsewhere": ("elsewhere",)}.items():
        _build_map(grid, [read_feed(RECORDINGS / feed) for feed in feeds], folder, name)


def _build_map(grid: Network, feeds: list[Feed], folder: Path, name: str = "map") -> None:
    build_map(
        feeds,
        folder / name,
        DescriptorConfig(model="grid"),
        SamplingConfig(),
        network=grid,
        keypoints=partial(keypoints_key, fov_deg=80.0),
    )


class Film:
    """Frames of a recording from one on."""

    def __init__(self, name: str, first: int = 0) -> None:
        feed = read_feed(RECORDINGS / name)
        self.rows = feed.rows[first:]
        images = FeedImages(feed)
        self.images = [images.read(row) for row in range(first, len(feed.rows))]
        images.close()

    def off_m(self, number: int, match: PlaceMatch, map_set: MapSet) -> float:
        """How far the place of a match is from where a frame was taken."""
        place, row = map_set.places[match.place_index], self.rows[number]
        assert row.lat_deg is not None and row.lon_deg is not None
        where = np.array([place["lat_deg"], row.lat_deg]), np.array([place["lon_deg"], row.lon_deg])
        return float(np.hypot(*np.diff(east_north(*where), axis=0)[0]))


def opened(path: Path, grid: Network, *, keypoints: bool = True) -> PlaceRecognizer:
    reference = open_map(path)
    if not keypoints:
        reference = dataclasses.replace(reference, header=reference.header.with_keypoints(None))
    return open_recognizer(CONFIG, network=grid, map_set=MapSet.of(reference))


def driven(
    recognizer: PlaceRecognizer, drive: Film, frames: int, *, backwards: bool = False
) -> list[PlaceMatch | None]:
    """The answers to frames; the course is that of the vehicle, or the opposite one."""
    answers = []
    for number in range(frames):
        heading_deg, distance_m = drive.rows[number].heading_deg, drive.rows[number].distance_m
        assert heading_deg is not None
        travel = MotionPrior(distance_m, course_rad=math.radians(heading_deg) + math.pi * backwards)
        answers.append(recognizer.observe(drive.images[number], number * S, travel))
    return answers


def known_at_rest(map_set: MapSet, grid: Network, spots: Iterable[int]) -> int:
    """How many spots on the way home are known by their second picture."""
    drive, known = Film("home_night"), 0
    for first in spots:
        recognizer = open_recognizer(CONFIG, network=grid, map_set=map_set)
        assert recognizer.observe(drive.images[first], 0, MotionPrior(7.0)) is None
        known += recognizer.verify_again(drive.images[first], S, MotionPrior(7.0)) is not None
    return known


def test_on_the_way_home_a_place_is_believed_after_meters_and_seen_from_where_the_vehicle_is(
    maps: Path, grid: Network
) -> None:
    drive = Film("home_night", 100)
    recognizer = opened(maps / "street", grid)
    believed = [(n, one) for n, one in enumerate(driven(recognizer, drive, 14)) if one is not None and one.accepted]
    assert believed and believed[0][0] <= 10
    for number, match in believed:
        assert (match.direction, match.order, match.has_line) == ("reverse", "same", False)
        assert drive.off_m(number, match, recognizer.map_set) < BESIDE_M
        assert recognizer.map_set.locate(match.place_index) == (match.map, match.place)
    seen = next(one.seen for _, one in believed if one.seen is not None)
    assert 2.0 < abs(seen.right_m) < 5.0, "in the other lane"
    assert abs(seen.ahead_m) < 2.0
    without = driven(opened(maps / "street", grid, keypoints=False), drive, 14)
    assert not [one for one in without if one is not None and one.accepted]


def test_a_vehicle_that_stands_knows_its_place_by_further_pictures(maps: Path, grid: Network) -> None:
    drive, standing = Film("home_night"), []
    for first in range(20, 140, 10):
        recognizer = opened(maps / "street", grid)
        at_m, image = MotionPrior(7.0), drive.images[first]
        assert recognizer.observe(image, 0, at_m) is None, "one match is not enough"
        assert not recognizer.may_verify_again(S // 2, 7.0), "nothing new yet"
        assert not recognizer.may_verify_again(S, 9.0), "it drives"
        assert recognizer.may_verify_again(S, 7.0)
        match = recognizer.verify_again(image, S, at_m)
        if match is not None:
            standing.append(drive.off_m(first, match, recognizer.map_set))
            assert match.accepted and match.event and recognizer.state == "on the map"
            correspondences, seen = recognizer.matcher.correspondences, match.seen
            assert correspondences is not None and seen is not None
            assert correspondences.place_index == seen.place_index and len(correspondences.shares) < seen.points
            assert 0.0 <= correspondences.shares.min() < correspondences.shares.max() <= 1.0
            assert not recognizer.may_verify_again(3 * S, 7.0), "it is known"
    assert len(standing) >= 10
    assert max(standing) < BESIDE_M


@pytest.fixture(scope="module")
def twice(grid: Network, make_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """A map that has one street twice, a kilometer apart."""
    once = read_feed(RECORDINGS / "out_second")
    rows = once.rows[:45]
    moved = tuple(dataclasses.replace(row, lat_deg=row.lat_deg + TWICE_DEG) for row in rows if row.lat_deg is not None)
    feeds = [dataclasses.replace(once, rows=one) for one in (rows, moved)]
    return make_once("street_twice", partial(_build_map, grid, feeds)) / "map"


def test_a_street_that_the_map_has_twice_is_known_by_no_keyframe(maps: Path, twice: Path, grid: Network) -> None:
    spots = range(45, 80, 8)
    assert known_at_rest(MapSet.of(open_map(maps / "street")), grid, spots) >= 3
    assert known_at_rest(MapSet.of(open_map(twice)), grid, spots) == 0


def _most(nearest: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    return nearest[:most]


def test_a_verification_that_cannot_tell_two_places_speaks_against_both(maps: Path, twice: Path) -> None:
    drive = Film("home_night", 53)
    for path, stays in ((maps / "street", True), (twice, False)):
        map_set = MapSet.of(open_map(path))
        drives, row = Drives(map_set, 2.0), drive.rows[0]
        assert row.lat_deg is not None and row.lon_deg is not None
        lat_deg, lon_deg = map_set.places["lat_deg"], map_set.places["lon_deg"]
        away_m = np.array(
            [np.hypot(*east_north(lat_deg - by, lon_deg, (row.lat_deg, row.lon_deg)).T) for by in (0.0, TWICE_DEG)]
        )
        there, nearest = int(away_m[0].argmin()), np.argsort(away_m.min(axis=0))
        votes = PlaceBelief(drives.drive_of(there), drives.along_m(there), "reverse", 0.93, is_believed=True)
        matcher = KeyframeMatcher(map_set, drives, CONFIG)
        for _ in range(2):
            matcher.verify(drive.images[0], partial(_most, nearest), MotionPrior(), 0.0, 0.0)
        answer = matcher.answer(votes, None, 0.0, BESIDE_M)
        assert (answer.votes is not None and answer.votes.is_believed) == stays


@pytest.mark.parametrize(("missing", "first"), [(slice(0, 42), 20), (slice(22, 62), 62)])
def test_past_the_end_of_the_map_and_in_a_gap_no_place_stays_believed(
    maps: Path, grid: Network, make_once: Callable[[str, Callable[[Path], object]], Path], missing: slice, first: int
) -> None:
    """The way home goes on from where the map began, or over a hole of 80 m."""
    once = read_feed(RECORDINGS / "out_second")
    rows = tuple(row for row in once.rows if row not in once.rows[missing])
    build = partial(_build_map, grid, [dataclasses.replace(once, rows=rows)])
    recognizer = opened(make_once(f"street_without_{missing.start}_to_{missing.stop}", build) / "map", grid)
    drive, believed = Film("home_night", first), 0
    for number, match in enumerate(driven(recognizer, drive, 50)):
        if match is not None and match.accepted:
            believed += 1
            assert drive.off_m(number, match, recognizer.map_set) < BESIDE_M + 3.0
    assert believed >= 8


def test_a_street_alike_counts_where_others_share_more_keypoints(twice: Path, grid: Network, tmp_path: Path) -> None:
    """Three streets have all the keypoints, in other places: no pose; a fourth is the street itself, with fewer."""
    streets = []
    for number, (mixed, kept) in enumerate(((slice(0), 285), (slice(90), 300), (slice(45), 300))):
        reference = open_map(shutil.copytree(twice, tmp_path / str(number)))
        records = np.memmap(reference.path / KEYPOINTS, KEYPOINT, "r+").reshape(len(reference.places), -1)
        records["descriptor"][mixed] = np.roll(records["descriptor"][mixed], 1, axis=1)
        records["descriptor"][:, kept:] = 0
        streets.append(dataclasses.replace(reference, places=reference.places.copy()))
        streets[-1].places["lat_deg"] += 2 * number * TWICE_DEG
    assert [known_at_rest(MapSet.of(several), grid, (53, 69)) for several in (streets[1:], streets)] == [2, 0]


class _Counted(KeypointNetwork):
    """Counts the pictures that are verified."""

    verified = 0

    def extract(self, image: NDArray[np.uint8], most: int = MOST) -> Keypoints:
        self.verified += 1
        return super().extract(image, most)


def test_what_stands_before_the_camera_at_first_hides_no_place(maps: Path, grid: Network) -> None:
    """Where it stays, three further pictures are verified, however they differ by noise."""
    drive, other, noise = Film("home_night"), Film("elsewhere").images[10], np.random.default_rng(0)
    known = 0
    for first in (20, 40, 60, 80, 100, 120):
        recognizer, network = opened(maps / "street", grid), _Counted()
        recognizer.matcher.use_keypoints(network)
        for second in range(12):
            image = other if second < 6 else drive.images[first]
            image = np.clip(image + noise.normal(0.0, 4.0, image.shape), 0, 255).astype(np.uint8)
            if second == 0:
                assert recognizer.observe(image, 0, MotionPrior(7.0)) is None
                continue
            assert recognizer.may_verify_again(second * S, 7.0)
            match = recognizer.verify_again(image, second * S, MotionPrior(7.0))
            if match is not None:
                assert second >= 6 and drive.off_m(first, match, recognizer.map_set) < BESIDE_M
                known += 1
                break
            assert network.verified <= 4 or second >= 6
    assert known >= 5


def test_where_it_is_reckoned_every_frame_is_verified_by_the_drives_beside_as_well(
    maps: Path, grid: Network, tmp_path: Path
) -> None:
    """Two maps of the street, one of which has no keypoints where the way home begins, and the other where it ends."""
    drive, switch = Film("home_night", 20), 105
    for others in (True, False):
        folder, streets = tmp_path / str(others), []
        for number, lost in enumerate((slice(switch), slice(switch, None))):
            reference = open_map(shutil.copytree(maps / "street", folder / str(number)))
            records = np.memmap(reference.path / KEYPOINTS, KEYPOINT, "r+").reshape(len(reference.places), -1)
            records["descriptor"][lost] = 0
            streets.append(reference)
        map_set = MapSet.of(streets if others else streets[:1])
        recognizer, network = open_recognizer(CONFIG, network=grid, map_set=map_set), _Counted()
        recognizer.matcher.use_keypoints(network)
        seen = [one is not None and one.seen is not None for one in driven(recognizer, drive, 60)]
        assert all(seen[5:]) if others else not any(seen[-20:])
        assert network.verified >= 55


@pytest.mark.parametrize("carried", [0, 12, 15])
def test_a_vehicle_that_is_carried_while_its_wheels_roll_is_noticed_within_15_m(
    maps: Path, grid: Network, carried: int
) -> None:
    """By 24 and 30 m: before, it was believed to be where its wheels had it for 40 m and more."""
    drive, recognizer, noticed = Film("home_night", 20), opened(maps / "street", grid), []
    first_m, last_m = (drive.rows[one].distance_m or 0.0 for one in (39, 39 + carried))
    for number in [*range(40), *range(40 + carried, 100)]:
        heading_deg, distance_m = drive.rows[number].heading_deg, drive.rows[number].distance_m or 0.0
        assert heading_deg is not None
        counted_m = distance_m - (last_m - first_m if number >= 40 else 0.0)
        travel = MotionPrior(counted_m, course_rad=math.radians(heading_deg))
        recognizer.observe(drive.images[number], number * S, travel)
        noticed += [counted_m - first_m] if recognizer.was_carried else []
    assert len(noticed) == bool(carried), "a gap of the map is none"
    assert all(0 < after_m <= 15.0 for after_m in noticed)
    assert recognizer.state == "on the map"


def test_a_position_by_gps_is_a_place_to_try_as_far_as_its_sigma_goes(maps: Path) -> None:
    map_set, drive = MapSet.of(open_map(maps / "street")), Film("home_night", 60)
    row = drive.rows[0]
    assert row.lat_deg is not None and row.lon_deg is not None
    for off_m, sigma_m, is_seen in ((0.0, 2.5, True), (9.0, 6.0, True), (0.0, 20.0, False), (120.0, 2.5, False)):
        matcher = KeyframeMatcher(map_set, Drives(map_set, 2.0), CONFIG)
        gps = DeadReckoningPosition(row.lat_deg + off_m / 111_000, row.lon_deg, sigma_m)
        matcher.verify(drive.images[0], lambda most: np.zeros(0, np.intp), MotionPrior(dead_reckoning=gps), 0.0, 0.0)
        assert (matcher.correspondences is not None) == is_seen


def test_a_drive_whose_views_are_alike_is_verified_beside_one_whose_views_are_opposite(maps: Path) -> None:
    street = open_map(maps / "street")
    front = tuple(replace(one, view="front") for one in street.header.segments)
    alike = dataclasses.replace(street, header=replace(street.header, segments=front))
    behind = PlaceMatch(40, 40, "reverse", "swapped", 1.0, 0.0, 1.0, accepted=True)
    for maps_there, is_due in (([alike], False), ([alike, street], True)):
        map_set = MapSet.of(maps_there)
        matcher = KeyframeMatcher(map_set, Drives(map_set, 2.0), CONFIG)
        matcher.follow(behind, 0.0, 0.0, 5.0)
        assert matcher.is_due(10.0) == is_due


def test_a_pose_by_search_is_no_worse_than_one_where_the_vehicle_is_reckoned(maps: Path) -> None:
    """From the pose by one keyframe alone, the local map's had 23 points where 36 agree, 4.8 m off."""
    map_set, film = MapSet.of(open_map(maps / "street", every_file=True)), Film("home_night", 90)
    found: list[KeyframeMatch] = []
    for places in (list(range(0, len(map_set.places), 4)), None):
        verification = PlaceVerification(CONFIG)
        verification.use_maps(map_set, Drives(map_set, 2.0))
        image = film.images[0]
        match = verification.verify(image, places) if places else verification.follow(image, [found[0].place_index])
        assert match is not None
        found.append(match)
    assert found[0].points == found[1].points >= 30


def test_the_next_pose_is_sought_after_a_meter(maps: Path, grid: Network) -> None:
    drive, recognizer, network = Film("home_night", 60), opened(maps / "street", grid), _Counted()
    recognizer.matcher.use_keypoints(network)
    recognizer.observe(drive.images[0], 0, MotionPrior(7.0))
    assert recognizer.verify_again(drive.images[0], S, MotionPrior(7.0)) is not None
    for number, (at_m, verified) in enumerate(((7.5, 2), (7.9, 2), (8.1, 3), (9.0, 3), (9.2, 4)), 1):
        match = recognizer.observe(drive.images[number % 2], (1 + number) * S, MotionPrior(at_m))
        assert match is not None and match.accepted
        assert network.verified == verified


def test_another_road_is_never_believed_by_keyframes(maps: Path, grid: Network) -> None:
    answers = driven(opened(maps / "elsewhere", grid), Film("home_night"), 40)
    assert not [one for one in answers if one is not None and (one.accepted or one.seen is not None)]


def test_opposite_views_never_load_the_network(maps: Path, grid: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """A front camera on a rear camera's map, the same way."""

    def opened_network(self: KeypointNetwork, name: str = "") -> None:
        raise AssertionError("loaded")

    monkeypatch.setattr(KeypointNetwork, "__init__", opened_network)
    drive = Film("again_dusk", 20)
    driven(opened(maps / "street", grid), drive, 12)
    with pytest.raises(AssertionError, match="loaded"):
        driven(opened(maps / "street", grid), drive, 12, backwards=True)


def test_keypoints_of_another_network_are_not_used(maps: Path, grid: Network) -> None:
    reference = open_map(maps / "street")
    key = reference.header.keypoints_key
    assert key is not None
    other = reference.header.with_keypoints(replace(key, sha256="0" * 64))
    recognizer = open_recognizer(CONFIG, network=grid, map_set=MapSet.of(dataclasses.replace(reference, header=other)))
    assert not recognizer.matcher.may_verify
    drive = Film("home_night", 100)
    assert not [one for one in driven(recognizer, drive, 12) if one is not None and one.accepted]


def test_a_file_of_keypoints_that_was_cut_off_is_named(maps: Path, grid: Network, tmp_path: Path) -> None:
    shutil.copytree(maps / "street", tmp_path / "map")
    recognizer, drive = opened(tmp_path / "map", grid), Film("home_night", 100)
    driven(recognizer, drive, 1)
    with (tmp_path / "map" / KEYPOINTS).open("r+b") as file:
        file.truncate(100)
    with pytest.raises(MapError, match=r"keypoints\.bin: cut off"):
        driven(recognizer, drive, 6)
