"""How a camera is mounted: its pitch down, and its yaw to the right, against the way it moves.

Each keyframe says so with its points (`points_of`), to 0.3 and 0.6 degrees; all of 300 m together to about 0.3.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ROW_SIGMA = float(np.radians(5.0))
"""Of a mount by one keyframe alone."""
MOUNT_SIGMA = float(np.radians(2.0))
"""Of a camera that was mounted by hand to face along the road."""
SHARED = 200.0
"""Keyframes that count as one: neighbors err alike, those in the same bend too."""


@dataclass(frozen=True, eq=False)
class Mount:
    """Radians (2,): down, and to the right as seen from above; and their information (2, 2)."""

    radians: NDArray[np.float64]
    information: NDArray[np.float64]

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(3, 3): a ray (right, down, ahead) of a camera that faces level along the road in the frame of this one."""
        (sin_down, sin_right), (cos_down, cos_right) = np.sin(self.radians), np.cos(self.radians)
        down = np.array([[1, 0, 0], [0, cos_down, -sin_down], [0, sin_down, cos_down]])
        right = np.array([[cos_right, 0, -sin_right], [0, 1, 0], [sin_right, 0, cos_right]])
        return np.asarray(down @ right)

    def leveled(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Directions (..., 2) of this camera in the frame of one that faces level along the road."""
        rays = directions @ self.rotation[:2] + self.rotation[2]
        found: NDArray[np.float64] = rays[..., :2] / rays[..., 2:]
        return found

    @property
    def values(self) -> NDArray[np.float64]:
        """All that is unknown (S,), of which `information` is."""
        return self.radians

    def begun(self) -> Mount:
        """From which an adjustment starts: the same, as little known as where a row says it by itself."""
        return Mount(self.radians, unknown(ROW_SIGMA).information)

    def moved(self, step: NDArray[np.float64], information: NDArray[np.float64]) -> Mount:
        """After a step (S,)."""
        return Mount(self.radians + step, information)

    def derivatives(self, seen: NDArray[np.float64], must_be: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 2, S): how what is off moves back by each unknown. seen, must_be: (..., 2) leveled directions."""
        u, v = np.moveaxis(seen, -1, 0)
        turned = [[-u * v, -1 - u * u], [-1 - v * v, -u * v]]
        return np.stack([np.stack(row, axis=-1) for row in turned], axis=-2)

    def pixels(self, must_be: NDArray[np.float64]) -> NDArray[np.float64] | float:
        """In a picture of something off, over those that the camera says. must_be: as `derivatives`."""
        return 1.0


def yaw_of(mounted: NDArray[np.float64], leveled: NDArray[np.float64]) -> float:
    """Yaw of a camera to the right of the road, in radians; mounted, leveled: (n, 2) as `Mount.leveled`.

    By the rotation of least squares (Kabsch 1976).
    """
    own, level = (np.column_stack([one, np.ones(len(one))]) for one in (mounted, leveled))
    own, level = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (own, level))
    left, _, right = np.linalg.svd(own.T @ level)
    ahead = left[2] @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return float(np.arctan2(ahead[0], ahead[2]))


def unknown(sigma: float) -> Mount:
    """Of a camera that faces level along the road, to a standard deviation."""
    return Mount(np.zeros(2), np.eye(2) / sigma**2)


def mount_of_drive(rows: Iterable[Mount], known: Mount | None = None) -> Mount:
    """That of all rows of a drive together. known: that of those before, if there are any."""
    found = known or unknown(MOUNT_SIGMA)
    for row in rows:
        weight = row.information / SHARED
        information = found.information + weight
        step = np.linalg.solve(information, weight @ (row.values - found.values))
        found = found.moved(np.asarray(step), information)
    return found
