"""Photographs, and a street whose fronts show them: real pictures whose geometry is known.

They are those that the package scikit-image ships, under the licenses of its `data/README.txt`: faces, food, animals,
walls, and a stereo pair of Middlebury. Only its files are used, so none of what it needs has to be there.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.feed import FeedHeader, FeedRow
from edge.feed.writer import FeedWriter

Image = NDArray[np.uint8]
FRONTS = "astronaut", "coffee", "chelsea", "rocket", "brick", "ihc", "motorcycle_left", "coins", "gravel", "color"
SHOWN_M, LONG_M, HIGH_M, GROUND_M = 70.0, 5.0, 6.0, 1.5
"""How far one sees, the size of a front, and how far the camera is above the ground."""
NEAR_M = 0.5


def shipped(name: str) -> Path:
    """A file that the package ships; what asks is skipped where it is not installed."""
    found = find_spec("skimage")
    if found is None or found.origin is None:
        pytest.skip("needs photographs: pip install --no-deps scikit-image")
    (file,) = (Path(found.origin).parent / "data").glob(name)
    return file


def photograph(name: str) -> Image:
    """(H, W, 3) uint8 BGR."""
    return np.asarray(cv2.imread(str(shipped(f"{name}.[pj][np]g")), cv2.IMREAD_COLOR), np.uint8)


class PhotographedStreet:
    """Fronts 5 to 9 m beside a straight road to the north, each a photograph of its own or a part of one."""

    def __init__(self, length_m: float, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        shown = [photograph(name) for name in FRONTS]
        self._panels: list[tuple[Image, NDArray[np.float64]]] = []
        for at_m in np.arange(0.0, length_m + SHOWN_M, LONG_M):
            for side in (-1, 1):
                image = shown[rng.integers(len(shown))]
                height, width = image.shape[:2]
                top, left = (int(rng.integers(side // 3)) for side in (height, width))
                part = image[top : top + 2 * height // 3, left : left + 2 * width // 3][:, :: int(rng.choice((-1, 1)))]
                beside_m = side * rng.uniform(5, 9)
                stands_across = rng.random() < 1 / 2
                moved_m = (side * LONG_M, 0.0) if stands_across else (0.0, LONG_M)
                ends = [(beside_m, at_m), (beside_m + moved_m[0], at_m + moved_m[1])]
                corners = [(x, y, z) for y in (GROUND_M - HIGH_M, GROUND_M) for x, z in ends]
                shrunk = np.asarray(cv2.resize(part, (256, 192), interpolation=cv2.INTER_AREA), np.uint8)
                self._panels.append((shrunk, np.array(corners)))
        self._panels.sort(key=lambda panel: -panel[1][:, 2].mean())

    def picture(self, right_m: float, ahead_m: float, size: tuple[int, int], fov_deg: float) -> Image:
        """What a camera sees that looks north, (H, W, 3); size: width and height."""
        width, height = size
        focal_px = width / 2 / np.tan(np.radians(fov_deg) / 2)
        shown = np.full((height, width, 3), 210, np.uint8)
        shown[height // 2 :] = 90
        columns, rows = np.arange(width), np.arange(height)[:, np.newaxis]
        for image, corners in self._panels:
            x, y, z = (corners - (right_m, 0.0, ahead_m)).T
            if z.max() < NEAR_M or z.min() > SHOWN_M:
                continue
            z = np.where(np.abs(z) < 1e-3, 1e-3, z)
            # By the plane: texture to the camera's rays, so that one that reaches behind the camera is cut, not torn.
            points = np.column_stack([x, y, z])
            across, down = points[1] - points[0], points[2] - points[0]
            texture = np.column_stack([across / image.shape[1], down / image.shape[0], points[0]])
            camera = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
            to_texture = np.linalg.inv(camera @ texture)
            seen = cv2.warpPerspective(image, to_texture, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
            u, v, w = (row[0] * columns + (row[1] * rows + row[2]) for row in to_texture)
            inside = (w > 0) & (u >= 0) & (v >= 0) & (u <= w * (image.shape[1] - 1)) & (v <= w * (image.shape[0] - 1))
            shown[inside] = seen[inside]
        return shown


def drive(
    street: PhotographedStreet,
    path: Path,
    along_m: Sequence[float] | NDArray[np.float64],
    *,
    right_m: float = 0.0,
    size: tuple[int, int] = (320, 240),
    fov_deg: float = 80.0,
    light: float = 1.0,
) -> Path:
    """A feed of a drive, with the position of each picture. light: gray levels as a share of those by day."""
    rng = np.random.default_rng(round(1000 * right_m) + len(along_m))
    with FeedWriter(path, FeedHeader(path.name, "front", *size, time_sigma_s=0.0, fov_deg=fov_deg)) as writer:
        for index, at_m in enumerate(along_m):
            image = light * street.picture(right_m, at_m, size, fov_deg) + rng.normal(0, 4, (size[1], size[0], 3))
            at_deg = -27.0 + at_m / 110_774.0, 153.0 + right_m / 99_257.0
            row = FeedRow("", index * 200_000_000, *at_deg, heading_deg=0.0, distance_m=float(at_m - along_m[0]))
            writer.write(image.clip(0, 255).astype(np.uint8), row)
    return path
