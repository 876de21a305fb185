"""Upright cameras on one plane: what one sees of a point that another one saw.

A point is its direction (x / z, y / z) in a camera's frame (x right, y down, z ahead) and the inverse of its distance
along z, so that one that is far away needs no special case (Civera, Davison and Montiel 2008). Where a camera is, as
another one has it: meters to the right and ahead, turned clockwise, and pitched nose up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Camera(NamedTuple):
    """A pinhole camera: pixels of its picture, and its horizontal field of view."""

    width: int
    height: int
    fov_deg: float

    @property
    def focal_px(self) -> float:
        """Its focal length, alike in both directions."""
        return self.width / 2 / math.tan(math.radians(self.fov_deg) / 2)

    def directions(self, xy: NDArray[np.floating]) -> NDArray[np.float64]:
        """Of pixels (..., 2), the middles of which are whole numbers: (x / z, y / z)."""
        found: NDArray[np.float64] = (np.asarray(xy, np.float64) - self.middle) / self.focal_px
        return found

    @property
    def middle(self) -> NDArray[np.float64]:
        """The pixel (2,) straight ahead."""
        return np.array([self.width - 1, self.height - 1]) / 2


class Sight:
    """Points (..., 3) as cameras (..., 4) see them; the shapes before the last axis are broadcast together.

    directions: (..., 2). depth: (...), below 0 for what is behind the camera, whose direction is nonsense.
    """

    def __init__(self, cameras: NDArray[np.float64], points: NDArray[np.float64]) -> None:
        right_m, ahead_m, turn, pitch = np.moveaxis(cameras, -1, 0)
        a, b, inverse = np.moveaxis(points, -1, 0)
        self._cos, self._sin = np.cos(turn), np.sin(turn)
        self._cos_pitch, self._sin_pitch = np.cos(pitch), np.sin(pitch)
        self._camera_at, self._inverse = (right_m, ahead_m), inverse
        beside, before = a - inverse * right_m, 1 - inverse * ahead_m
        self._x = self._cos * beside - self._sin * before
        self._level_z = self._sin * beside + self._cos * before
        self.depth = self._cos_pitch * self._level_z - self._sin_pitch * b
        self._z = np.where(np.abs(self.depth) > 1e-6, self.depth, 1e-6)
        self._u, self._v = self._x / self._z, (self._cos_pitch * b + self._sin_pitch * self._level_z) / self._z
        self.directions = np.stack([self._u, self._v], axis=-1)

    def by_inverse(self) -> NDArray[np.float64]:
        """Derivatives (..., 2) of the directions by the points' inverse distance."""
        right_m, ahead_m = self._camera_at
        return self._moved(
            self._sin * ahead_m - self._cos * right_m, np.asarray(-self._sin * right_m - self._cos * ahead_m)
        )

    def by_point(self) -> NDArray[np.float64]:
        """Derivatives (..., 2, 3) by the points: direction and inverse distance."""
        dz = -self._sin_pitch
        by_b = np.stack(np.broadcast_arrays(-self._u * dz, self._cos_pitch - self._v * dz), -1) / self._z[..., None]
        return np.stack([self._moved(self._cos, self._sin), by_b, self.by_inverse()], axis=-1)

    def by_camera(self) -> NDArray[np.float64]:
        """Derivatives (..., 2, 4) by the cameras: right, ahead, turn and pitch."""
        inverse = self._inverse
        by_right = self._moved(-self._cos * inverse, -self._sin * inverse)
        by_ahead = self._moved(self._sin * inverse, -self._cos * inverse)
        by_turn = self._moved(-self._level_z, self._x)
        by_pitch = np.stack([self._u * self._v, 1 + self._v * self._v], axis=-1)
        return np.stack([by_right, by_ahead, by_turn, by_pitch], axis=-1)

    def _moved(self, dx: NDArray[np.float64], d_level_z: NDArray[np.float64]) -> NDArray[np.float64]:
        """How directions move with x and with z before the pitch."""
        dz = self._cos_pitch * d_level_z
        du, dv = (dx - self._u * dz) / self._z, (self._sin_pitch * d_level_z - self._v * dz) / self._z
        return np.stack(np.broadcast_arrays(du, dv), axis=-1)
