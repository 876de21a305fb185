"""An extended Kalman filter for a vehicle on a mapped road: its position, and what its own velocity is wrong by. Pure.

    state      (6,): meters east, meters north, heading error in radians, scale error, and two errors of the matches
               along the road, one that stays for a drive, and one that changes within CORRELATION_M
    prediction position += (1 + scale) * R(heading error) * displacement by the autopilot's velocity
    correction along the road by a match; across it never below the width of the road, see `keep_on_road`

All but the position are first-order Gauss-Markov processes over the distance. The last is what makes matches within a
correlation length of each other about one observation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

CORRELATION_M = 60.0
"""Meters driven within which the errors of two matches are about the same."""
HEADING_M, SCALE_M, DRIVE_M = 3000.0, 10_000.0, 3000.0
"""Correlation lengths of heading error and scale error of an autopilot's velocity, and of what stays for a drive."""
STAYS = 0.25
"""Share of the variance of matches that stays for a drive."""
WANDER = 0.03
"""Meters of error per square root of a meter driven that heading and scale do not explain."""


@dataclass(frozen=True)
class VelocityErrors:
    """Standard deviations of an autopilot's velocity, and of matches along the road."""

    heading_rad: float
    scale: float
    match_m: float


class RouteEstimate:
    """Mean and covariance of the state; positions are in meters of any local frame."""

    def __init__(self, position_m: Vector, along: Vector, across_sigma_m: float, errors: VelocityErrors) -> None:
        """Begin at a place: along the unit vector `along` nothing is known before the first `correct`."""
        self._variances = np.array([errors.heading_rad**2, errors.scale**2, *_shared(errors.match_m)])
        self.mean = np.array([*position_m, 0.0, 0.0, 0.0, 0.0])
        self.covariance = np.diag([0.0, 0.0, *self._variances])
        left = np.array([-along[1], along[0]])
        self.covariance[:2, :2] = 1e4 * np.outer(along, along) + across_sigma_m**2 * np.outer(left, left)

    def copy(self) -> RouteEstimate:
        """An estimate of its own."""
        other = object.__new__(RouteEstimate)
        other._variances = self._variances.copy()
        other.mean, other.covariance = self.mean.copy(), self.covariance.copy()
        return other

    @property
    def position_m(self) -> Vector:
        """Meters (2,)."""
        return self.mean[:2]

    @property
    def scale_sigma(self) -> float:
        """Standard deviation of the scale error."""
        return float(np.sqrt(self.covariance[3, 3]))

    @property
    def velocity_error(self) -> float:
        """What the autopilot's velocity is found to be wrong by, as a share of it."""
        return float(np.hypot(self.mean[2], self.mean[3]))

    def truly(self, displacement_m: Vector) -> Vector:
        """A displacement (2,) by the autopilot's velocity without the errors that were found."""
        return (1 + float(self.mean[3])) * _turned(displacement_m, float(self.mean[2]))

    def predict(self, displacement_m: Vector) -> None:
        """Move on by a displacement (2,)."""
        driven_m = float(np.hypot(*displacement_m))
        self.mean[:2] += self.truly(displacement_m)
        kept = np.exp(-driven_m / np.array([HEADING_M, SCALE_M, DRIVE_M, CORRELATION_M]))
        transition = np.diag([1.0, 1.0, *kept])
        transition[:2, 2:4] = self._slopes(displacement_m)
        self.mean[2:] *= kept
        self.covariance = transition @ self.covariance @ transition.T
        wander = (WANDER**2 * driven_m, WANDER**2 * driven_m)
        self.covariance += np.diag([*wander, *(self._variances * (1 - kept**2))])

    def begin_drive(self, match_sigma_m: float) -> None:
        """The matches are of another drive from now on, whose error has nothing to do with the last one's."""
        self._variances[2:] = _shared(match_sigma_m)
        self.mean[4:] = self.covariance[4:, :] = self.covariance[:, 4:] = 0.0
        self.covariance[4:, 4:] = np.diag(self._variances[2:])

    def innovation(self, place_m: Vector, along: Vector, since_m: Vector, sigma_m: float) -> tuple[float, float]:
        """By how many meters along a match differs from what was expected, and that difference's deviation.

        The vehicle was at `place_m` (2,) along the unit vector `along` before it moved by `since_m`.
        """
        row = self._row(along, since_m, with_match=True)
        off_m = float(along @ (place_m - self._before(since_m)) - self.mean[4] - self.mean[5])
        return off_m, float(np.sqrt(row @ self.covariance @ row + sigma_m**2))

    def correct(self, place_m: Vector, along: Vector, since_m: Vector, sigma_m: float) -> None:
        """Correct by the along part of a match; sigma_m: of what is independent in each match."""
        off_m, _ = self.innovation(place_m, along, since_m, sigma_m)
        self._update(self._row(along, since_m, with_match=True), off_m, sigma_m**2)

    def keep_on_road(self, place_m: Vector, along: Vector, since_m: Vector, road_sigma_m: float) -> None:
        """The vehicle is on the road, so its position across is never less certain than the road is wide.

        As a measurement just as good as makes the variance that of the road: where it is less already, none.
        """
        left = np.array([-along[1], along[0]])
        row = self._row(left, since_m, with_match=False)
        variance = float(row @ self.covariance @ row)
        if variance > road_sigma_m**2:
            off_m = float(left @ (place_m - self._before(since_m)))
            self._update(row, off_m, 1 / (1 / road_sigma_m**2 - 1 / variance), position_only=True)

    def _before(self, since_m: Vector) -> Vector:
        before: Vector = self.mean[:2] - self.truly(since_m)
        return before

    def _slopes(self, displacement_m: Vector) -> NDArray[np.float64]:
        """Of `truly` against heading error and scale error, (2, 2)."""
        turned = _turned(displacement_m, self.mean[2])
        return np.column_stack([(1 + self.mean[3]) * np.array([turned[1], -turned[0]]), turned])

    def _row(self, direction: Vector, since_m: Vector, *, with_match: bool) -> Vector:
        """How a measurement along `direction` depends on the state."""
        return np.array(
            [*direction, *(-direction @ self._slopes(since_m)), *([1.0, 1.0] if with_match else [0.0, 0.0])]
        )

    def _update(self, row: Vector, off_m: float, variance: float, *, position_only: bool = False) -> None:
        weighted = self.covariance @ row
        gain = weighted / (row @ weighted + variance)
        if position_only:
            gain[2:] = 0.0
        self.mean = self.mean + gain * off_m
        kept = np.eye(6) - np.outer(gain, row)
        self.covariance = kept @ self.covariance @ kept.T + variance * np.outer(gain, gain)


def _turned(vector: Vector, clockwise_rad: float) -> Vector:
    """East and north of a vector that is turned clockwise."""
    sin, cos = np.sin(clockwise_rad), np.cos(clockwise_rad)
    return np.array([cos * vector[0] + sin * vector[1], cos * vector[1] - sin * vector[0]])


def _shared(match_m: float) -> tuple[float, float]:
    """The variance of matches: what stays for a drive, and what changes."""
    return STAYS * match_m**2, match_m**2
