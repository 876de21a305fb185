"""Pictures that show nothing are found, and those that show little are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.camera.picture_check import (
    BLANK,
    BLANK_DEVIATION,
    FROZEN,
    STEP_PX,
    FrozenPictureDetector,
    PictureFault,
)
from edge.feed import FeedImages, read_feed
from tests.common import S


def noisy(seed: int, level: float = 100.0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).normal(level, 5, (48, 64, 3)).clip(0, 255).astype(np.uint8)


def watch(
    watch: FrozenPictureDetector, images: list[NDArray[np.uint8]], moves: bool | None = True, from_s: float = 0.0
) -> list[PictureFault | None]:
    """What is said of pictures that come five a second."""
    return [watch.check(image, round((from_s + index / 5) * S), moves) for index, image in enumerate(images)]


def test_pictures_that_differ_only_by_noise_are_sound() -> None:
    assert watch(FrozenPictureDetector(), [noisy(seed) for seed in range(100)]) == [None] * 100


@pytest.mark.parametrize("color", [(0, 0, 0), (255, 255, 255), (0, 154, 0)], ids=["black", "white", "zeros in YUV"])
def test_a_blank_picture_is_told_after_half_a_second_and_forgotten_with_the_next_good_one(
    color: tuple[int, int, int],
) -> None:
    eyes = FrozenPictureDetector()
    blank = np.full((48, 64, 3), color, np.uint8)
    told = watch(eyes, [blank] * 6)
    assert [fault and fault.sure for fault in told] == [False] * 3 + [True] * 3, "and is not used from the first"
    assert told[-1] is not None
    assert "blank" in told[-1].what
    assert watch(eyes, [noisy(1)], from_s=1.2) == [None]


def test_a_frozen_picture_is_told_after_two_seconds_and_opened_again_with_growing_pauses() -> None:
    told = watch(FrozenPictureDetector(), [noisy(0)] * 5 * 60)
    assert told[0] is None
    assert all(fault is not None and "frozen" in fault.what for fault in told[1:]), "the first repeat is not used"
    assert [fault and fault.sure for fault in told] == [None] + [False] * 9 + [True] * 290
    again_s = [index / 5 for index, fault in enumerate(told) if fault is not None and fault.reopen]
    assert again_s == [3, 9, 21, 45]


def test_a_vehicle_that_stands_sees_the_same_picture() -> None:
    eyes = FrozenPictureDetector()
    assert watch(eyes, [noisy(0)] * 100, moves=False) == [None] * 100
    assert {fault and fault.sure for fault in watch(eyes, [noisy(0)] * 9, moves=True, from_s=20)} == {False}
    assert watch(eyes, [noisy(0)] * 100, moves=None, from_s=22)[-1] is not None


def test_a_driver_that_gives_each_picture_twice_is_no_fault() -> None:
    told = watch(FrozenPictureDetector(), [noisy(index // 2) for index in range(40)])
    assert [fault and fault.sure for fault in told] == [None, False] * 20


@pytest.mark.parametrize("name", ["corridor_query", "track_lap_a"])
def test_real_recordings_are_sound(shared: Path, name: str) -> None:
    feed = read_feed(shared / "feeds" / name)
    images = FeedImages(feed)
    eyes = FrozenPictureDetector()
    assert [eyes.check(images.read(index), row.stamp_ns, None) for index, row in enumerate(feed.rows)] == [None] * len(
        feed.rows
    )


class Plainly:
    """The same two questions asked of every fourth pixel by NumPy, which takes 10 times as long."""

    def __init__(self) -> None:
        self.last: NDArray[np.uint8] | None = None

    def check(self, image: NDArray[np.uint8]) -> str:
        thinned = image[::STEP_PX, ::STEP_PX]
        is_same, self.last = self.last is not None and np.array_equal(thinned, self.last), thinned
        if thinned.std(axis=(0, 1)).max() < BLANK_DEVIATION:
            return BLANK
        return FROZEN if is_same else ""


def test_random_pictures_get_the_answers_that_every_fourth_pixel_gives() -> None:
    rng, eyes, plainly = np.random.default_rng(0), FrozenPictureDetector(), Plainly()
    answers = []
    image = np.zeros((48, 64, 3), np.uint8)
    for index in range(300):
        if rng.random() < 0.7:
            size = (*(STEP_PX * rng.integers(1, 30, 2)), 3)
            contrast = rng.choice([1.0, 1.9, 2.1, 20.0])
            image = rng.normal(rng.integers(0, 255), contrast, size).clip(0, 255).astype(np.uint8)
        if rng.random() < 0.1:  # a change of one pixel: seen where it is a fourth one
            image = image.copy()
            image[tuple(rng.integers(0, side) for side in image.shape[:2])] ^= 255
        fault = eyes.check(image, index * S, True)
        answers.append("" if fault is None else fault.what)
        assert answers[-1] == plainly.check(image), index
    assert set(answers) == {"", BLANK, FROZEN}


@pytest.mark.parametrize("size", [(1, 5), (5, 9), (481, 643)])
def test_pictures_of_any_size_are_checked(size: tuple[int, int]) -> None:
    images = [np.random.default_rng(seed).integers(0, 255, (*size, 3), np.uint8) for seed in (0, 0, 1)]
    answers = watch(FrozenPictureDetector(), images)
    assert [fault and fault.what for fault in answers] == [None, FROZEN, None]
