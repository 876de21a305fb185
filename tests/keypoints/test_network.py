"""XFeat's points: those of its own code, finer than a pixel, in pixels of the picture that was given."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.errors import ModelError
from edge.keypoints.matching import mutual_matches
from edge.keypoints.network import KeypointNetwork, working_size

FOLDER = Path(__file__).parent
Image = NDArray[np.uint8]


@pytest.fixture(scope="module")
def network() -> KeypointNetwork:
    return KeypointNetwork()


@pytest.fixture(scope="module")
def picture() -> Image:
    """A simulated road in gray, (224, 320, 3)."""
    return np.asarray(cv2.imread(str(FOLDER / "reference.png"), cv2.IMREAD_COLOR), np.uint8)


def test_points_are_those_of_the_authors_code(network: KeypointNetwork, picture: Image) -> None:
    """reference.npz is from make_reference.py; descriptors are in float16 there, and of 7 bits here."""
    wanted = np.load(FOLDER / "reference.npz")
    found = network.extract(picture, len(wanted["at"]))
    np.testing.assert_array_less(np.abs(found.xy - wanted["at"]), 0.5001)
    np.testing.assert_allclose(found.scores, wanted["scores"], atol=1e-5)
    np.testing.assert_allclose(found.descriptors / 127, wanted["descriptors"], atol=0.6 / 127)
    assert (np.diff(found.scores) <= 0).all()


def test_positions_are_finer_than_a_pixel(network: KeypointNetwork, picture: Image) -> None:
    """Of a picture and of the same one turned and moved a little: .67 px apart in the median, .90 with whole pixels."""
    turned = cv2.getRotationMatrix2D((160, 112), 1, 1.02) + np.array([[0, 0, 1.3], [0, 0, 0.6]])
    moved = np.asarray(cv2.warpAffine(picture, turned, (320, 224), flags=cv2.INTER_CUBIC), np.uint8)
    one, other = network.extract(picture), network.extract(moved)
    pairs = mutual_matches(one.descriptors, other.descriptors)
    assert len(pairs) > 200

    def median_px(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
        there = first[pairs[:, 0]] @ turned[:, :2].T + turned[:, 2]
        return float(np.median(np.linalg.norm(there - second[pairs[:, 1]], axis=1)))

    fine, whole = median_px(one.xy, other.xy), median_px(np.rint(one.xy), np.rint(other.xy))
    assert fine < min(0.75, 0.85 * whole)


def test_positions_are_pixels_of_the_picture_that_was_given(network: KeypointNetwork, picture: Image) -> None:
    one, other = network.extract(picture), network.extract(picture.repeat(2, axis=0).repeat(2, axis=1))
    assert other.size == (448, 640)
    np.testing.assert_array_equal(one.descriptors, other.descriptors)
    np.testing.assert_allclose(other.xy, 2 * one.xy + 0.5, atol=1e-4)


@pytest.mark.parametrize(
    ("given", "size"),
    [
        ((240, 320), (224, 320)),
        ((1080, 1920), (192, 352)),
        ((376, 1241), (160, 480)),
        ((480, 752), (224, 320)),
        ((240, 240), (256, 256)),
        ((640, 480), (320, 224)),
        ((120, 160), (224, 320)),
        ((1, 99), (32, 2400)),
    ],
)
def test_any_picture_is_resized_to_what_the_network_takes(
    network: KeypointNetwork, given: tuple[int, int], size: tuple[int, int]
) -> None:
    assert working_size(given) == size
    assert network.extract(np.zeros((*given, 3), np.uint8)).size == given


def test_a_picture_that_shows_nothing_has_no_points(network: KeypointNetwork) -> None:
    found = network.extract(np.full((240, 320, 3), 90, np.uint8))
    assert (found.xy.shape, found.scores.shape, found.descriptors.shape) == ((0, 2), (0,), (0, 64))


def test_a_blurred_picture_is_less_sharp(network: KeypointNetwork, picture: Image) -> None:
    blurred = np.asarray(cv2.blur(picture, (7, 7)), np.uint8)
    assert network.extract(picture).sharpness > 0.9 > 1.3 * network.extract(blurred).sharpness > 0


def test_the_number_of_points_can_be_chosen(network: KeypointNetwork, picture: Image) -> None:
    most, few = network.extract(picture), network.extract(picture, 50)
    assert (len(most), len(few)) == (400, 50)
    np.testing.assert_array_equal(few.xy, most.xy[:50])


def test_another_network_is_refused() -> None:
    with pytest.raises(ModelError, match=r"network_float32.onnx: gives .*; features, keypoints, reliability are"):
        KeypointNetwork("grid")
