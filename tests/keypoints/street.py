"""A street of points, and what upright cameras in it see, of which the truth is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.keypoints.points import MapPoints, points_of
from edge.keypoints.view_geometry import CameraModel

CAMERA = CameraModel(320, 240, 80.0)
ROWS = np.array([(0.3 * np.sin(at), at, np.radians(1.5) * np.cos(at)) for at in (-8, -6, -4, -2, 2, 4, 6, 8)])
"""Cameras around a row: meters right and ahead, turned clockwise."""


def street(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Points (count, 3) meters right, down and ahead, on two fronts of houses and on the ground."""
    side = rng.choice((-1, 1), count) * rng.uniform(5, 9, count)
    return np.stack([side, rng.uniform(-6, 1.4, count), rng.uniform(12, 60, count)], axis=1)


def seen(world_m: NDArray[np.float64], camera: tuple[float, ...]) -> NDArray[np.float64]:
    """Directions (count, 2) by plain matrices; camera: right, ahead, turn, pitch."""
    right_m, ahead_m, turn, pitch = camera
    yaw = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    nod = np.array([[1, 0, 0], [0, np.cos(pitch), np.sin(pitch)], [0, -np.sin(pitch), np.cos(pitch)]])
    moved = (world_m - [right_m, 0, ahead_m]) @ (nod @ yaw).T
    found: NDArray[np.float64] = moved[:, :2] / moved[:, 2:]
    return found


def with_noise(rng: np.random.Generator, directions: NDArray[np.float64], pixels: float) -> NDArray[np.float64]:
    """Directions as a network finds them, so many pixels off."""
    return directions + rng.normal(0, pixels / CAMERA.focal_px, directions.shape)


def row_points(
    rng: np.random.Generator, world_m: NDArray[np.float64], *, pixels: float, turned_deg: float
) -> MapPoints:
    """Of a row at 0 whose neighbors' headings are known to turned_deg (1 sigma) and pitch by 0.3 degrees."""
    tilted = [(*row, rng.normal(0, np.radians(0.3))) for row in ROWS]
    matched = np.stack([with_noise(rng, seen(world_m, row), pixels) for row in tilted])
    matched[rng.random(matched.shape[:2]) < 0.3] = np.nan
    matched[rng.random(matched.shape[:2]) < 0.1] = 0.4  # matches of something else
    rows = ROWS + rng.normal(0, np.radians(turned_deg), len(ROWS))[:, np.newaxis] * (0, 0, 1)
    return points_of(with_noise(rng, seen(world_m, (0, 0, 0, 0)), pixels), matched, rows, CAMERA)[0]
