"""A small picture of a place, for people."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX = 120


def thumbnail(image: NDArray[np.uint8]) -> bytes:
    """A JPEG of a frame (H, W, 3) BGR, WIDTH_PX wide or up to twice that: a whole factor is reduced by far faster."""
    factor = max(1, image.shape[1] // WIDTH_PX)
    height, width = (max(1, size // factor) for size in image.shape[:2])
    whole = image[: height * factor, : width * factor]
    small = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1].tobytes()
