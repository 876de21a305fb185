"""Which points of two pictures agree: of one place from two positions, and of what has nothing in common."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.matching import mutual_matches
from sim.evaluation.matched_points import verify

SIZE = (240, 320)


def unit(rng: np.random.Generator, count: int) -> NDArray[np.int8]:
    """Descriptors of points that have nothing in common."""
    values = rng.normal(size=(count, 64))
    return np.asarray(np.rint(127 * values / np.linalg.norm(values, axis=1, keepdims=True)), np.int8)


def seen(points: NDArray[np.float64], ahead: float, sideways: float = 0.0) -> NDArray[np.float32]:
    """Pixels of points (N, 3), right, down and ahead in meters, from a camera so many meters ahead and to the right."""
    moved = points - (sideways, 0.0, ahead)
    return (moved[:, :2] / moved[:, 2:] * 190 + (159.5, 119.5)).astype(np.float32)


def picture(xy: NDArray[np.float32], descriptors: NDArray[np.int8], scale: int = 1) -> Keypoints:
    height, width = SIZE
    return Keypoints(xy * scale, np.ones(len(xy), np.float32), descriptors, (height * scale, width * scale))


@pytest.fixture
def scene() -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """200 points along a road, and their descriptors."""
    rng = np.random.default_rng(4)
    return rng.uniform((-9, -4, 8), (9, 2, 50), (200, 3)), unit(rng, 200)


def test_points_that_moved_as_a_camera_does_are_inliers_and_others_are_not(
    scene: tuple[NDArray[np.float64], NDArray[np.int8]],
) -> None:
    points, descriptors = scene
    rng = np.random.default_rng(5)
    query, wrong = seen(points, ahead=2.0, sideways=0.5), np.arange(0, 200, 4)
    query[wrong] += rng.uniform(20, 60, (len(wrong), 2)).astype(np.float32)  # alike, and elsewhere
    order = rng.permutation(200)
    found = verify(picture(query, descriptors), picture(seen(points, 0.0)[order], descriptors[order]))
    assert found.candidates == 200
    np.testing.assert_array_equal(order[found.matches[:, 1]], found.matches[:, 0])
    right = np.setdiff1d(np.arange(200), wrong)
    assert set(right) <= set(found.matches[:, 0])
    assert found.inliers < 150 + 15  # of 50 some lie on their line by chance


def test_the_answer_does_not_depend_on_the_resolution(scene: tuple[NDArray[np.float64], NDArray[np.int8]]) -> None:
    points, descriptors = scene
    off = np.random.default_rng(6).normal(0, 1.2, (200, 2)).astype(np.float32)
    query, reference = seen(points, 2.0) + off, picture(seen(points, 0.0), descriptors)
    one, large = verify(picture(query, descriptors), reference), verify(picture(query, descriptors, 4), reference)
    assert 100 < one.inliers < 200
    np.testing.assert_array_equal(one.matches, large.matches)


def test_only_the_most_alike_in_both_directions_match_if_alike_enough() -> None:
    first, second, third = np.zeros((3, 64))
    first[0], second[1] = 1, 1
    third[[0, 1]] = 0.8, 0.6
    one, two = (np.rint(127 * np.stack(rows)).astype(np.int8) for rows in ((first, third), (third, second)))
    np.testing.assert_array_equal(mutual_matches(one, two), [[1, 0]])
    np.testing.assert_array_equal(mutual_matches(one[:1], two), np.empty((0, 2)))  # a cosine of .80


@pytest.mark.parametrize("count", [0, 1, 7, 8])
def test_too_few_points_are_no_inliers(count: int) -> None:
    rng = np.random.default_rng(count)
    few = picture(rng.uniform(0, 240, (count, 2)).astype(np.float32), unit(rng, count))
    found = verify(few, few)
    assert (found.candidates, found.matches.shape[1]) == (count, 2)
    assert count == 8 or found.inliers == 0


def test_points_that_opencv_refuses_are_no_error() -> None:
    """OpenCV 5 raises on these eight, of a drive home by night: none of its hypotheses can be improved."""
    here = [(113, 84), (275, 39), (310, 80), (315, 82), (307, 73), (272, 56), (147, 99), (280, 58)]
    there = [(88, 114), (313, 33), (311, 72), (317, 70), (310, 65), (310, 47), (137, 105), (313, 51)]
    descriptors = unit(np.random.default_rng(1), 8)
    query, reference = (picture(np.array(xy, np.float32), descriptors) for xy in (here, there))
    assert verify(query, reference).candidates == 8
