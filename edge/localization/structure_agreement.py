"""Structure as a measurement: whether it agrees with the one before, and where the vehicle is by it alone. Pure."""

from __future__ import annotations

import numpy as np

from edge.localization import measurements
from edge.localization.filter import GATE, Filter
from edge.localization.sequence_match import StructureMeasurement
from edge.localization.state import VELOCITY, Matrix, Vector

INDEPENDENT_M = 38.0
"""Driven between two of structure whose errors are independent: they correlate by about 0.25 at 20 m, and 0 at 40 m."""
DRIFT, FAR_M = 0.015, 60.0
"""Of the odometer between two, less what the filter knows of it, one standard deviation; and how far apart they may be
at most."""


class StructureAgreement:
    """How many in a row agree: one that is wrong by a few meters may pass an innovation test, but agrees with no other.

    On road 13402 at dusk, 2 of 76 matches were wrong, and 2 of 26 that were handed on 7 and 4 m off without it.
    """

    def __init__(self) -> None:
        self._newest: tuple[StructureMeasurement, Vector] | None = None
        self._count = 0
        self._handed_m: Vector | None = None

    def agrees(self, seen: StructureMeasurement, moved_m: Vector, state: Filter) -> bool:
        """Whether a further one agrees with the one before. moved_m: (4,) by the autopilot's velocity at this frame."""
        there_m, before = moved_m - seen.midpoint.since_m, self._newest
        self._newest, self._count = (seen, there_m), self._count + 1
        is_alike = False
        if before is not None and before[0].drive == seen.drive:
            between_m = there_m - before[1]
            off_m = seen.midpoint.place_m - before[0].midpoint.place_m - state.truly(between_m[:2], between_m[2:])
            driven_m = float(np.hypot(*between_m[:2]))
            spread = seen.covariance + before[0].covariance + (DRIFT * driven_m) ** 2 * np.eye(2)
            is_alike = driven_m <= FAR_M and float(off_m @ np.linalg.solve(spread, off_m)) <= GATE[2]
        self._count = self._count if is_alike else 1
        return is_alike

    def correct(self, bank: Filter) -> bool:
        """Correct by the newest; whether the right filter of the bank used it."""
        assert self._newest is not None
        seen, _ = self._newest
        return bool(measurements.by_structure(bank, bank.slot(seen.drive, seen.errors), seen)[0])

    def handed_on(self, state: Filter) -> tuple[Vector, Matrix, float] | None:
        """Where the newest has the vehicle now (2,), its covariance (2, 2) without the map's error, and its heading.

        None where fewer than two before agree with it, or the last one is not far enough away.
        """
        if self._newest is None or self._count <= 2:
            return None
        seen, there_m = self._newest
        if self._handed_m is not None and float(np.hypot(*(there_m - self._handed_m)[:2])) < INDEPENDENT_M:
            return None
        self._handed_m = there_m
        since_m = seen.midpoint.since_m[:2], seen.midpoint.since_m[2:]
        slopes = state.slopes(*since_m)
        covariance = seen.covariance + slopes @ state.covariance[VELOCITY, VELOCITY] @ slopes.T
        return seen.midpoint.place_m + state.truly(*since_m), covariance, float(np.arctan2(*seen.midpoint.along))
