"""Pictures that show nothing are found, in the right word, and those that show little are not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import cycle, pairwise, product
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.camera.picture_check import (
    ALIKE,
    COVERED,
    DARK,
    DAZZLED,
    FROZEN,
    Information,
    PictureFault,
    PictureFaultDetector,
)
from edge.config import SamplingConfig
from edge.feed import Feed, FeedImages, read_feed
from sim.traverse import traverse
from tests.common import S, picture_of

Image: TypeAlias = NDArray[np.uint8]
Floats: TypeAlias = NDArray[np.floating]
FEEDS = ("corridor_*", "track_*", "street_front_rear/*")


def noisy(seed: int) -> Image:
    """A picture with noise: another one for another seed."""
    return np.random.default_rng(seed).normal(picture_of(seed), 5).clip(0, 255).astype(np.uint8)


def watch(
    detector: PictureFaultDetector, images: Sequence[Image], speed_mps: float | None = 5.0, from_s: float = 0.0
) -> list[PictureFault | None]:
    """What is said of pictures that come five a second."""
    return [detector.check(image, round((from_s + index / 5) * S), speed_mps) for index, image in enumerate(images)]


@pytest.mark.parametrize(
    ("color", "word"),
    [((0, 0, 0), DARK), ((255, 255, 255), DAZZLED), ((0, 154, 0), COVERED)],
    ids=["black", "white", "zeros in YUV"],
)
def test_a_blank_picture_is_told_after_half_a_second_and_forgotten_with_the_next_good_one(
    color: tuple[int, int, int], word: str
) -> None:
    detector = PictureFaultDetector()
    told = watch(detector, [np.full((48, 64, 3), color, np.uint8)] * 6)
    assert [fault and fault.sure for fault in told] == [False] * 3 + [True] * 3, "and is not used from the first"
    assert told[-1] is not None
    assert told[-1].what == word
    assert watch(detector, [noisy(1)], from_s=1.2) == [None]


def test_a_frozen_picture_is_told_after_two_seconds_and_opened_again_with_growing_pauses() -> None:
    told = watch(PictureFaultDetector(), [noisy(0)] * 5 * 60, speed_mps=None)
    assert told[0] is None
    assert all(fault is not None and "frozen" in fault.what for fault in told[1:]), "the first repeat is not used"
    assert [fault and fault.sure for fault in told] == [None] + [False] * 9 + [True] * 290
    again_s = [index / 5 for index, fault in enumerate(told) if fault is not None and fault.reopen]
    assert again_s == [3, 9, 21, 45]


def test_a_vehicle_that_stands_sees_the_same_picture() -> None:
    detector = PictureFaultDetector(min_speed_mps=0.3)
    assert watch(detector, [noisy(0)] * 100, speed_mps=0.2) == [None] * 100
    assert {fault and fault.sure for fault in watch(detector, [noisy(0)] * 3, speed_mps=4.0, from_s=20)} == {False}
    assert watch(detector, [noisy(0)] * 100, speed_mps=None, from_s=22)[-1] is not None


def test_a_driver_that_gives_each_picture_twice_is_no_fault() -> None:
    told = watch(PictureFaultDetector(), [noisy(index // 2) for index in range(40)])
    assert [fault and fault.sure for fault in told] == [None, False] * 20


@pytest.fixture(scope="module")
def feeds(shared: Path) -> list[Feed]:
    """All recorded feeds."""
    return [read_feed(path) for pattern in FEEDS for path in sorted((shared / "feeds").glob(pattern))]


@pytest.fixture(scope="module")
def photographs(feeds: list[Feed]) -> list[Floats]:
    """Four pictures of each of the recorded feeds, evenly apart."""
    return [
        FeedImages(feed).read(index).astype(np.float32)
        for feed in feeds
        for index in np.linspace(0, len(feed.rows) - 1, 4).astype(int).tolist()
    ]


def test_no_recorded_picture_of_over_1_000_is_said_to_show_nothing(feeds: list[Feed]) -> None:
    said = [
        fault.what
        for feed in feeds
        for detector, images in [(PictureFaultDetector(0.3), FeedImages(feed))]
        for index, row in enumerate(feed.rows)
        if (fault := detector.check(images.read(index), row.stamp_ns, 0.0)) is not None
    ]
    assert (said, sum(len(feed.rows) for feed in feeds) > 1000) == ([], True)


def test_no_recorded_picture_is_said_to_be_the_one_from_which_the_vehicle_has_driven_on(feeds: list[Feed]) -> None:
    for feed in feeds:
        if all(row.distance_m is not None for row in feed.rows):
            used = list(traverse(feed, SamplingConfig(by="frames")))
            moved = [0, *(row.distance_m != before.distance_m for before, row in pairwise(feed.rows))]
            assert len(used) >= sum(moved), feed.path


@cache
def grain(shape: tuple[int, ...]) -> Floats:
    """The noise of a sensor, which demosaicing has smeared; its standard deviation is 1."""
    drawn = cv2.GaussianBlur(np.random.default_rng(7).normal(0, 1, shape).astype(np.float32), (0, 0), 0.8)
    return np.asarray(drawn / drawn.std())


def encoded(picture: Floats, noise: float, quality: int, rng: np.random.Generator) -> Image:
    """A picture with such noise, moved by chance, as a camera encodes it."""
    drawn = np.roll(grain(picture.shape), rng.integers(0, picture.shape[:2]), (0, 1))
    with_noise = (picture + noise * drawn).clip(0, 255).astype(np.uint8)
    jpeg = cv2.imencode(".jpg", with_noise, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8)


def hand(picture: Floats) -> Floats:
    """Red light through a hand on the lens, brighter toward one corner."""
    y, x = np.ogrid[0 : 1 : picture.shape[0] * 1j, 0 : 1 : picture.shape[1] * 1j]
    near = np.exp(-((x / 0.5) ** 2) - (y / 0.8) ** 2)
    return np.asarray((40 + 30 * near)[..., np.newaxis] * [0.6, 0.7, 1.6])


@pytest.mark.parametrize(
    ("blind", "word"),
    [
        (lambda picture: np.full_like(picture, 4), DARK),
        (lambda picture: np.full_like(picture, 250), DAZZLED),
        (lambda picture: np.full_like(picture, 120), COVERED),
        (hand, COVERED),
    ],
    ids=["dark", "white", "gray", "hand"],
)
def test_a_camera_that_goes_blind_is_told_in_one_word(
    photographs: list[Floats], blind: Callable[[Floats], Floats], word: str
) -> None:
    """Of 95 in 100 pictures, and never by another word; each after a picture that shows something."""
    rng, detector, told = np.random.default_rng(3), PictureFaultDetector(), []
    encodings = cycle(product((1.0, 3.0, 8.0), (95, 80)))
    for number, (picture, (noise, quality)) in enumerate(zip(photographs, encodings, strict=False)):
        shown = encoded(picture, 0.0, 95, rng), *(encoded(blind(picture), noise, quality, rng) for _ in range(3))
        told.append(watch(detector, shown, speed_mps=None, from_s=number))
    said = [[fault and fault.what for fault in four] for four in told]
    assert {one for four in said for one in four} == {word, None}
    assert [four[0] for four in said] == [None] * len(said)
    assert np.mean([four[-1] == word for four in said]) >= 0.95


@pytest.mark.parametrize(
    ("shown", "noise"),
    [
        (lambda picture: picture.mean() + 0.05 * (picture - picture.mean()), 0.5),
        (lambda picture: 0.1 * picture, 3.0),
        (lambda picture: 0.15 * picture + 0.85 * 220, 3.0),
        (lambda picture: cv2.GaussianBlur(picture, (0, 0), picture.shape[1] / 60), 3.0),
        (lambda picture: picture, 60.0),
    ],
    ids=["contrast", "dark", "fog", "blur", "noise"],
)
def test_a_picture_that_shows_little_is_used(
    photographs: list[Floats], shown: Callable[[Floats], Floats], noise: float
) -> None:
    """Those with a contrast of 5 in 100 are recognized, and were said to be blank."""
    rng = np.random.default_rng(4)
    little = (encoded(shown(picture), noise, 90, rng) for picture in photographs)
    assert np.mean([PictureFaultDetector().check(one, 0, None) is None for one in little]) >= 0.95


def test_windows_that_share_nothing_with_their_neighbors_are_no_noise() -> None:
    """Neighbors share nothing then: two such stretches of a road at night counted as a covered lens."""
    rng = np.random.default_rng(6)
    grays = 70 + rng.normal(0, 9, (24, 32))
    windows = np.kron(grays, np.ones((10, 10)))[..., None].repeat(3, axis=2).clip(0, 255).astype(np.uint8)
    assert Information.of(windows).alike < ALIKE
    assert PictureFaultDetector().check(windows, 0, None) is None


def test_an_old_picture_that_is_encoded_anew_is_frozen_once_the_vehicle_has_driven_4_m(
    photographs: list[Floats],
) -> None:
    rng, told = np.random.default_rng(5), []
    for picture in photographs:
        detector = PictureFaultDetector(0.3)
        stale = [encoded(1.1 * picture, 3.0, 50, rng) for _ in range(8)]
        assert watch(detector, stale[:4], speed_mps=0.0) == [None] * 4, "the vehicle stands"
        told.append([fault and fault.what for fault in watch(detector, stale[4:], speed_mps=10.0, from_s=0.8)])
    assert np.mean([one == [None, FROZEN, FROZEN, FROZEN] for one in told]) >= 0.95


@pytest.mark.parametrize("size", [(1, 5), (5, 9), (481, 643), (30, 3000)])
def test_pictures_of_any_size_are_checked(size: tuple[int, int]) -> None:
    coarse = [np.random.default_rng(seed).integers(0, 255, (6, 8, 3), np.uint8) for seed in (0, 0, 1)]
    images = [np.asarray(cv2.resize(one, size[::-1], interpolation=cv2.INTER_NEAREST), np.uint8) for one in coarse]
    answers = watch(PictureFaultDetector(), images)
    assert [fault and fault.what for fault in answers] == [None, FROZEN, None]
