"""Where one picture has the vehicle: the pose of its camera against that of a row of the map, on the ground. Pure.

A row lies where the map has it, and its camera looked along the drive, or back. So what the map's positions are off by
moves a look with its row: that error is the map's, and is not in a look's covariance.

Errors of looks 2 m apart are nearly independent: on six simulated drives on three roads they correlate by 0.05 to 0.2,
and still so 20 m further. So ten of them count as much as three, see `SHARED_M`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.sequence import KeyframeMatch

Vector = NDArray[np.float64]

SHARED_M = 6.0
"""Meters driven from one look to the next up to which the latter says less that is new, the less the nearer: a vehicle
that stands sees the same points again."""
STANDS_M = 0.01
"""So near the last one, a look says as little as at the same spot."""
AIM_RAD = math.radians(2.8)
"""One standard deviation of what all looks at a drive of the map are turned by alike: two cameras that were mounted by
hand, of which the rows of the map show theirs, and the heading of the vehicle that drove there."""


@dataclass(frozen=True)
class PoseMeasurement:
    """A pose measurement of the vehicle by one picture.

    position_m: meters east and north (2,). pose_covariance: (3, 3) of these and of how the camera is turned,
    clockwise, without the map's error.  heading_rad: of the vehicle, clockwise from north. inliers: that agree on it.
    course: in which the vehicle reckons to go there, likewise, and the variance; None where that is not known.
    """

    position_m: Vector
    pose_covariance: NDArray[np.float64]
    heading_rad: float
    inliers: int
    course: tuple[float, float] | None = None

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(2, 2), of the position."""
        return self.pose_covariance[:2, :2]

    @property
    def goes_back(self) -> bool:
        """Whether the vehicle heads the other way than it goes."""
        return self.course is not None and math.cos(self.heading_rad - self.course[0]) < 0


def camera_pose(
    seen: KeyframeMatch, row_m: Vector, row_rad: float, row_sigma_rad: float
) -> tuple[Vector, NDArray[np.float64]]:
    """Meters east and north (2,) of the camera of a frame, and the covariance (3, 3) of these and of its turn.

    row_m, row_rad: of the row's camera, clockwise from north, and one standard deviation of where it looked, which is
    not in that of the turn, since all rows of a drive share it.
    """
    sin, cos = math.sin(row_rad), math.cos(row_rad)
    by_row = np.array([[cos, sin], [-sin, cos]])  # meters right and ahead as east and north
    beside_m = by_row @ np.array([seen.right_m, seen.ahead_m])
    swung_m = row_sigma_rad * np.array([beside_m[1], -beside_m[0], 0.0])
    turned = np.eye(3)
    turned[:2, :2] = by_row
    pose = turned @ np.asarray(seen.covariance) @ turned.T + np.outer(swung_m, swung_m)
    return row_m + beside_m, pose
