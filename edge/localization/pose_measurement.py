"""The keypoint pose of one picture: of its camera relative to a keyframe of the map, on the ground. Pure.

A keyframe lies where the map has it, and its camera faced along the drive, or back. The position error of the map moves
each pose with its keyframe: that error is the map's, and is not in the covariance of the pose.

Errors of poses 2 m apart are nearly independent: on six simulated drives on three roads they correlate by 0.05 to 0.2,
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
"""Meters between two poses below which their errors are shared: the nearer, the less information the second adds. A
vehicle that stands sees the same points again."""
STANDS_M = 0.01
"""Meters below which two poses count as at the same spot."""
AIM_RAD = math.radians(2.8)
"""One standard deviation of the yaw error that all poses against one drive of the map share: two cameras were mounted
by hand, the map's and this one, and the map's heading is that of its vehicle."""


@dataclass(frozen=True)
class PoseMeasurement:
    """A pose measurement of the vehicle by one picture.

    position_m: meters east and north (2,). pose_covariance: (3, 3) of these and of the camera's yaw, clockwise,
    without the map's error. heading_rad: of the vehicle, clockwise from north. inliers: number of points. yaw_rad: the
    autopilot's heading then, likewise; None where that is not known.
    """

    position_m: Vector
    pose_covariance: NDArray[np.float64]
    heading_rad: float
    inliers: int
    yaw_rad: float | None = None

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(2, 2), of the position."""
        return self.pose_covariance[:2, :2]


def camera_pose(
    seen: KeyframeMatch, row_m: Vector, row_rad: float, row_sigma_rad: float
) -> tuple[Vector, NDArray[np.float64]]:
    """Meters east and north (2,) of the camera of a frame, and the covariance (3, 3) of these and of its yaw.

    row_m, row_rad: position and yaw of the keyframe's camera, clockwise from north. row_sigma_rad: one standard
    deviation of that yaw. It moves the position only: all keyframes of a drive share it, see `AIM_RAD`.
    """
    sin, cos = math.sin(row_rad), math.cos(row_rad)
    by_row = np.array([[cos, sin], [-sin, cos]])  # meters right and ahead as east and north
    beside_m = by_row @ np.array([seen.right_m, seen.ahead_m])
    swung_m = row_sigma_rad * np.array([beside_m[1], -beside_m[0], 0.0])
    turned = np.eye(3)
    turned[:2, :2] = by_row
    pose = turned @ np.asarray(seen.covariance) @ turned.T + np.outer(swung_m, swung_m)
    return row_m + beside_m, pose
