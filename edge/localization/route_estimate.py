"""An extended Kalman filter for a vehicle on a mapped road: its position, and what its own velocity is wrong by. Pure.

    state      (8,): meters east, meters north, heading error in radians, scale error, minus the share of doubtful
               meters that were none, errors of the lines of matches along the road: one that stays for a drive, and
               one that changes within CORRELATION_M; and by how much all looks at a drive have the vehicle turned too
               far clockwise
    prediction position += (1 + scale) * R(heading error) * displacement by the autopilot's velocity, and that share
    correction east, north and of the heading by one look; or along the road by the line of a match, where the position
               across is never less certain than the road is wide, see `keep_on_road`

A displacement is (4,): meters east and north, and what is doubtful of them, see `Displacement`. All but
position, share and the last are first-order Gauss-Markov processes over the distance. The error of matches that
changes is what makes those within a correlation length of each other about one observation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.localization.look import AIM_RAD, SHARED_M, STANDS_M, Look, Vector
from edge.localization.odometer import Scale

CORRELATION_M = 60.0
"""Meters driven within which the errors of two matches are about the same."""
HEADING_M, SCALE_M, DRIVE_M = 250.0, 700.0, 3000.0
"""Correlation lengths of heading error and scale error of an autopilot's velocity, and of what stays for a drive. How
far the displacement was off across after 50 to 800 m on 25 recorded drives of ArduPilot fits 200 m and 1.5 degrees; the
headings of PX4 on two, 220 to 360 m and 2.3 degrees.
Wheels slip on another surface: where they measured 12 % less or 10 % more from the middle of a drive on, 4 of 8 drives
on four roads had positions beyond four standard deviations (6.0) with 10 km for the scale, and none with 700 m (3.4);
drives home were alike."""
DOUBTFUL = -0.5, 0.5
"""Mean and standard deviation of that share, since the doubtful meters are all true or none is."""
STAYS = 0.25
"""Share of the variance of matches that stays for a drive."""
AGREE_SIGMAS = 3.0
"""Standard deviations that two things may be apart and still agree: an honest difference is in 1 of 370 cases more."""
UNKNOWN_M = 100.0
"""Standard deviation of a position along the road that nothing bounds: more than a line of 40 frames is long."""
MAP_M = 200.0
"""Correlation length of what wanders of a map's positions, as of a receiver's that go by the sky for half a minute."""
WANDER = 0.03
"""Meters of error per square root of a meter driven that heading and scale do not explain."""


OF_ROAD = 0.0, 0.0
"""How much of the errors of matches a measurement across the road has: nothing."""
HEADING, SCALE, DOUBT, MATCH, AIM = 2, 3, 4, 5, 7
"""In the state: errors of heading and scale, the share of what is doubtful, the first error of matches, and the last
one, of how looks are turned."""


class Passed(NamedTuple):
    """A point of a drive of the map, or of a lane beside it, that a vehicle passed.

    place_m: meters (2,). along: unit vector (2,) of travel there. since_m: (4,) how the vehicle moved since.
    """

    place_m: Vector
    along: Vector
    since_m: Vector


@dataclass(frozen=True)
class MatchErrors:
    """Standard deviations of matches along the road, in meters.

    line_m: as measured, of which a part stays for a drive. whole_m: of what the positions of the map's drive are off by
    together.
    """

    line_m: float
    whole_m: float = 0.0

    @property
    def variances(self) -> tuple[float, float]:
        """What stays for a drive, and what changes."""
        return STAYS * self.line_m**2 + self.whole_m**2, self.line_m**2


@dataclass(frozen=True)
class VelocityErrors:
    """Standard deviations of an autopilot's velocity, and of matches along the road."""

    heading_rad: float
    scale: float
    match: MatchErrors


