"""What moves with the camera is told from what it passes, and the camera's faults are said in one word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge.feed import FeedImages, read_feed
from edge.keypoints import Keypoints
from edge.keypoints.lens import DIRTY_LENS, UNFOCUSED, WITHIN, DriveKeypoints, Image, LensCheck
from sim.evaluation.corruption import Corruption

FEEDS = ("corridor_*", "track_*", "street_front_rear/*")
SMALL = ("track_laps_b", "street_front_rear/scene_12_front", "street_front_rear/scene_a_front")


def pictures_of(feed: Path) -> list[Image]:
    feed_images = FeedImages(found := read_feed(feed))
    return [feed_images.read(row) for row in range(len(found.rows))]


def test_of_over_1_900_clean_pictures_none_is_said_to_be_dirty_or_out_of_focus(shared: Path) -> None:
    said, count = set(), 0
    for feed in (path for pattern in FEEDS for path in sorted((shared / "feeds").glob(pattern))):
        lens = LensCheck()
        for image in pictures_of(feed):
            lens.add(image)
            said.add(lens.word)
            count += 1
    assert (said, count > 1900) == ({""}, True)


@pytest.mark.parametrize("name", SMALL)
def test_a_lens_that_is_dirty_or_out_of_focus_is_said_to_be(name: str, shared: Path) -> None:
    images = pictures_of(shared / "feeds" / name)[:WITHIN]
    for kind, word in (("mud", DIRTY_LENS), ("frost", DIRTY_LENS), ("reflection", DIRTY_LENS), ("defocus", UNFOCUSED)):
        lens, corruption = LensCheck(), Corruption(kind, 5)
        for number, image in enumerate(images):
            lens.add(corruption.of(image, number))
            assert not lens.word or number == WITHIN - 1
        assert lens.word == word, kind


def test_points_on_what_moves_along_are_left_out_from_the_first_picture_on() -> None:
    rng = np.random.default_rng(1)
    road, sticker = (rng.integers(0, 255, (240, width, 3), np.uint8) for width in (2000, 40))
    xy = np.array([(20.0, 100.0), (200.0, 100.0), (300.0, 20.0)], np.float32)

    def extract(image: Image) -> Keypoints:
        return Keypoints(xy, np.ones(3, np.float32), np.zeros((3, 64), np.int8), image.shape[:2])

    drive, found = DriveKeypoints(extract), list[Keypoints]()
    for number in range(WITHIN + 5):
        image = road[:, 23 * number : 23 * number + 320].copy()
        image[80:120, 180:220] = sticker[80:120]
        before, found = found, found + drive.add(image)
        assert bool(len(found) - len(before)) == (number >= WITHIN - 1)
    assert drive.rest() == []
    assert len(found) == WITHIN + 5
    assert all(np.array_equal(one.xy, xy[[0, 2]]) for one in found)
