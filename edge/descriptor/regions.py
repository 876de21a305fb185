"""The whole image, or its left and right regions, for the network (section III-D)."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Regions = Literal["left-right", "whole"]

REGION_COUNT: dict[Regions, int] = {"whole": 1, "left-right": 2}


def cut_regions(
    image: NDArray[np.uint8], regions: Regions, width: float, size: tuple[int, int] = (224, 224)
) -> NDArray[np.uint8]:
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
        # The network was trained with area averaging, which is correct only for shrinking.
        shrinks = part.shape[0] >= size[0] and part.shape[1] >= size[1]
        cv2.resize(part, size[::-1], dst=target, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return out
