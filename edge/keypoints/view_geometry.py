"""Upright cameras on one plane: what one sees of a point that another one saw.

A point is its direction (x / z, y / z) in a camera's frame (x right, y down, z ahead) and the inverse of its distance
along z, so that one that is far away needs no special case (Civera, Davison and Montiel 2008). Where a camera is, as
another one has it: meters to the right and ahead, turned clockwise, and pitched nose up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.config import PINHOLE, Lens

NETWORK_PIXELS = 320 * 240
"""Of a picture as the network has it, whatever its shape: errors of points are alike in its pixels."""

FARTHEST_BENT_SQ = 1.5
"""Squared direction up to which an unknown k1 counts."""
STEPS, SAME = 20, 1e-4
"""To a direction without what a lens bends, which then is the same: to a thirtieth of a pixel."""


def per_network_pixel(width: float, height: float) -> float:
    """Pixels of a picture of some size in one of the network's."""
    return math.sqrt(width * height / NETWORK_PIXELS)


class CameraModel(NamedTuple):
    """Pixels of its picture, its horizontal field of view without what the lens bends, and the lens."""

    width: int
    height: int
    fov_deg: float
    lens: Lens = PINHOLE

    @property
    def focal_px(self) -> float:
        """Its focal length, alike in both directions."""
        return self.width / 2 / math.tan(math.radians(self.fov_deg) / 2)

    @property
    def network_focal_px(self) -> float:
        """The same in pixels of the network's picture, or its own of a smaller one, which shows nothing finer.

        Of 157 frames of 160 x 120, 139 are believed with that, and 121 without.
        """
        return self.focal_px / max(1.0, per_network_pixel(self.width, self.height))

    def directions(self, xy: NDArray[np.floating]) -> NDArray[np.float64]:
        """Of pixels (..., 2), the middles of which are whole numbers: (x / z, y / z). NaN for what is not ahead."""
        found: NDArray[np.float64] = (np.asarray(xy, np.float64) - self.middle) / self.focal_px
        return found if not self.lens.bends or not found.size else _straightened(found, self.lens)

    @property
    def middle(self) -> NDArray[np.float64]:
        """The pixel (2,) straight ahead."""
        return np.array([self.width - 1, self.height - 1]) / 2


def _straightened(bent: NDArray[np.float64], lens: Lens) -> NDArray[np.float64]:
    """Directions (..., 2) without what a lens does to them; NaN where it shows none that is ahead."""
    flat, unit, factors = bent.reshape(-1, 1, 2), np.eye(3), np.array(lens.distortion)
    if lens.lens == "fisheye":
        found = cv2.fisheye.undistortPoints(flat, unit, factors)
        back = cv2.fisheye.distortPoints(found, unit, factors)
    else:
        found = cv2.undistortPoints(flat, unit, factors)
        for _ in range(STEPS):  # those of OpenCV 4 are too few at the edge of a wide picture
            rays = cv2.convertPointsToHomogeneous(found)
            back = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), unit, factors)[0]
            found = found + flat - back
    right = (np.abs(back - flat) < SAME).all(axis=-1, keepdims=True)  # beyond its edge a polynomial has no inverse
    straight: NDArray[np.float64] = np.where(right, found, np.nan).reshape(bent.shape)
    return straight


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """By how much (2,) the logarithm of a focal length and k1 exceed those of a camera model; information: (2, 2).

    even: of a picture, twice the share of its points on the side of the middle that has fewer; of several the sum.
    """

    values: NDArray[np.float64]
    information: NDArray[np.float64]
    even: float = 1.0

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Of the values (2, 2)."""
        return np.asarray(np.linalg.inv(self.information))


def bend(
    directions: NDArray[np.float64], derivatives: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Directions (S, 2, n) as cameras with such values (S, 2) have them by their model.

    derivatives: (S, U, 2, n) of the directions by other unknowns, then rows for the values; they become those of what
    is returned.
    """
    focal, k1 = np.exp(values[:, :1, np.newaxis]), values[:, 1:, np.newaxis]
    away_sq = np.minimum(np.square(directions).sum(axis=1, keepdims=True), FARTHEST_BENT_SQ)
    longer, others = focal * (1 + k1 * away_sq), derivatives[:, :-2]
    outward = 2 * focal * k1 * (directions[:, np.newaxis] * others).sum(axis=2)
    others *= longer[:, np.newaxis]
    others += outward[:, :, np.newaxis] * directions[:, np.newaxis]
    derivatives[:, -2], derivatives[:, -1] = longer * directions, focal * away_sq * directions
    return np.asarray(longer * directions)


class Projection:
    """Points (..., 3) as cameras (..., 4) see them; the shapes before the last axis are broadcast together.

    directions: (..., 2). depth: (...), below 0 for what is behind the camera, whose direction is nonsense.
    """

    def __init__(self, cameras: NDArray[np.float64], points: NDArray[np.float64]) -> None:
        right_m, ahead_m, turn, pitch = np.moveaxis(cameras, -1, 0)
        a, b, inverse = np.moveaxis(points, -1, 0)
        self._turn, self._pitch = (np.cos(turn), np.sin(turn)), (np.cos(pitch), np.sin(pitch))
        self._camera_at, self._inverse = (right_m, ahead_m), inverse
        (cos, sin), (cos_pitch, sin_pitch) = self._turn, self._pitch
        beside, before = a - inverse * right_m, 1 - inverse * ahead_m
        x, z = cos * beside - sin * before, sin * beside + cos * before
        self._level = x, z  # before the pitch
        self.depth = cos_pitch * z - sin_pitch * b
        self.directions = np.stack([x, cos_pitch * b + sin_pitch * z], axis=-1) / self._z[..., np.newaxis]

    def by_point(self) -> NDArray[np.float64]:
        """Derivatives (..., 2, 3) by the points: direction and inverse distance."""
        (cos_pitch, sin_pitch), (u, v) = self._pitch, np.moveaxis(self.directions, -1, 0)
        by_b = np.stack([u * sin_pitch, cos_pitch + v * sin_pitch], axis=-1) / self._z[..., np.newaxis]
        (right_m, ahead_m), (cos, sin) = self._camera_at, self._turn
        by_inverse = self._moved(sin * ahead_m - cos * right_m, -sin * right_m - cos * ahead_m)
        return np.stack([self._moved(cos, sin), by_b, by_inverse], axis=-1)

    def by_camera(self) -> NDArray[np.float64]:
        """Derivatives (..., 2, 4) by the cameras: right, ahead, turn and pitch."""
        (cos, sin), (x, z), inverse = self._turn, self._level, self._inverse
        u, v = np.moveaxis(self.directions, -1, 0)
        by_right, by_ahead = self._moved(-cos * inverse, -sin * inverse), self._moved(sin * inverse, -cos * inverse)
        by_pitch = np.stack([u * v, 1 + v * v], axis=-1)
        return np.stack([by_right, by_ahead, self._moved(-z, x), by_pitch], axis=-1)

    @property
    def _z(self) -> NDArray[np.float64]:
        """What is divided by."""
        return np.where(np.abs(self.depth) > 1e-6, self.depth, 1e-6)

    def _moved(self, dx: NDArray[np.float64], d_level_z: NDArray[np.float64]) -> NDArray[np.float64]:
        """How directions move with x and with z before the pitch."""
        (cos_pitch, sin_pitch), (u, v), z = self._pitch, np.moveaxis(self.directions, -1, 0), self._z
        dz = cos_pitch * d_level_z
        du, dv = (dx - u * dz) / z, (sin_pitch * d_level_z - v * dz) / z
        return np.stack(np.broadcast_arrays(du, dv), axis=-1)
