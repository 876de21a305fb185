"""The network that finds points and describes them: XFeat, and what follows it in NumPy.

Potje et al., "XFeat: Accelerated Features for Lightweight Image Matching", CVPR 2024, whose own code (`XFeat`,
`detectAndCompute`, https://github.com/verlab/accelerated_features) says how points are chosen and descriptors sampled.
A position finer than a pixel is added: theirs are whole.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.descriptor import open_graph
from edge.keypoints import Keypoints
from edge.keypoints.lens import sharpness_of
from edge.keypoints.view_geometry import NETWORK_PIXELS

NETWORK = "xfeat"
"""What ships."""
MOST = 400
"""Points of a picture."""
MULTIPLE, CELL = 32, 8
"""Pixels: of which the sides of a resized picture are multiples; and of what has one feature."""
LEAST_PROBABILITY = 0.05
"""That a pixel is a keypoint, against the other 63 of its cell and none; XFeat's own."""
_NEIGHBORS = np.ones((5, 5), np.uint8)
"""No other point is found among these."""
_CUBIC = -0.75
"""The steepness of cubic interpolation, PyTorch's."""


class KeypointNetwork:
    """Finds the points of pictures, in the calling thread."""

    def __init__(self, name: str = NETWORK) -> None:
        """name: or another file with its inputs and outputs. ModelError, in one line."""
        self._run = open_graph(name, ("features", "keypoints", "reliability"))

    def extract(self, image: NDArray[np.uint8], most: int = MOST) -> Keypoints:
        """The `most` points of an image (H, W, 3) uint8 BGR that are the most reliable; fewer where it shows little."""
        size = (image.shape[0], image.shape[1])
        small = cv2.resize(image, working_size(size)[::-1], interpolation=cv2.INTER_LINEAR_EXACT)
        features, cells, reliability = (one[0] for one in self._run(np.asarray(small, np.uint8)[np.newaxis]))
        heat = _pixels(cells)
        at, scores = _best(heat, reliability[..., 0], most)
        descriptors = _sampled(features, _on_map(at, heat.shape))
        length = np.linalg.norm(descriptors, axis=1, keepdims=True)
        scale = np.array(size[::-1]) / heat.shape[::-1]
        xy = (at + _fine(heat, at) + 0.5) * scale - 0.5
        encoded, seen = np.rint(127 * descriptors / length).astype(np.int8), small if small.size < image.size else image
        return Keypoints(xy.astype(np.float32), scores, encoded, size, sharpness_of(np.asarray(seen, np.uint8)))


@lru_cache(8)
def working_size(size: tuple[int, int]) -> tuple[int, int]:
    """Height and width that a picture of this height and width is resized to.

    Of at most NETWORK_PIXELS; those in which it loses the least in the direction in which it loses more.
    """
    sides = range(MULTIPLE, NETWORK_PIXELS // MULTIPLE + 1, MULTIPLE)
    fitting = ((height, width) for height in sides for width in sides if height * width <= NETWORK_PIXELS)
    return max(fitting, key=lambda fit: (min(fit[0] / size[0], fit[1] / size[1]), -fit[0] * fit[1]))


def _pixels(cells: NDArray[np.float32]) -> NDArray[np.float32]:
    """The probability of each pixel (H, W), of those of the pixels of each cell and of none, (H / 8, W / 8, 65)."""
    rows, columns = cells.shape[:2]
    apart = cells[..., :-1].reshape(rows, columns, CELL, CELL)
    return apart.transpose(0, 2, 1, 3).reshape(rows * CELL, columns * CELL)


def _best(
    heat: NDArray[np.float32], reliability: NDArray[np.float32], most: int
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Pixels (K, 2), x and y, that are the most probable around them, and their scores (K,), the best first."""
    peaks = (heat == cv2.dilate(heat, _NEIGHBORS)) & (heat > LEAST_PROBABILITY)
    at = np.stack(np.divmod(np.flatnonzero(peaks), heat.shape[1])[::-1], axis=1)  # faster than argwhere
    place = _on_map(at, heat.shape)
    low = np.floor(place).astype(np.intp)
    padded, share = np.pad(reliability, 1), place - low
    x, y = low.T + 1
    across = [padded[row, x] * (1 - share[:, 0]) + padded[row, x + 1] * share[:, 0] for row in (y, y + 1)]
    scores = heat[at[:, 1], at[:, 0]] * (across[0] * (1 - share[:, 1]) + across[1] * share[:, 1])
    order = np.argsort(-scores, kind="stable")[:most]
    return at[order], scores[order].astype(np.float32)


def _on_map(at: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Where pixels (K, 2) lie on the map of features, whose ends XFeat puts on the ends of the picture."""
    sides = np.array(shape[::-1])
    return np.asarray(at / (sides - 1) * (sides // CELL) - 0.5)


def _sampled(features: NDArray[np.float32], place: NDArray[np.float64]) -> NDArray[np.float32]:
    """Features (H / 8, W / 8, D) at places (K, 2) by cubic interpolation, 0 outside: (K, D)."""
    low = np.floor(place).astype(np.intp)
    share = place - low
    steps = np.arange(4)
    weights = _cubic(np.abs(share[..., np.newaxis] + 1 - steps))
    padded = np.pad(features, ((2, 2), (2, 2), (0, 0)))
    x, y = (low[:, axis, np.newaxis] + 1 + steps for axis in (0, 1))
    near = padded[y[:, :, np.newaxis], x[:, np.newaxis, :]]
    return np.asarray(np.einsum("kyxd,ky,kx->kd", near, weights[:, 1], weights[:, 0], optimize=True), np.float32)


def _cubic(away: NDArray[np.float64]) -> NDArray[np.float32]:
    """The weight of what is so many steps away, 0 to 2 (Keys, 1981)."""
    near = ((_CUBIC + 2) * away - (_CUBIC + 3)) * away**2 + 1
    far = _CUBIC * (((away - 5) * away + 8) * away - 4)
    return np.where(away <= 1, near, far).astype(np.float32)


def _fine(heat: NDArray[np.float32], at: NDArray[np.intp]) -> NDArray[np.float64]:
    """Offsets (K, 2) of the peaks of parabolas through the logarithms of pixels and their neighbors."""
    logs = np.log(np.pad(heat, 1, mode="edge") + 1e-6)
    x, y = at.T + 1
    here = logs[y, x]
    moves = []
    for before, after in ((logs[y, x - 1], logs[y, x + 1]), (logs[y - 1, x], logs[y + 1, x])):
        bend = np.minimum(before + after - 2 * here, -1e-3)
        moves.append(np.clip((before - after) / 2 / bend, -0.5, 0.5))
    return np.stack(moves, axis=1)
