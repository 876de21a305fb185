"""Where in two pictures the same points are: a place by one picture."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.network import MOST, KeypointNetwork
from lookback.description import image_of
from sim.evaluation import matched_points
from sim.evaluation.matched_points import InlierMatches

Picture = str | Path | NDArray[np.uint8]


def keypoints(picture: Picture, most: int = MOST) -> Keypoints:
    """The `most` points of a picture that are found again most reliably: positions, scores and descriptors (XFeat).

    picture: a file, or an image (H, W, 3) uint8 BGR.

    >>> found = keypoints(np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8), most=50)
    >>> found.xy.shape, found.descriptors.shape
    ((50, 2), (50, 64))
    """
    return _network().extract(image_of(picture), most)


def verify(query: Picture | Keypoints, reference: Picture | Keypoints) -> InlierMatches:
    """Which points of two pictures one geometry explains; their number, `inliers`, says whether it is one place.

    In pictures of web cameras, 141 in the median where both show one place by day, 65 at dusk and 20 by night; 7 where
    they do not, 19 at 99 % (docs/keypoints.md has what this cannot know). Give the `keypoints` of pictures that are
    compared with several others.

    >>> image = np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8)
    >>> verify(image, image).inliers == len(keypoints(image))
    True
    """
    first, second = (one if isinstance(one, Keypoints) else keypoints(one) for one in (query, reference))
    return matched_points.verify(first, second)


@lru_cache(maxsize=1)
def _network() -> KeypointNetwork:
    return KeypointNetwork()
