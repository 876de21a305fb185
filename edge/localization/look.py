"""Where one picture has the vehicle: the pose of its camera against that of a row of the map, on the ground. Pure.

A row lies where the map has it, and its camera looked along the drive, or back. So what the map's positions are off by
moves a look with its row: that error is the map's, and is not in a look's covariance.

Errors of looks 2 m apart are nearly independent: on six simulated drives on three roads they correlate by 0.05 to 0.2,
and still so 20 m further. So ten of them count as much as three, see `SHARED_M`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.sequence import Seen

Vector = NDArray[np.float64]

SHARED_M = 6.0
"""Meters driven from one look to the next up to which the latter says less that is new, the less the nearer: a vehicle
that stands sees the same points again."""
STANDS_M = 0.01
"""So near the last one, a look says as little as at the same spot."""
HOLDS_M = 20.0
"""Meters driven after a look within which a line, which is wrong by meters, says nothing that is new."""
LOOK_CHI2 = 11.83
"""Squared distance of two positions in standard deviations that 1 of 370 honest ones exceeds."""
FIRST = 2
"""Looks that agree with each other before the first one counts: else one that is wrong holds for three more."""
OUTVOTES = 3
"""Looks of the last RECENT ones that agree with each other outvote an estimate with which fewer of them agree."""
RECENT, RECENT_M = 6, 30.0
"""Looks, and meters driven, within which they are compared with each other."""
AIM_RAD = math.radians(2.8)
"""One standard deviation of what all looks at a drive of the map are turned by alike: two cameras that were mounted by
hand, of which the rows of the map show theirs, and the heading of the vehicle that drove there."""
SAME_PLACE_M = 10.0
"""What is further from an estimate is another place, which no number of looks moves it to: it must be lost first."""


@dataclass(frozen=True)
class Look:
    """A vehicle by one picture.

    position_m: meters east and north (2,). pose: covariance (3, 3) of these and of how the camera is turned, clockwise,
    without the map's error. map_sigma_m: of that, in each direction. whole: (2, 2) of what all looks at this drive of
    the map are off by together besides. heading_rad: of the vehicle, clockwise from north. points: that agree on it.
    course: in which the vehicle reckons to go there, likewise, and the variance; None where that is not known.
    """

    position_m: Vector
    pose: NDArray[np.float64]
    map_sigma_m: float
    whole: NDArray[np.float64]
    heading_rad: float
    points: int
    course: tuple[float, float] | None = None

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(2, 2), of the position."""
        return self.pose[:2, :2]

    @property
    def goes_back(self) -> bool:
        """Whether the vehicle heads the other way than it goes."""
        return self.course is not None and math.cos(self.heading_rad - self.course[0]) < 0

    def disagrees(self, position_m: Vector, covariance: NDArray[np.float64]) -> float:
        """How far another position (2,) with its covariance is away: squared, in standard deviations."""
        off_m = self.position_m - position_m
        return float(off_m @ np.linalg.solve(self.covariance + covariance, off_m))


def camera_seen(seen: Seen, row_m: Vector, row_rad: float, row_sigma_rad: float) -> tuple[Vector, NDArray[np.float64]]:
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


class RecentLooks:
    """The newest looks, and the vehicle's displacement at each: the robust fallback.

    A geometry may have two solutions, as one in the lane of the map. So the first look waits for one that agrees; and
    where an estimate began with two that are wrong, its gate would refuse all that is right from then on.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[Look, Vector]] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """What was seen before does not count."""
        self._kept.clear()

    def add(self, look: Look, displacement_m: Vector) -> None:
        """Keep one more."""
        self._kept.append((look, displacement_m))

    def agree(self, position_m: Vector, covariance: NDArray[np.float64], drift: float) -> int:
        """How many, moved on as the vehicle did, are where it is now (2,) with that covariance (2, 2).

        drift: share by which a displacement may be wrong.
        """
        count, now_m = 0, self._kept[-1][1]
        for look, then_m in self._kept:
            moved_m = (now_m - then_m)[:2]
            driven_m = float(np.hypot(*moved_m))
            spread = covariance + (drift * driven_m) ** 2 * np.eye(2)
            count += driven_m <= RECENT_M and look.disagrees(position_m - moved_m, spread) <= LOOK_CHI2
        return count
