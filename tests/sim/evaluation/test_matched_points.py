"""Two pictures with lines between the points that agree."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.network import KeypointNetwork
from sim.evaluation.matched_points import InlierMatches, side_by_side, with_lines


def points(xy: list[tuple[float, float]], size: tuple[int, int]) -> Keypoints:
    return Keypoints(np.array(xy, np.float32), np.ones(len(xy), np.float32), np.zeros((len(xy), 64), np.int8), size)


def test_a_line_joins_each_pair_in_pictures_of_any_two_sizes() -> None:
    here, there = np.zeros((100, 120, 3), np.uint8), np.zeros((200, 160, 3), np.uint8)
    one, other = points([(10, 50), (30, 20)], (100, 120)), points([(40, 60), (80, 100)], (200, 160))
    found = InlierMatches(np.array([[0, 1]], np.int32), 1)
    drawn = with_lines((here, there), (one, other), found)
    assert drawn.shape == (100, 200, 3)
    rows, columns = np.nonzero(drawn.any(axis=2))
    assert (columns.min(), columns.max()) == (7, 163)  # from 10 to 120 + 80 / 2, with dots
    assert abs(rows - 50).max() <= 3
    assert not here.any(), "the given picture is not drawn on"


def test_pictures_of_one_place_have_many_lines() -> None:
    rng = np.random.default_rng(3)
    here: NDArray[np.uint8] = rng.integers(0, 255, (24, 32, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    there = np.asarray(cv2.warpAffine(here, np.array([[1, 0, 9.0], [0, 1, 0]]), (256, 192)), np.uint8)
    drawn, found = side_by_side(KeypointNetwork(), here, there)
    assert drawn.shape == (192, 512, 3)
    assert found.inliers > 100
    assert (drawn != np.hstack([here, there])).any(axis=2).mean() > 0.05
