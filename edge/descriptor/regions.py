"""The whole image, or its left and right regions, for the network (section III-D)."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Regions = Literal["left-right", "whole"]

REGION_COUNT: dict[Regions, int] = {"whole": 1, "left-right": 2}
LARGEST_STEP = 2.5
"""An image that is more times larger than its region's size is halved first: one step of linear interpolation reads two
pixels a side, and what lies between them would be lost."""


def cut_regions(image: NDArray[np.uint8], regions: Regions, width: float, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Cut an image (H, W, 3) into R regions resized to `size` (height, width): (R, height, width, 3) uint8.

    "left-right" uses the outer `width` (fraction of W) at each side, left first, at full height; "whole" ignores
    `width`. Nothing is mirrored: an object seen from behind is not its mirror image.
    """
    width_px = image.shape[1]
    if regions == "whole":
        parts = [image]
    else:
        cut_px = max(1, round(width_px * width))
        parts = [image[:, :cut_px], image[:, width_px - cut_px :]]
    out = np.empty((len(parts), *size, 3), dtype=np.uint8)
    for part, target in zip(parts, out, strict=True):
        _resize(_halved(part, size), size, target)
    return out


def _halved(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """The image with each side halved until it is at most LARGEST_STEP times that of `size`."""
    while True:
        halved = tuple(
            given // 2 if given > LARGEST_STEP * wanted else given
            for given, wanted in zip(image.shape[:2], size, strict=True)
        )
        if halved == image.shape[:2]:
            return image
        image = _resize(image, (halved[0], halved[1]))


def _resize(
    image: NDArray[np.uint8], size: tuple[int, int], target: NDArray[np.uint8] | None = None
) -> NDArray[np.uint8]:
    # In fixed-point numbers, so that every processor gives the same bytes; OpenCV's other filters do not.
    resized = cv2.resize(image, size[::-1], dst=target, interpolation=cv2.INTER_LINEAR_EXACT)
    return np.asarray(resized, dtype=np.uint8)
