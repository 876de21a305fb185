"""One Kalman filter of all that is unknown of a vehicle, of its sensors and of the map. Pure.

    state       position; errors of the velocity (heading, scale), of the gyros and of the compass; the share of
                doubtful meters that were none; the error of GPS, and its spoofing drift; and for each of the last
                drives of the map: its error (what wanders, what is off as a whole), those of sequence matches with it
                (what stays, what changes), and how its camera is mounted
    prediction  position += (1 + scale) * R(heading) * displacement by the autopilot's velocity. The heading error turns
                by what the autopilot's heading turned otherwise than the gyros. Other errors are first-order
                Gauss-Markov processes over the way or over time
    correction  by one measurement, see `measurements`; the log likelihoods of all are summed, for the `hypotheses`

What two measurements share is a state, so that it counts once.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.localization.events import GPS_SIGMA_M
from edge.localization.odometer_calibration import ScaleFactor

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

POSITION, HEADING, SCALE, DOUBT, GYRO, COMPASS, GPS, DRAG = slice(0, 2), 2, 3, 4, 5, 6, slice(7, 9), slice(9, 11)
"""Where the states are that do not belong to a drive of the map."""
DRIVES, OF_DRIVE = 8, 7
"""Drives of the map whose errors are kept, twice as many as `map learn` keeps of a road, and states of each. The error
of one that made room and comes back counts as new evidence: with ten in turn, it is 1.5 times what the filter says."""
OF_ALL = DRAG.stop
"""States that do not belong to a drive of the map, and come first."""
CORRELATION_M = 60.0
"""Meters driven within which the errors of two sequence matches are about the same."""
LINE_M = 45.0
"""Correlation length of the error of sequence matches that changes, measured on three roads in five lights."""
GATE = {1: 9.0, 2: 11.83, 3: 14.16}
"""Square of the standard deviations beyond which a measurement is an outlier, by the number of dimensions."""
MAP_M = 200.0
"""Correlation length of what wanders of a map's positions, as of a receiver's that go by the sky for half a minute."""
CREEPS_M2 = 0.3
"""What the positions of a map creep by less is added up first, see `DriveErrors`."""
HEADING_M, COMPASS_M, SCALE_M = 250.0, 400.0, 700.0
"""Of heading errors without gyros, of the compass, and of the scale. The cross-track error of the displacement after 50
to 800 m on 25 recorded drives of ArduPilot fits 200 m and 1.5 degrees; the headings of PX4 on two, 220 to 360 m and
2.3. Wheels slip on another surface: with 10 km for the scale, 4 of 8 such drives had positions beyond four sigma."""
COMPASS_RAD, GYRO_RADPS = math.radians(1.5), math.radians(0.15)
"""One standard deviation of a heading that has no GPS, and of the bias of gyros. On 14 recorded drives of ArduPilot
headings were off by 0.8 to 1.4 degrees, and gyros by 0.06 to 0.15 degrees a second."""
TURNED_RAD, BIAS_RADPS = math.radians(0.05), math.radians(0.004)
"""By how much a heading by gyros and their bias change in a root second. On the same drives such headings are 1.1 to
1.8 degrees from a constant bias within 240 s."""
GPS_SHARE, GPS_S = 2 / 3, 60.0
"""Of what a receiver reports as its standard deviation: how much of it changes, and the time in which it does."""
GPS_M = GPS_SHARE * GPS_SIGMA_M
"""One standard deviation of an honest GPS in each direction."""
WANDER = 0.03
"""Meters of error per square root of a meter driven that heading and scale do not explain."""
DOUBTFUL = -0.5, 0.5
"""Mean and standard deviation of the share of doubtful meters, since they are all true or none is."""
OUTLIERS = 1e-3
"""Share of measurements that say nothing."""


@dataclass(frozen=True)
class DriveErrors:
    """Standard deviations of what is wrong of one drive of the map, in meters and radians.

    map_m: what wanders of its positions, in each direction. whole: covariance (2, 2) of what they are off by together.
    stays_m, changes_m: of sequence matches along-track, for the whole drive and within CORRELATION_M. lane_m: of the
    vehicle's lane. aim_rad: of the yaw error of all keypoint poses. crept_m2: see `MapDrive`; between two places,
    the variance of what their positions are off by against each other.
    """

    map_m: float
    whole: Matrix
    stays_m: float
    changes_m: float
    lane_m: float
    aim_rad: float
    crept_m2: float = 0.0


@dataclass(frozen=True)
class FilterStep:
    """From one frame to the next.

    moved_m, doubtful_m: (2,) by the autopilot's velocity, and what of it is in doubt. turned_rad, turned_var: what its
    heading turned otherwise than by gyros, and the variance of that; None without gyros. unknown_m2: variance of the
    position, by what was driven while the velocity was unknown. bridged_m2: of the length, while it was bridged.
    """

    moved_m: Vector
    doubtful_m: Vector
    seconds: float
    turned_rad: float | None = None
    turned_var: float = 0.0
    unknown_m2: float = 0.0
    bridged_m2: float = 0.0


class Slot(NamedTuple):
    """Where the states of one drive of the map are.

    map, whole: what wanders, east and north, and what all positions are off by. stays, changes: of sequence matches
    along-track, for the drive and within CORRELATION_M. aim: yaw error of keypoint poses, clockwise. all: of these.
    """

    map: slice
    whole: slice
    stays: int
    changes: int
    aim: int
    all: slice


def _slot(number: int) -> Slot:
    row = OF_ALL + OF_DRIVE * number
    return Slot(slice(row, row + 2), slice(row + 2, row + 4), row + 4, row + 5, row + 6, slice(row, row + OF_DRIVE))


class Filter:
    """Mean, covariance, and the log likelihood of all that was measured; positions are in meters of any local frame."""

    def __init__(self, heading_rad: float, scale: float) -> None:
        """Standard deviations of the autopilot's velocity. The position is not known before `place`."""
        self.mean, self.covariance = np.zeros(OF_ALL), np.zeros((OF_ALL, OF_ALL))
        self.likelihood = 0.0
        self.since_pose_m = math.inf
        """Driven since the last correction by a keypoint pose."""
        self.since_lane_m = math.inf
        """Driven since a lane counted for or against it."""
        self._heading_rad, self._scale = heading_rad, ScaleFactor(0.0, scale)
        self._gps_m, self.keeps_gps = GPS_M, False  # whether its error stays as it is
        self.has_gps = False
        """Whether GPS aids the velocity."""
        self._drives: dict[Hashable, tuple[int, DriveErrors]] = {}  # number of the slot; the newest match is last
        self._is_doubtful = False
        for at, sigma in ((HEADING, heading_rad), (SCALE, scale), (GYRO, GYRO_RADPS), (COMPASS, COMPASS_RAD)):
            self.covariance[at, at] = sigma**2
        self.lose_gps()

    def copy(self) -> Filter:
        """One that goes its own way."""
        other = object.__new__(Filter)
        other.__dict__.update(self.__dict__)
        other.mean, other.covariance = self.mean.copy(), self.covariance.copy()
        other._drives = self._drives.copy()
        return other

    @property
    def position_m(self) -> Vector:
        """Meters (2,)."""
        return self.mean[POSITION]

    @property
    def spread(self) -> Matrix:
        """Covariance (2, 2) of the position."""
        return self.covariance[POSITION, POSITION]

    def sigma(self, at: int) -> float:
        """One standard deviation of a state."""
        return math.sqrt(self.covariance[at, at])

    def is_found(self, states: slice) -> bool:
        """Whether two states are beyond doubt not 0."""
        mean = self.mean[states]
        return bool(mean @ np.linalg.solve(self.covariance[states, states], mean) > GATE[2])

    def set(self, states: slice | int, mean: Vector | float, covariance: Matrix | float) -> None:
        """Replace what is known of some states, whatever the others showed of them."""
        self.mean[states] = mean
        self.covariance[states, :] = self.covariance[:, states] = 0.0
        self.covariance[states, states] = covariance

    def place(self, position_m: Vector, spread: Matrix) -> None:
        """Be there; what is known of the velocity stays."""
        self.set(POSITION, position_m, spread)
        self.since_pose_m = math.inf

    def widen(self, states: slice, sigma: float) -> None:
        """They may have become anything else within that standard deviation."""
        self.covariance[states, states] += sigma**2 * np.eye(states.stop - states.start)

    def expect_scale(self, scale: ScaleFactor) -> None:
        """This was shown of the velocity's scale, about which it changes."""
        self._scale = scale
        self.set(SCALE, scale.mean, scale.later**2)

    def doubt_scale(self, sigma: float) -> None:
        """The scale is as uncertain as if nothing had been shown of it; all that was owed to it as well."""
        found, self._scale = self.covariance[SCALE, SCALE], ScaleFactor(0.0, sigma)
        if 0 < found < sigma**2:
            by_scale = self.covariance[:, SCALE] / found
            self.covariance += (sigma**2 - found) * np.outer(by_scale, by_scale)

    def expect_gps(self, sigma_m: float) -> None:
        """The standard deviation of its error."""
        self._gps_m = sigma_m

    def lose_gps(self) -> None:
        """Its error will be another one."""
        self.set(GPS, 0.0, self._gps_m**2 * np.eye(2))
        self.set(DRAG, 0.0, 0.0)

    def slot(self, drive: Hashable, errors: DriveErrors) -> Slot:
        """Of a drive, whose errors begin where the filter has not kept them."""
        known = self._drives.pop(drive, None)
        if known is None:
            number = self._begin_drive(errors)
        else:
            number, before = known
            errors = before if errors is before else self._grown(_slot(number), before, errors)
        self._drives[drive] = number, errors
        return _slot(number)

    def _begin_drive(self, errors: DriveErrors) -> int:
        """Make room for a drive, in place of the one that was matched longest ago."""
        number = len(self._drives)
        if number < DRIVES:
            self.mean = np.append(self.mean, np.zeros(OF_DRIVE))
            self.covariance = np.pad(self.covariance, (0, OF_DRIVE))
        else:
            number, _ = self._drives.pop(next(iter(self._drives)))
        slot = _slot(number)
        covariance = np.zeros((OF_DRIVE, OF_DRIVE))
        covariance[:2, :2], covariance[2:4, 2:4] = errors.map_m**2 * np.eye(2), errors.whole
        covariance[range(4, 7), range(4, 7)] = np.square([errors.stays_m, errors.changes_m, errors.aim_rad])
        self.set(slot.all, 0.0, covariance)
        return number

    def _grown(self, slot: Slot, before: DriveErrors, errors: DriveErrors) -> DriveErrors:
        """Errors of a drive from another place on, where its map may be less certain, or off by something else."""
        crept_m2 = abs(errors.crept_m2 - before.crept_m2)
        if crept_m2 >= CREEPS_M2:
            self.covariance[slot.whole, slot.whole] += crept_m2 / 2 * np.eye(2)
        else:  # a vehicle that stands passes the same places again and again
            errors = replace(errors, crept_m2=before.crept_m2)
        if errors.map_m > before.map_m:
            self.covariance[slot.map, slot.map] += (errors.map_m**2 - before.map_m**2) * np.eye(2)
        if errors.whole[0, 0] + errors.whole[1, 1] > before.whole[0, 0] + before.whole[1, 1] + 1e-9:
            self.covariance[slot.whole, slot.whole] += errors.whole - before.whole
        else:
            errors = replace(errors, whole=before.whole)
        return errors

    @property
    def newest(self) -> Slot | None:
        """Of the drive that was matched last."""
        return _slot(next(reversed(self._drives.values()))[0]) if self._drives else None

    def truly(self, moved_m: Vector, doubtful_m: Vector) -> Vector:
        """Meters (2,) of a displacement without the errors that were found."""
        return (1 + float(self.mean[SCALE])) * turned(moved_m + self.mean[DOUBT] * doubtful_m, self.mean[HEADING])

    def slopes(self, moved_m: Vector, doubtful_m: Vector) -> Matrix:
        """Of `truly` against heading error, scale error and the share of what is doubtful, (2, 3)."""
        scale, sin, cos = 1 + self.mean[SCALE], math.sin(self.mean[HEADING]), math.cos(self.mean[HEADING])
        to_east, to_north = (cos * doubtful_m[0] + sin * doubtful_m[1], cos * doubtful_m[1] - sin * doubtful_m[0])
        share = self.mean[DOUBT]
        east_m = cos * moved_m[0] + sin * moved_m[1] + share * to_east
        north_m = cos * moved_m[1] - sin * moved_m[0] + share * to_north
        return np.array([[scale * north_m, east_m, scale * to_east], [-scale * east_m, north_m, scale * to_north]])

    def predict(self, step: FilterStep) -> None:
        """Move on."""
        driven_m = float(np.hypot(*step.moved_m))
        self.since_pose_m += driven_m
        self.since_lane_m += driven_m
        was_doubtful, self._is_doubtful = self._is_doubtful, bool(step.doubtful_m.any())
        if self._is_doubtful and not was_doubtful:
            self.set(DOUBT, DOUBTFUL[0], DOUBTFUL[1] ** 2)
        size = len(self.mean)
        kept, noise, change = np.ones(size), np.zeros(size), np.zeros(size)

        def changes(at: int | slice, share: float, sigma: float, about: float = 0.0) -> None:
            """A Gauss-Markov process about a mean."""
            kept[at], noise[at] = share, sigma**2 * (1 - share**2)
            change[at] = (1 - share) * (about - self.mean[at])

        noise[POSITION] = WANDER**2 * driven_m + step.unknown_m2
        change[POSITION] = self.truly(step.moved_m, step.doubtful_m)
        changes(SCALE, math.exp(-driven_m / SCALE_M), self._scale.later, self._scale.mean)
        changes(COMPASS, math.exp(-driven_m / COMPASS_M), COMPASS_RAD)
        if not self.keeps_gps:
            changes(GPS, math.exp(-step.seconds / GPS_S), self._gps_m)
        if step.turned_rad is None:
            changes(HEADING, math.exp(-driven_m / HEADING_M), self._heading_rad)
        else:
            change[HEADING] = self.mean[GYRO] * step.seconds - step.turned_rad
            noise[HEADING] = step.turned_var + TURNED_RAD**2 * step.seconds
            noise[GYRO] = BIAS_RADPS**2 * step.seconds
        change[GPS] += step.seconds * self.mean[DRAG]
        of_map, of_line = math.exp(-driven_m / MAP_M), math.exp(-driven_m / LINE_M)
        for number, errors in self._drives.values():
            slot = _slot(number)
            changes(slot.map, of_map, errors.map_m)
            changes(slot.changes, of_line, errors.changes_m)
        transition = np.diag(kept)
        transition[POSITION, HEADING:GYRO] = self.slopes(step.moved_m, step.doubtful_m)
        transition[HEADING, GYRO] = step.seconds if step.turned_rad is not None else 0.0
        transition[7, 9] = transition[8, 10] = step.seconds
        self.mean = self.mean + change
        self.covariance = transition @ self.covariance @ transition.T
        self.covariance[np.diag_indices(size)] += noise
        if step.bridged_m2:
            along = step.moved_m / max(driven_m, 1e-9)
            self.covariance[POSITION, POSITION] += step.bridged_m2 * np.outer(along, along)

    def rows(self, *parts: tuple[slice | int, Matrix | Sequence[float] | Sequence[Vector]]) -> Matrix:
        """A Jacobian of so many measurements, by the states that they depend on."""
        rows = np.zeros((len(parts[0][1]), len(self.mean)))
        for at, values in parts:
            rows[:, at] = values
        return rows

    def weigh(
        self, spread: Matrix, innovation: Vector, anywhere: float, second: tuple[float, Matrix] | None = None
    ) -> tuple[float, Matrix, float]:
        """Add the likelihood of an innovation with its covariance, returns its `_normal`; the others: see `correct`."""
        density = (normal := _normal(spread, innovation))[2]
        if second is not None:
            density += second[0] * (_normal(spread + second[1], innovation)[2] - density)
        self.likelihood += math.log((1 - OUTLIERS) * density + OUTLIERS * anywhere)
        return normal

    def pull(self, rows: Matrix, innovation: Vector, variance: float) -> None:
        """Correct the position alone, whatever else would explain the innovation."""
        shared = self.covariance @ rows.T
        gain = shared / (rows @ shared + variance)
        gain[DOUBT + 1 :] = gain[HEADING : DOUBT + 1] = 0.0
        self.mean = self.mean + gain @ innovation
        kept = np.eye(len(self.mean)) - gain @ rows
        self.covariance = kept @ self.covariance @ kept.T + variance * gain @ gain.T

    def correct(
        self,
        rows: Matrix,
        innovation: Vector,
        noise: Matrix,
        anywhere: float = 0.0,
        second: tuple[float, Matrix] | None = None,
    ) -> bool:
        """Correct by a measurement (n,), unless it is an outlier; whether it was used.

        rows: its Jacobian (n, SIZE). noise: covariance (n, n). anywhere: density of one that says nothing, in 1 over
        the units of all n; 0 of one that is no evidence for any hypothesis. second: share of those that are wrong by
        little, and the covariance (n, n) of by how much.
        """
        shared = self.covariance @ rows.T
        spread = rows @ shared + noise
        chi2, inverse, _ = self.weigh(spread, innovation, anywhere, second) if anywhere else _normal(spread, innovation)
        if chi2 > GATE[len(innovation)]:
            return False
        gain = shared @ inverse
        self.mean = self.mean + gain @ innovation
        covariance = self.covariance - gain @ shared.T
        self.covariance = (covariance + covariance.T) / 2
        return True


def _normal(spread: Matrix, off: Vector) -> tuple[float, Matrix, float]:
    """The square in standard deviations, the inverse of the covariance, and the density."""
    # A single number, as most are: to the last bit what LAPACK has.
    inverse = 1 / spread if len(off) == 1 else np.linalg.inv(spread).astype(np.float64, copy=False)
    determinant = float(spread[0, 0] if len(off) == 1 else np.linalg.det(spread))
    chi2 = float(off @ inverse @ off)
    return chi2, inverse, math.exp(-chi2 / 2) / math.sqrt(math.tau ** len(off) * determinant)


def turned(vector: Vector, clockwise_rad: float) -> Vector:
    """East and north (..., 2) of vectors that are turned clockwise."""
    sin, cos = math.sin(clockwise_rad), math.cos(clockwise_rad)
    result: Vector = vector @ np.array([[cos, -sin], [sin, cos]])
    return result
