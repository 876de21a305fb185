"""Where structure has the vehicle, and whether several agree by what was driven between them. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from edge.localization.filter import GATE, DriveErrors, Matrix, Vector
from edge.localization.pose_measurement import LocalMidpoint, left_of
from edge.sequence import Direction

DRIFT, FAR_M = 0.03, 60.0
"""Of the odometer between two, one standard deviation; and how far apart they may be at most, or that says little."""


@dataclass(frozen=True)
class StructureMeasurement:
    """Where structure has the vehicle, in local meters: in the middle of its window.

    drive: what its errors are those of. sigma_m: along-track and cross-track, without the error of the map.
    """

    drive: tuple[int, Direction]
    midpoint: LocalMidpoint
    sigma_m: tuple[float, float]
    errors: DriveErrors

    @property
    def covariance(self) -> Matrix:
        """East and north (2, 2)."""
        axes = np.array([self.midpoint.along, left_of(self.midpoint.along)])
        return np.asarray(axes.T @ np.diag(np.square(self.sigma_m)) @ axes)


class StructureAgreement:
    """How many in a row agree: one that is wrong by a few meters may pass an innovation test, but agrees with no other.

    On road 13402 at dusk, 2 of 76 matches were wrong, and 2 of 26 that were handed on 7 and 4 m off without it.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """No motion leads from those so far to the next one."""
        self._newest: tuple[StructureMeasurement, Vector] | None = None
        self._count = 0

    def count(self, seen: StructureMeasurement, moved_m: Vector, truly: Callable[[Vector, Vector], Vector]) -> int:
        """With a further one. moved_m: (4,) by the autopilot's velocity, at this frame. truly: see `Filter`."""
        there_m, before = moved_m - seen.midpoint.since_m, self._newest
        self._newest, self._count = (seen, there_m), self._count + 1
        if before is not None and before[0].drive == seen.drive:
            between_m = there_m - before[1]
            off_m = seen.midpoint.place_m - before[0].midpoint.place_m - truly(between_m[:2], between_m[2:])
            driven_m = float(np.hypot(*between_m[:2]))
            spread = seen.covariance + before[0].covariance + (DRIFT * driven_m) ** 2 * np.eye(2)
            if driven_m <= FAR_M and float(off_m @ np.linalg.solve(spread, off_m)) <= GATE[2]:
                return self._count
        self._count = 1
        return 1
