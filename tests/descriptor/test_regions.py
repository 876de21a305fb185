"""Cutting an image into regions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from edge.descriptor.network import cut_regions


def test_left_and_right_are_the_outer_parts_in_that_order() -> None:
    image = np.zeros((120, 160, 3), dtype=np.uint8)
    image[:, :64] = (10, 20, 30)
    image[:, 96:] = (40, 50, 60)
    left, right = cut_regions(image, "left-right", 0.4, (224, 224))
    assert left.shape == (224, 224, 3)
    assert (left == (10, 20, 30)).all()
    assert (right == (40, 50, 60)).all()


def test_nothing_is_mirrored() -> None:
    ramp = np.broadcast_to(np.arange(200, dtype=np.uint8)[np.newaxis, :, np.newaxis], (100, 200, 3))
    left, right = cut_regions(np.ascontiguousarray(ramp), "left-right", 0.5, (224, 224))
    assert left[0, 0, 0] < left[0, -1, 0] < right[0, 0, 0] < right[0, -1, 0]


@pytest.mark.parametrize(("height", "width"), [(480, 640), (120, 160), (1080, 300), (224, 224), (1, 1)])
def test_whole_image_of_any_size(height: int, width: int) -> None:
    image = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    (whole,) = cut_regions(image, "whole", 0.4, (224, 224))
    assert whole.shape == (224, 224, 3)


@pytest.mark.parametrize(("height", "width"), [(480, 640), (720, 1280), (1080, 1920)])
def test_a_large_image_is_averaged_and_not_thinned(height: int, width: int) -> None:
    """Thin stripes become an even gray: nearest neighbors would make bands of black and white of them."""
    image = np.zeros((height, width, 3), dtype=np.uint8)
    image[::2] = 200
    (whole,) = cut_regions(image, "whole", 0.4, (224, 224))
    assert abs(float(whole.mean()) - 100) < 3
    nearest = cv2.resize(image, (224, 224), interpolation=cv2.INTER_NEAREST)
    assert float(whole.std()) < 0.7 * float(nearest.std())


@pytest.mark.parametrize("size", [(128, 256), (224, 224)])
@pytest.mark.parametrize(("height", "width"), [(480, 640), (720, 1280), (1080, 1920), (720, 256), (700, 300)])
def test_every_pixel_counts(height: int, width: int, size: tuple[int, int]) -> None:
    """Nearly as by the mean of the pixels under each one, whichever sides are halved first."""
    coarse = np.random.default_rng(0).integers(0, 256, (height // 8, width // 8, 3), dtype=np.uint8)
    image = np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    (whole,) = cut_regions(image, "whole", 0.4, size)
    mean = cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA).astype(np.int16)
    nearest = cv2.resize(image, size[::-1], interpolation=cv2.INTER_NEAREST)
    assert np.abs(whole - mean).mean() < 0.13 * np.abs(nearest - mean).mean()