class RouteEstimate:
    """Mean and covariance of the state; positions are in meters of any local frame."""

    def __init__(self, position_m: Vector, covariance: NDArray[np.float64], errors: VelocityErrors) -> None:
        """Begin at a position (2,) with its covariance (2, 2)."""
        self._variances = np.array([errors.heading_rad**2, errors.scale**2, 0.0, *errors.match.variances, AIM_RAD**2])
        self._is_doubtful, self._shown = False, (0.0, errors.scale**2)  # mean and variance of the velocity's scale
        self.mean = np.array([*position_m, *np.zeros(len(self._variances))])
        self.covariance = np.diag([0.0, 0.0, *self._variances])
        self.covariance[:2, :2] = covariance
        self.since_looks_m = np.inf
        """Driven since the last correction by a look at this drive of the map."""

    @classmethod
    def on_road(cls, passed: Passed, road_sigma_m: float, errors: VelocityErrors) -> RouteEstimate:
        """Begin on a road that was passed: nothing is known along it before the first `correct`."""
        along, left = passed.along, left_of(passed.along)
        covariance = UNKNOWN_M**2 * np.outer(along, along) + road_sigma_m**2 * np.outer(left, left)
        estimate = cls(passed.place_m, covariance, errors)
        estimate.predict(passed.since_m)
        return estimate

    def copy(self) -> RouteEstimate:
        """An estimate of its own."""
        other = object.__new__(RouteEstimate)
        other._variances, other.since_looks_m = self._variances.copy(), self.since_looks_m
        other._is_doubtful, other._shown = self._is_doubtful, self._shown
        other.mean, other.covariance = self.mean.copy(), self.covariance.copy()
        return other

    @property
    def position_m(self) -> Vector:
        """Meters (2,)."""
        return self.mean[:2]

    @property
    def scale(self) -> Scale:
        """Share by which the autopilot's velocity is found to be too low."""
        return Scale(float(self.mean[SCALE]), float(np.sqrt(self.covariance[SCALE, SCALE])))

    @property
    def velocity_errors(self) -> tuple[float, float]:
        """What scale and heading, in radians, are expected to be wrong by: by their means and variances."""
        means, variances = self.mean[[SCALE, HEADING]], self.covariance.diagonal()[[SCALE, HEADING]]
        scale, heading_rad = np.sqrt(means**2 + variances)
        return float(scale), float(heading_rad)

    @property
    def heading_error(self) -> tuple[float, float]:
        """Radians by which the velocity must be turned clockwise, and one standard deviation."""
        return float(self.mean[HEADING]), math.sqrt(float(self.covariance[HEADING, HEADING]))

    @property
    def turned_rad(self) -> float:
        """By how much looks have the vehicle head further clockwise than its displacement goes."""
        return float(self.mean[HEADING] + self.mean[AIM])

    @property
    def velocity_error(self) -> float:
        """What the autopilot's velocity is found to be wrong by, as a share of it."""
        return float(np.hypot(self.mean[HEADING], self.mean[SCALE]))

    def truly(self, displacement_m: Vector) -> Vector:
        """Meters (..., 2) of displacements (..., 4) without the errors that were found."""
        moved_m = displacement_m[..., :2] + float(self.mean[DOUBT]) * displacement_m[..., 2:]
        return (1 + float(self.mean[SCALE])) * _turned(moved_m, float(self.mean[HEADING]))

    def predict(self, displacement_m: Vector, bridged_m2: float = 0.0) -> None:
        """Move on by a displacement (4,). bridged_m2: variance of its length where no speed was measured."""
        driven_m = float(np.hypot(*displacement_m[:2]))
        self.since_looks_m += driven_m
        was_doubtful, self._is_doubtful = self._is_doubtful, bool(displacement_m[2:].any())
        if self._is_doubtful and not was_doubtful:
            self.covariance[DOUBT, :] = self.covariance[:, DOUBT] = 0.0
            self.mean[DOUBT], self.covariance[DOUBT, DOUBT] = DOUBTFUL[0], DOUBTFUL[1] ** 2
        self.mean[:2] += self.truly(displacement_m)
        kept = np.exp(-driven_m / np.array([HEADING_M, SCALE_M, np.inf, DRIVE_M, CORRELATION_M, np.inf]))
        transition = np.diag([1.0, 1.0, *kept])
        transition[:2, 2:MATCH] = self._slopes(displacement_m)
        self.mean[2:] *= kept
        variances = self._variances.copy()
        shown, variances[SCALE - 2] = self._shown
        self.mean[SCALE] += (1 - kept[SCALE - 2]) * shown
        self.covariance = transition @ self.covariance @ transition.T
        along = displacement_m[:2] / max(driven_m, 1e-9)
        self.covariance[:2, :2] += bridged_m2 * np.outer(along, along)
        wander = (WANDER**2 * driven_m, WANDER**2 * driven_m)
        self.covariance += np.diag([*wander, *(variances * (1 - kept**2))])

    def expect(self, scale: Scale) -> None:
        """This was shown of the velocity's scale, which changes about it."""
        self._shown = scale.mean, scale.later**2
        self.covariance[SCALE, :] = self.covariance[:, SCALE] = 0.0
        self.mean[SCALE], self.covariance[SCALE, SCALE] = self._shown

    def doubt_scale(self) -> None:
        """Of the velocity's scale nothing was known: all that the state owes to it becomes as uncertain as it is."""
        found, assumed = float(self.covariance[SCALE, SCALE]), float(self._variances[SCALE - 2])
        self._shown = 0.0, assumed
        if found > 0:
            by_scale = self.covariance[:, SCALE] / found
            self.covariance += max(0.0, assumed - found) * np.outer(by_scale, by_scale)

    def begin_drive(self, match: MatchErrors) -> None:
        """The matches are of another drive from now on, whose error has nothing to do with the last one's."""
        self._variances[MATCH - 2 : AIM - 2] = match.variances
        self.since_looks_m = np.inf
        self.mean[MATCH:] = self.covariance[MATCH:, :] = self.covariance[:, MATCH:] = 0.0
        self.covariance[MATCH:, MATCH:] = np.diag(self._variances[MATCH - 2 :])

    def innovation(self, passed: Passed, sigma_m: float, faint: float = 1.0) -> tuple[float, float]:
        """By how many meters along a match differs from what was expected, and that difference's deviation."""
        row = self._row(passed.along, passed.since_m, (1.0, faint))
        return self._innovation(passed, passed.along, row, sigma_m)

    def aside(self, passed: Passed, road_sigma_m: float) -> tuple[float, float]:
        """Meters that the vehicle is expected beside the road of a match, and one standard deviation.

        road_sigma_m: of the position across the road.
        """
        left = left_of(passed.along)
        off_m, sigma_m = self._innovation(passed, left, self._row(left, passed.since_m, OF_ROAD), road_sigma_m)
        return abs(off_m), sigma_m

    def correct(self, passed: Passed, sigma_m: float, faint: float = 1.0) -> None:
        """Correct by the along part of a match; sigma_m: what is independent in each match; faint: see `Sighting`."""
        row = self._row(passed.along, passed.since_m, (1.0, faint))
        off_m, _ = self._innovation(passed, passed.along, row, sigma_m)
        self._update(row, off_m, sigma_m**2)

    @property
    def is_measured(self) -> bool:
        """Whether a look said within CORRELATION_M where the vehicle is, also across the road."""
        return self.since_looks_m < CORRELATION_M

    def at_look(self, look: Look) -> NDArray[np.float64]:
        """Covariance (2, 2) of the position as a look at the map would have it, whose positions wander.

        For the first one at a drive, they are off as a whole as well.
        """
        wandered = 2 * look.map_sigma_m**2 * (1 - math.exp(-self.since_looks_m / MAP_M))
        spread: NDArray[np.float64] = self.covariance[:2, :2] + wandered * np.eye(2)
        return spread + look.whole if math.isinf(self.since_looks_m) else spread

    def correct_by_look(self, look: Look) -> None:
        """Correct position and heading by what one picture says, which it shares in part with what the last one said.

        Not the heading where that is not as the displacement goes, as of a multirotor that flies to the side.
        """
        self.covariance[:2, :2] = self.at_look(look)
        shared = max(1.0, SHARED_M / max(self.since_looks_m, STANDS_M))
        self.since_looks_m = 0.0
        rows, noise = np.eye(2, len(self.mean)), shared * look.covariance
        off = look.position_m - self.position_m
        if look.course is not None:
            course_rad, variance = look.course
            row = np.zeros(len(self.mean))
            row[[HEADING, AIM]] = 1.0
            # A vehicle that goes backwards heads the other way.
            turned_rad = math.remainder(look.heading_rad - course_rad, math.pi) - self.turned_rad
            of_look = shared * look.pose
            of_look[2, 2] += variance
            if turned_rad**2 <= AGREE_SIGMAS**2 * (float(row @ self.covariance @ row) + of_look[2, 2]):
                rows, noise, off = np.vstack([rows, row]), of_look, np.append(off, turned_rad)
        gain = self.covariance @ rows.T @ np.linalg.inv(rows @ self.covariance @ rows.T + noise)
        self.mean = self.mean + gain @ off
        kept = np.eye(len(self.mean)) - gain @ rows
        self.covariance = kept @ self.covariance @ kept.T + gain @ noise @ gain.T

    def begin_at_look(self, look: Look) -> None:
        """Be where a look is, whatever was estimated; what is known of the velocity stays."""
        self.mean[:2], self.since_looks_m = look.position_m, 0.0
        self.covariance[:2, :] = self.covariance[:, :2] = 0.0
        self.covariance[:2, :2] = look.covariance

    def _innovation(self, passed: Passed, direction: Vector, row: Vector, sigma_m: float) -> tuple[float, float]:
        off_m = float(-direction @ self._off_m(passed) - row[MATCH:] @ self.mean[MATCH:])
        return off_m, float(np.sqrt(row @ self.covariance @ row + sigma_m**2))

    def keep_on_road(self, passed: Passed, road_sigma_m: float) -> None:
        """The vehicle is on the road, so its position across is never less certain than the road is wide.

        As a measurement just as good as makes the variance that of the road: where it is less already, none.
        """
        left = left_of(passed.along)
        row = self._row(left, passed.since_m, OF_ROAD)
        variance = float(row @ self.covariance @ row)
        if variance > road_sigma_m**2:
            off_m = float(-left @ self._off_m(passed))
            self._update(row, off_m, 1 / (1 / road_sigma_m**2 - 1 / variance), position_only=True)

    def bound(self, position_m: Vector, sigma_m: float) -> None:
        """GPS bounds the position, to (2,) with that deviation in each direction.

        As a measurement just good enough for that, like `keep_on_road`, since its errors stay for minutes. GPS corrects
        the velocity of the autopilot as well, whose errors therefore begin when it is lost.
        """
        self._shown = 0.0, float(self._variances[SCALE - 2])
        self.mean[2:MATCH] = self.covariance[2:MATCH, :] = self.covariance[:, 2:MATCH] = 0.0
        self.covariance[2:MATCH, 2:MATCH] = np.diag(self._variances[: MATCH - 2])
        for direction in np.eye(2):
            row = self._row(direction, np.zeros(4), OF_ROAD)
            variance = float(row @ self.covariance @ row)
            if variance > sigma_m**2:
                off_m = float(direction @ (position_m - self.position_m))
                self._update(row, off_m, 1 / (1 / sigma_m**2 - 1 / variance))

    def _off_m(self, passed: Passed) -> Vector:
        """How far from a point the vehicle was when it passed it, (2,)."""
        off_m: Vector = self.mean[:2] - self.truly(passed.since_m) - passed.place_m
        return off_m

    def _slopes(self, displacement_m: Vector) -> NDArray[np.float64]:
        """Of `truly` against heading error, scale error and the share of what is doubtful, (2, 3)."""
        scale, doubtful_m = 1 + self.mean[SCALE], _turned(displacement_m[2:], self.mean[HEADING])
        turned = _turned(displacement_m[:2], self.mean[HEADING]) + self.mean[DOUBT] * doubtful_m
        return np.column_stack([scale * np.array([turned[1], -turned[0]]), turned, scale * doubtful_m])

    def _row(self, direction: Vector, since_m: Vector, errors: tuple[float, ...]) -> Vector:
        """How a measurement along `direction` depends on the state; errors: on those of matches."""
        return np.array([*direction, *(-direction @ self._slopes(since_m)), *errors, 0.0])

    def _update(self, row: Vector, off_m: float, variance: float, *, position_only: bool = False) -> None:
        weighted = self.covariance @ row
        gain = weighted / (row @ weighted + variance)
        if position_only:
            gain[2:] = 0.0
        self.mean = self.mean + gain * off_m
        kept = np.eye(len(row)) - np.outer(gain, row)
        self.covariance = kept @ self.covariance @ kept.T + variance * np.outer(gain, gain)


def left_of(along: Vector) -> Vector:
    """The unit vectors (..., 2) to the left of others."""
    return np.stack([-along[..., 1], along[..., 0]], axis=-1)


def _turned(vector: Vector, clockwise_rad: float) -> Vector:
    """East and north (..., 2) of vectors that are turned clockwise."""
    sin, cos = math.sin(clockwise_rad), math.cos(clockwise_rad)
    turned: Vector = vector @ np.array([[cos, -sin], [sin, cos]])
    return turned
