"""What moves with the camera (mud, a reflection, a bonnet), and whether its pictures are sharp; learned by driving.

A slope of the picture that is at the same pixel wherever the vehicle is belongs to the camera, the windshield or the
vehicle. What is opaque and dull does not change at all.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.keypoints import Keypoints

Image = NDArray[np.uint8]

SIZE, WITHIN = (80, 60), 40
"""Columns and rows of cells; and how many pictures are averaged, each of another place: about 80 m."""
FIXED, LEAST_SLOPE2, STILL_GRAY2 = 0.7, 4.0, 16.0
"""Share of a cell's squared slope that stays, and that itself in gray levels, from which it is fixed; and the variance
of a cell that does not change."""
DIRTY, STILL = 0.15, 0.2
"""Shares of the cells that are fixed, and that do not change, beyond which a lens is dirty. In 63 stretches of 1,908
clean real pictures they were at most 0.126 and 0.10; with mud, frost and a reflection of severity 5 one was over it in
each of 16 drives, with those of severity 3 in 0.6 to 1.0 of them, with drops of water in 0.4."""
SHARP = 0.7
"""Mean of `sharpness_of` below which a camera is out of focus. Each clean picture had 0.74 at least; all drives with
defocus of severity 5 have less."""
SMOOTHED_PX = 0.7
"""Before slope and curvature, against noise."""
DIRTY_LENS, UNFOCUSED = "the lens is dirty", "the image is out of focus"


def sharpness_of(image: Image) -> float:
    """How sharp an image (H, W, 3) uint8 BGR is: the root of the mean square of its curvature over that of its slope.

    0.74 to 1.7 in 1,208 recorded images and 1,800 rendered ones, also at night and in rain. Blurred by a disk of 3
    pixels of 224 it is 0.30 to 0.69, by 6 0.23 to 0.42.
    """
    gray = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32), (0, 0), SMOOTHED_PX)
    slopes = (cv2.Sobel(gray, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    squares = sum(float(np.square(one).mean()) for one in slopes)
    return max(1e-3, float(np.sqrt(np.square(cv2.Laplacian(gray, cv2.CV_32F)).mean() / max(squares, 1e-6))))


class LensCheck:
    """By the newest pictures of a drive, each of another place."""

    def __init__(self) -> None:
        self._count, self._sharpness = 0, 0.0
        self._means = np.zeros((5, SIZE[1] - 1, SIZE[0] - 1), np.float32)

    def add(self, image: Image) -> None:
        """One more picture (H, W, 3) uint8 BGR."""
        gray = cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), SIZE, interpolation=cv2.INTER_AREA).astype(float)
        right, down, level = np.diff(gray, axis=1)[:-1], np.diff(gray, axis=0)[:, :-1], gray[:-1, :-1]
        self._count += 1
        share = 1 / min(self._count, WITHIN)
        self._means += share * (np.stack([right, down, right**2 + down**2, level, level**2]) - self._means)
        self._sharpness += share * (sharpness_of(image) - self._sharpness)

    @property
    def is_known(self) -> bool:
        """Whether there were enough pictures."""
        return self._count >= WITHIN

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Which cells (59, 79) show what moves with the camera."""
        right, down, slope2, *_ = self._means
        return np.asarray((right**2 + down**2 > FIXED * slope2) & (slope2 > LEAST_SLOPE2))

    @property
    def word(self) -> str:
        """What is wrong with the camera, "" if nothing is known to be."""
        if not self.is_known:
            return ""
        if self._sharpness < SHARP:  # where all is blurred, little seems to change
            return UNFOCUSED
        still = self._means[4] - self._means[3] ** 2 < STILL_GRAY2
        return DIRTY_LENS if self.fixed.mean() > DIRTY or still.mean() > STILL else ""

    def without_fixed(self, found: Keypoints) -> Keypoints:
        """The points of a picture but for those on what moves with the camera, once that is known."""
        if not self.is_known:
            return found
        around = cv2.dilate(self.fixed.astype(np.uint8), np.ones((3, 3), np.uint8))
        cells = (found.xy + 0.5) / found.size[::-1] * SIZE
        x, y = np.clip(cells.astype(int), 0, np.array(around.shape[::-1]) - 1).T
        return found[around[y, x] == 0]


class DriveKeypoints:
    """The points of all pictures of a drive, but for those on what moves with the camera."""

    def __init__(self, extract: Callable[[Image], Keypoints]) -> None:
        """extract: finds those of a picture."""
        self._extract, self._lens, self._waiting = extract, LensCheck(), list[Keypoints]()

    def add(self, image: Image) -> list[Keypoints]:
        """With one more picture: of that and those before it; none until enough have shown what moves along."""
        self._lens.add(image)
        self._waiting.append(self._extract(image))
        return self.rest() if self._lens.is_known else []

    def rest(self) -> list[Keypoints]:
        """Of the pictures that `add` has not returned."""
        found = [self._lens.without_fixed(one) for one in self._waiting]
        self._waiting.clear()
        return found
