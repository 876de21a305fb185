"""Where in the picture two views agree: points that a network finds, their matches, and what geometry says of them.

    image (H, W, 3) --network--> Keypoints
    a drive's Keypoints --drive_points--> MapPoints of each keyframe --pose, with a frame--> RelativePose

A camera that faces the same way as the map's finds the place in one picture. Where the views are opposite, only
`[sequence] structure` loads this, which compares where points are, and not what they look like.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.keypoints.points import MapPoints
from edge.keypoints.view_geometry import CameraModel

__all__ = ["CameraModel", "Keypoints", "MapPoints"]


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Points of one picture, the best first.

    xy: (K, 2) float32, pixels of the picture from the center of its upper left one, x to the right and y down.
    scores: (K,) float32, over 0 to 1. descriptors: (K, 64) int8, 127 times a vector of length 1.
    size: height and width of the picture in pixels. sharpness: see `lens.sharpness_of`.
    """

    xy: NDArray[np.float32]
    scores: NDArray[np.float32]
    descriptors: NDArray[np.int8]
    size: tuple[int, int]
    sharpness: float = 1.0

    def __len__(self) -> int:
        return len(self.xy)

    def __getitem__(self, chosen: NDArray[np.bool_]) -> Keypoints:
        """Some of them."""
        return replace(self, xy=self.xy[chosen], scores=self.scores[chosen], descriptors=self.descriptors[chosen])
