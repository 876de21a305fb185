"""One Kalman filter of all that is unknown of vehicle, sensors and map (`state`), or many of them at once. Pure.

    prediction  position += (1 + scale) * R(heading) * displacement by the autopilot's velocity. The heading error turns
                by what the autopilot's heading turned otherwise than the gyros. Other errors are first-order
                Gauss-Markov processes over the way or over time
    correction  by one measurement, see `measurements`; the log likelihoods of all are summed, for the `hypotheses`

Many have the same motion and measurements, and run as one array: each figure has their number as its first dimension,
which is the (...) of all shapes here. One alone has none.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.localization.odometer_calibration import ScaleFactor
from edge.localization.state import (
    AGE,
    AGE_SIGMA_S,
    DOUBT,
    DRAG,
    GPS,
    GYRO,
    HEADING,
    NUMBERS,
    POSITION,
    SCALE,
    SLOTS,
    VELOCITY,
    DriveErrors,
    Matrix,
    Slot,
    Vector,
)

Used = NDArray[np.bool_]
"""Whether each of many filters has used a measurement (...)."""
EACH = "mean", "covariance", "likelihood", "since_pose_m", "keeps_gps", "_sigma", "_about"
"""What is not the same for all of many."""
CORRELATION_M = 60.0
"""Meters driven within which the errors of two sequence matches are about the same."""
GATE = {1: 9.0, 2: 11.83, 3: 14.16}
"""Square of the standard deviations beyond which a measurement is an outlier, by the number of dimensions."""
CREEPS_M2 = 0.3
"""What the positions of a map creep by less is added up first, see `DriveErrors`."""
DOUBTFUL = -0.5, 0.5
"""Mean and standard deviation of the share of doubtful meters, since they are all true or none is."""
OUTLIERS = 1e-3
"""Share of measurements that say nothing."""
SECOND_SHARE = 0.1
"""Share of keypoint poses that are a second solution of their geometry."""


@dataclass(frozen=True)
class FilterStep:
    """From one frame to the next.

    moved_m, doubtful_m: (2,) by the autopilot's velocity, and what of it is in doubt. turned_rad, turned_var: what its
    heading turned otherwise than by gyros, and the variance of that; None without gyros. unknown_m2: variance of the
    position, by what was driven while the velocity was unknown. bridged_m2: of the length, while it was bridged.
    yaw_rad: by what the autopilot's heading turned.
    """

    moved_m: Vector
    doubtful_m: Vector
    seconds: float
    turned_rad: float | None = None
    turned_var: float = 0.0
    unknown_m2: float = 0.0
    bridged_m2: float = 0.0
    yaw_rad: float = 0.0


class Filter:
    """Mean (..., n), covariance (..., n, n), and the log likelihood (...) of all that was measured.

    Positions are in meters of any local frame.
    """

    def __init__(self, heading_rad: float, scale: float) -> None:
        """Standard deviations of the autopilot's velocity. The position is not known before `place`."""
        self._sigma = NUMBERS["sigma"][: DRAG.stop].copy()
        self._sigma[HEADING], self._sigma[SCALE] = heading_rad, scale
        self._about = np.zeros(DRAG.stop)
        self.mean, self.covariance = np.zeros(DRAG.stop), np.diag(self._sigma**2)
        self.likelihood = np.array(0.0)
        self.since_pose_m = np.array(math.inf)
        """Driven since the last correction by a keypoint pose (...)."""
        self.since_lane_m = math.inf
        """Driven since a lane counted for or against it."""
        self.keeps_gps = np.array(False)
        """Whether the error of GPS stays as it is (...)."""
        self.has_gps = False
        """Whether GPS aids the velocity, which lacks the error of the compass then."""
        self.rates = np.zeros(3)
        """Meters east and north, and radians clockwise, in a second."""
        self._drives: dict[Hashable, tuple[int, DriveErrors]] = {}  # number of the slot; the newest match is last
        self._is_doubtful = False

    def _each(self, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Filter:
        other = object.__new__(Filter)
        other.__dict__.update(self.__dict__, _drives=self._drives.copy())
        for name in EACH:
            setattr(other, name, change(getattr(self, name)))
        return other

    def copy(self) -> Filter:
        """Those that go their own way."""
        return self._each(np.copy)

    def take(self, rows: int | Sequence[int] | None) -> Filter:
        """Of many: one, which is still a part of them, or copies of some. None: of one alone, the first of many."""
        return self._each(lambda each: each[rows, ...])

    @property
    def position_m(self) -> Vector:
        """Meters (..., 2)."""
        return self.mean[..., POSITION]

    @property
    def spread(self) -> Matrix:
        """Covariance (..., 2, 2) of the position."""
        return self.covariance[..., POSITION, POSITION]

    def value(self, at: slice) -> float:
        """A state of one filter alone."""
        return float(self.mean[at.start])

    def sigma(self, at: slice) -> float:
        """One standard deviation of it."""
        return math.sqrt(self.covariance[at.start, at.start])

    def are_found(self, rows: Sequence[int], states: slice) -> Used:
        """Whether two states of some of many are beyond doubt not 0."""
        return np.asarray(_normal(self.covariance[rows, states, states], self.mean[rows, states])[0] > GATE[2])

    def set(self, states: slice, mean: Vector | float, covariance: Matrix | float) -> None:
        """Replace what is known of some states, whatever the others showed of them."""
        self.mean[..., states] = mean
        self.covariance[..., states, :] = self.covariance[..., states] = 0.0
        self.covariance[..., states, states] = covariance

    def place(self, position_m: Vector, spread: Matrix) -> None:
        """Be there; what is known of the velocity stays."""
        self.set(POSITION, position_m, spread)
        self.since_pose_m[...] = math.inf

    def widen(self, states: slice, sigma: float) -> None:
        """They may have become anything else within that standard deviation."""
        self.covariance[..., states, states] += sigma**2 * np.eye(states.stop - states.start)

    def expect_scale(self, scale: ScaleFactor) -> None:
        """This was shown of the velocity's scale, about which it changes."""
        self._about[..., SCALE], self._sigma[..., SCALE] = scale.mean, scale.later
        self.set(SCALE, scale.mean, scale.later**2)

    def doubt_scale(self, sigma: float) -> None:
        """The scale is as uncertain as if nothing had been shown of it; all that was owed to it as well."""
        self._about[..., SCALE], self._sigma[..., SCALE] = 0.0, sigma
        found = self.covariance[..., SCALE, SCALE]
        by_scale = self.covariance[..., SCALE] / np.maximum(found, sys.float_info.min)
        more = np.where(found > 0, np.maximum(sigma**2 - found, 0.0), 0.0)
        self.covariance += more * by_scale @ by_scale.swapaxes(-1, -2)

    def expect_gps(self, sigma_m: float) -> None:
        """The standard deviation of its error."""
        self._sigma[..., GPS] = sigma_m

    def expect_age(self, sigma_s: float) -> None:
        """One standard deviation of the stamps' error, beside AGE_SIGMA_S."""
        self._sigma[..., AGE] = math.hypot(AGE_SIGMA_S, sigma_s)
        self.set(AGE, 0.0, self._sigma[..., AGE, None] ** 2)

    def lose_gps(self) -> None:
        """Its error will be another one."""
        self.set(GPS, 0.0, self._sigma[..., GPS, None] ** 2 * np.eye(2))
        self.set(DRAG, 0.0, 0.0)
        self.keeps_gps[...] = False

    def slot(self, drive: Hashable, errors: DriveErrors) -> Slot:
        """Of a drive, whose errors begin where the filter has not kept them."""
        number, before = self._drives.pop(drive) if drive in self._drives else (self._begin_drive(errors), errors)
        slot = SLOTS[number]
        errors = self._grown(slot, before, errors)
        self._drives[drive] = number, errors
        self._sigma[..., slot.map], self._sigma[..., slot.changes] = errors.map_m, errors.changes_m
        return slot

    def _begin_drive(self, errors: DriveErrors) -> int:
        """Make room for a drive, in place of the one that was matched longest ago."""
        number = len(self._drives)
        if number < len(SLOTS):
            more = [(0, 0)] * (self.mean.ndim - 1) + [(0, SLOTS[number].aim.stop - self.mean.shape[-1])]
            self.mean, self._sigma, self._about = (np.pad(one, more) for one in (self.mean, self._sigma, self._about))
            self.covariance = np.pad(self.covariance, [*more, more[-1]])
        else:
            number, _ = self._drives.pop(next(iter(self._drives)))
        slot = SLOTS[number]
        states = slice(slot.map.start, slot.aim.stop)
        self.set(states, 0.0, np.diag(NUMBERS["sigma"][states] ** 2))
        self.covariance[..., slot.whole, slot.whole] = errors.whole
        for part, sigma in ((slot.map, errors.map_m), (slot.stays, errors.stays_m), (slot.changes, errors.changes_m)):
            self.widen(part, sigma)
        return number

    def _grown(self, slot: Slot, before: DriveErrors, errors: DriveErrors) -> DriveErrors:
        """Errors of a drive from another place on, where its map may be less certain, or off by something else."""
        crept_m2, whole = errors.crept_m2, errors.whole
        if abs(crept_m2 - before.crept_m2) < CREEPS_M2:  # a vehicle that stands passes the same places again and again
            crept_m2 = before.crept_m2
        if np.trace(whole) <= np.trace(before.whole) + 1e-9:
            whole = before.whole
        self.widen(slot.map, math.sqrt(max(0.0, errors.map_m**2 - before.map_m**2)))
        self.widen(slot.whole, math.sqrt(abs(crept_m2 - before.crept_m2) / 2))
        self.covariance[..., slot.whole, slot.whole] += whole - before.whole
        return replace(errors, whole=whole, crept_m2=crept_m2)

    @property
    def newest(self) -> Slot | None:
        """Of the drive that was matched last."""
        return SLOTS[next(reversed(self._drives.values()))[0]] if self._drives else None

    @property
    def aged_m(self) -> tuple[Vector, Matrix]:
        """What the vehicle has driven from an exposure to its stamp (2,), and the covariance (2, 2) of that; of one."""
        moved_mps = self.rates[:2]
        return self.value(AGE) * moved_mps, self.sigma(AGE) ** 2 * np.outer(moved_mps, moved_mps)

    def truly(self, moved_m: Vector, doubtful_m: Vector) -> Vector:
        """Meters (..., 2) of a displacement without the errors that were found."""
        share, heading_rad = self.mean[..., DOUBT], self.mean[..., HEADING]
        return np.asarray((1 + self.mean[..., SCALE]) * turned(moved_m + share * doubtful_m, heading_rad))

    def slopes(self, moved_m: Vector, doubtful_m: Vector) -> Matrix:
        """Of `truly` against VELOCITY: heading error, scale error and the share of what is doubtful, (..., 2, 3)."""
        scale, heading_rad = 1 + self.mean[..., SCALE], self.mean[..., HEADING]
        unscaled_m = turned(moved_m + self.mean[..., DOUBT] * doubtful_m, heading_rad)
        return np.stack([-scale * left_of(unscaled_m), unscaled_m, scale * turned(doubtful_m, heading_rad)], axis=-1)

    def predict(self, step: FilterStep) -> None:
        """Move on."""
        driven_m, numbers = float(np.hypot(*step.moved_m)), NUMBERS[: self.mean.shape[-1]]
        if step.seconds > 0:
            self.rates = np.array([*step.moved_m, step.yaw_rad]) / step.seconds
        self.since_pose_m += driven_m
        self.since_lane_m += driven_m
        was_doubtful, self._is_doubtful = self._is_doubtful, bool(step.doubtful_m.any())
        if self._is_doubtful and not was_doubtful:
            self.set(DOUBT, DOUBTFUL[0], DOUBTFUL[1] ** 2)
        by_gyros_s = 0.0 if step.turned_rad is None else step.seconds
        kept = np.ones_like(self.mean) * np.exp(-driven_m / numbers["over_m"] - step.seconds / numbers["over_s"])
        if step.turned_rad is not None:
            kept[..., HEADING] = 1.0
        kept[self.keeps_gps, GPS] = 1.0
        noise = driven_m * numbers["walk_m"] ** 2 + by_gyros_s * numbers["walk_s"] ** 2
        noise = noise + self._sigma**2 * (1 - kept**2)
        noise[..., POSITION] += step.unknown_m2
        noise[..., HEADING] += step.turned_var
        diagonal = np.eye(len(numbers))
        transition = kept[..., None] * diagonal
        transition[..., HEADING, GYRO] = by_gyros_s
        transition[..., GPS, DRAG] = step.seconds * np.eye(2)
        mean = (transition @ self.mean[..., None])[..., 0] + (1 - kept) * self._about
        mean[..., POSITION] += self.truly(step.moved_m, step.doubtful_m)
        mean[..., HEADING] -= step.turned_rad or 0.0
        transition[..., POSITION, VELOCITY] = self.slopes(step.moved_m, step.doubtful_m)
        self.mean[...] = mean
        self.covariance[...] = transition @ self.covariance @ transition.swapaxes(-1, -2) + noise[..., None] * diagonal
        if step.bridged_m2:
            along = step.moved_m / max(driven_m, 1e-9)
            self.covariance[..., POSITION, POSITION] += step.bridged_m2 * np.outer(along, along)

    def rows(self, *parts: tuple[slice, Matrix]) -> Matrix:
        """A Jacobian (..., m, n) of m measurements, by the states that they depend on."""
        rows = np.zeros((*self.mean.shape[:-1], parts[0][1].shape[-2], self.mean.shape[-1]))
        for states, values in parts:
            rows[..., states] = values
        return rows

    def expected(self, rows: Matrix) -> Vector:
        """What such measurements (..., m) would be without their noise."""
        return np.asarray((rows @ self.mean[..., None])[..., 0])

    def weigh(
        self, spread: Matrix, innovation: Vector, anywhere: float, second: Matrix | None = None
    ) -> tuple[Vector, Matrix]:
        """Add the likelihood of an innovation with its covariance; chi2 and the inverse. The others: see `correct`."""
        chi2, inverse, density = _normal(spread, innovation)
        if anywhere:
            if second is not None:
                density = density + SECOND_SHARE * (_normal(spread + second, innovation)[2] - density)
            self.likelihood += np.log((1 - OUTLIERS) * density + OUTLIERS * anywhere)
        return chi2, inverse

    def pull(self, rows: Matrix, innovation: Vector, information: Matrix) -> None:
        """Correct the position alone by one number, whatever else would explain the innovation.

        information: 1 over the variance of the measurement (..., 1, 1), 0 where it says nothing.
        """
        shared = self.covariance @ rows.swapaxes(-1, -2)
        share = shared / (1 + information * (rows @ shared))
        share[..., POSITION.stop :, :] = 0.0
        gain = information * share
        self.mean += (gain @ innovation[..., None])[..., 0]
        kept = np.eye(self.mean.shape[-1]) - gain @ rows
        self.covariance[...] = kept @ self.covariance @ kept.swapaxes(-1, -2) + gain @ share.swapaxes(-1, -2)

    def correct(
        self, rows: Matrix, innovation: Vector, noise: Matrix, anywhere: float = 0.0, second: Matrix | None = None
    ) -> Used:
        """Correct by a measurement (..., m), unless it is an outlier; whether it was used (...).

        rows: its Jacobian (..., m, n). noise: covariance (..., m, m). anywhere: density of one that says nothing, in 1
        over the units of all m; 0 of one that is no evidence for any hypothesis. second: covariance (m, m) of the error
        of SECOND_SHARE of them.
        """
        shared = self.covariance @ rows.swapaxes(-1, -2)
        chi2, inverse = self.weigh(rows @ shared + noise, innovation, anywhere, second)
        is_used = np.asarray(chi2 <= GATE[innovation.shape[-1]])
        gain = is_used[..., None, None] * (shared @ inverse)
        self.mean += (gain @ innovation[..., None])[..., 0]
        covariance = self.covariance - gain @ shared.swapaxes(-1, -2)
        self.covariance[...] = (covariance + covariance.swapaxes(-1, -2)) / 2
        return is_used


def _normal(spread: Matrix, off: Vector) -> tuple[Vector, Matrix, Vector]:
    """The square in standard deviations (...), the inverse of the covariance, and the density (...)."""
    inverse = np.linalg.inv(spread)
    chi2 = (off[..., None, :] @ inverse @ off[..., None])[..., 0, 0]
    density = np.exp(-chi2 / 2) / np.sqrt(math.tau ** off.shape[-1] * np.linalg.det(spread))
    return np.asarray(chi2), np.asarray(inverse, np.float64), np.asarray(density)


def left_of(along: Vector) -> Vector:
    """The vectors (..., 2) to the left of others."""
    return np.asarray(along[..., ::-1] * np.array([-1.0, 1.0]))


def turned(vector: Vector, clockwise_rad: Vector) -> Vector:
    """East and north (..., 2) of vectors that are turned clockwise by angles (..., 1)."""
    return np.asarray(np.cos(clockwise_rad) * vector - np.sin(clockwise_rad) * left_of(vector))
