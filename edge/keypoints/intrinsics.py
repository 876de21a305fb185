"""What successive pictures of a drive say of their own camera: focal length and k1, with how it is mounted.

Turns that are known by the heading show the focal length, and points that pass show k1: they move outward as their
distances say, which bends what a lens bends. `points_of` solves for both, with the points, where it is given this in
place of a mount. On a straight road the focal length is not known: a longer one makes all that stands there higher.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.keypoints.mount import ROW_SIGMA, Mount

UNKNOWN_SIGMA = 0.15, 0.15
"""Of the logarithm of the focal length, and of k1, where a row says it by itself."""
ITERATIONS, LEAST_SLOPE = 5, 0.2
"""To a direction without k1, and of what that does to the distance from the middle."""
EDGE_SQ = 1.5
"""Squared direction up to which k1 counts."""


@dataclass(frozen=True, eq=False)
class UnknownCamera(Mount):
    """A mount, and (2,) by how much the logarithm of the focal length and k1 differ from those of a camera model.

    information: (4, 4) of all four.
    """

    optics: NDArray[np.float64]

    @property
    def values(self) -> NDArray[np.float64]:
        """Down, right, logarithm of the focal length, k1 (4,)."""
        return np.concatenate([self.radians, self.optics])

    def begun(self) -> UnknownCamera:
        """As `Mount` has it."""
        return UnknownCamera(self.radians, PRIOR, self.optics)

    def moved(self, step: NDArray[np.float64], information: NDArray[np.float64]) -> UnknownCamera:
        """As `Mount` has it."""
        return UnknownCamera(self.radians + step[:2], information, self.optics + step[2:])

    def leveled(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `Mount` has it, without what this camera does otherwise than its model."""
        focal, k1 = math.exp(self.optics[0]), self.optics[1]
        bent = directions / focal
        found = bent
        for _ in range(ITERATIONS):  # Newton, by the distance from the middle
            away_sq = np.square(found).sum(axis=-1, keepdims=True)
            slope = np.maximum(1 + 3 * k1 * away_sq, LEAST_SLOPE)
            found = found - (found * (1 + k1 * away_sq) - bent) / slope
        return super().leveled(found)

    def derivatives(self, seen: NDArray[np.float64], must_be: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `Mount` has it. By what must be seen: what is, and its noise, would make the focal length too long."""
        away_sq = np.square(must_be).sum(axis=-1, keepdims=True)
        by_optics = np.stack([must_be, must_be * np.minimum(away_sq, EDGE_SQ)], axis=-1)
        return np.concatenate([super().derivatives(must_be, must_be), by_optics], axis=-1)

    def pixels(self, must_be: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `Mount` has it: else a longer focal length, by which all is nearer, would explain everything."""
        away_sq = np.square(must_be).sum(axis=-1, keepdims=True)
        return np.asarray(math.exp(self.optics[0]) * (1 + 2 * self.optics[1] * np.minimum(away_sq, EDGE_SQ)))


PRIOR: NDArray[np.float64] = np.diag(np.power([ROW_SIGMA, ROW_SIGMA, *UNKNOWN_SIGMA], -2.0))
"""Information (4, 4) with which each row begins."""
AS_CONFIGURED = UnknownCamera(np.zeros(2), PRIOR, np.zeros(2))
"""Before anything was seen."""
