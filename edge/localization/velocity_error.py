"""What an autopilot's velocity is wrong by where nothing measures it, found from places."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BEGINS_MPS, GROWS_MPS2 = 0.1, 0.15
"""Standard deviations of the error of a velocity when nothing measures it any more, and of its growth."""
WANDERS_MPS, WANDERS_MPS2 = 0.5, 0.015
"""By how much both change besides within a second: with these, on three recorded drives of PX4 without a velocity aid,
what is left of the error is 0.1 to 0.8 of its standard deviation (rms)."""
PULLED_MPS_PER_M, PULLED_NS = 0.15, 1_000_000_000
"""A position of ours that moves the autopilot's changes its velocity as well, within that time: by 0.03 to 0.13 m/s per
meter on a recorded drive of PX4."""
ANY_SPEED_MPS, ACCELERATES_MPS, REPORTED_MPS = 20.0, 1.0, 0.1
"""Standard deviations of the vehicle's speed: before the first report, of what it changes within a second, and of a
report besides its error."""
STANDS_NS = 1_500_000_000
"""How long a picture must stay the same."""
ANYWHERE_M, JUMPED_M, WANDERS_M = 1000.0, 30.0, 0.3
"""Of the reported way against a drive of the map: its standard deviation before the first line, the difference from
which on a line lies elsewhere on the drive, and what else changes within a second."""
LINE_M, SLOPE_MPS, HALT_MPS, LEFT_MPS = 12.0, 1.0, 0.1, 0.5
"""Standard deviations of the middle of a line, of which many are alike; of the error by the slope of the first one, by
a halt, and by the velocity to the left within a second."""


class _Row(NamedTuple):
    """A frame of a line: how far the reported velocity has led ahead by then, and where the vehicle headed (2,).

    changed_mps: (2,) by what positions of ours had changed the error by then, as the reports showed it.
    """

    stamp_ns: int
    reported_m: float
    ahead: NDArray[np.float64]
    changed_mps: NDArray[np.float64]


def _means(rows: Sequence[_Row]) -> tuple[NDArray[np.float64], float]:
    """Over the time between the rows: of ahead (2,), and of what the error ahead was less than at the last of them."""
    times = np.diff([row.stamp_ns for row in rows]).astype(np.float64)
    less_mps = [row.ahead @ (rows[-1].changed_mps - row.changed_mps) for row in rows[1:]]
    ahead: NDArray[np.float64] = np.average([row.ahead for row in rows[1:]], axis=0, weights=times)
    return ahead, float(np.average(less_mps, weights=times))


class VelocityError:
    """What an autopilot's velocity is wrong by where nothing measures it, found from places: a Kalman filter.

    state (6,): meters by which the reported velocity has led further ahead than the drive of the map that is matched;
    error in m/s east and north; its growth in m/s^2 ahead and to the left; the vehicle's speed ahead in m/s.

    Such a velocity is integrated from accelerometers: its error grows slowly, but jumps where a position of ours moves
    the autopilot's. A vehicle's speed does not jump, so that most of a sudden change is error. Measured are where the
    middles of the matched lines are, the velocity to the left, since a vehicle moves the way it heads, and all of the
    velocity while the picture stays the same, since the vehicle stands. It goes on with every frame, used or not: by
    an error from before a jump, the vehicle may seem to stand, and then no frame is used.
    """

    def __init__(self, length: int) -> None:
        """length: frames in a sequence."""
        self._length = length
        self.begin()

    def begin(self) -> None:
        """The velocity is measured: what it is wrong by, once it is not, begins now."""
        self._mean = np.zeros(6)
        self._covariance = np.diag([ANYWHERE_M, BEGINS_MPS, BEGINS_MPS, GROWS_MPS2, GROWS_MPS2, ANY_SPEED_MPS]) ** 2
        self._last_ns: int | None = None
        self._ahead = np.array([0.0, 1.0])
        self._reported_m, self._changed_mps = 0.0, np.zeros(2)
        self.clear()

    def clear(self) -> None:
        """The next frame begins a new line."""
        self._rows: deque[_Row] = deque(maxlen=self._length)
        self._drive: object = None
        self._stands_ns: int | None = None

    @property
    def error_mps(self) -> tuple[float, float]:
        """East and north: the velocity less this is right."""
        return float(self._mean[1]), float(self._mean[2])

    @property
    def sigma_mps(self) -> float:
        """One standard deviation of the error ahead."""
        return math.sqrt(self._ahead @ self._covariance[1:3, 1:3] @ self._ahead)

    def predict(
        self, stamp_ns: int, heading_rad: float, velocity_mps: tuple[float, float], pulled_m: float = 0.0
    ) -> None:
        """Go on to a moment, at which the vehicle heads there and its velocity is reported as that, east and north.

        pulled_m: how far our positions of the last PULLED_NS were from the autopilot's own.
        """
        elapsed_s = 0.0 if self._last_ns is None else max(0.0, (stamp_ns - self._last_ns) / 1e9)
        self._last_ns = stamp_ns
        ahead = self._ahead = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        left, reported_mps = np.array([-ahead[1], ahead[0]]), np.array(velocity_mps)
        wanders_mps = math.hypot(WANDERS_MPS, PULLED_MPS_PER_M * pulled_m)
        moves = np.eye(6)
        moves[0, 1:3] = elapsed_s * ahead
        moves[1:3, 3:5] = elapsed_s * np.column_stack([ahead, left])
        noise = [WANDERS_M, wanders_mps, wanders_mps, WANDERS_MPS2, WANDERS_MPS2, ACCELERATES_MPS]
        self._mean = moves @ self._mean
        self._covariance = moves @ self._covariance @ moves.T + np.diag(elapsed_s * np.square(noise))
        if elapsed_s:
            left_mps = LEFT_MPS / math.sqrt(elapsed_s)
            self._measure(np.array([0.0, *left, 0.0, 0.0, 0.0]), float(left @ reported_mps), left_mps)
        before_mps = self._mean[1:3]
        self._measure(np.array([0.0, *ahead, 0.0, 0.0, 1.0]), float(ahead @ reported_mps), REPORTED_MPS)
        by_pull = 1 - (WANDERS_MPS / wanders_mps) ** 2
        self._changed_mps = self._changed_mps + by_pull * (self._mean[1:3] - before_mps)
        self._reported_m += elapsed_s * float(ahead @ reported_mps)

    def add_frame(self, stamp_ns: int) -> None:
        """A frame at which the vehicle moved."""
        self._stands_ns = None
        self._rows.append(_Row(stamp_ns, self._reported_m, self._ahead, self._changed_mps))

    def use_line(self, drive: object, middle_m: float, length_m: float) -> None:
        """The believed match of the frame that was added last, by its line along that drive, in the way of travel."""
        if len(self._rows) < self._length:
            return
        rows = list(self._rows)
        newest, half = rows[-1], rows[self._length // 2 :]
        since_s = (newest.stamp_ns - half[0].stamp_ns) / 1e9
        ahead, less_mps = _means(half)
        row = np.array([1.0, *(-since_s * ahead), since_s**2 / 2, 0.0, 0.0])
        # Before a position of ours changed the error, the way was that of another one.
        off_m = half[0].reported_m - middle_m - since_s * less_mps
        if drive != self._drive or abs(off_m - row @ self._mean) > JUMPED_M:
            self._drive = drive
            took_s = (newest.stamp_ns - rows[0].stamp_ns) / 1e9
            too_far_mps = (newest.reported_m - rows[0].reported_m - length_m) / took_s
            ahead, less_mps = _means(rows)
            slope = np.array([0.0, *ahead, -took_s / 2, 0.0, 0.0])
            # Of the mean over the line, from which the newest error has wandered away.
            wandered_mps = WANDERS_MPS * math.sqrt(took_s / 3)
            self._measure(slope, too_far_mps + less_mps, math.hypot(SLOPE_MPS, wandered_mps))
            self._mean[0] += off_m - row @ self._mean
            self._covariance[0, :] = self._covariance[:, 0] = 0.0
            self._covariance[0, 0] = ANYWHERE_M**2
        self._measure(row, off_m, LINE_M)

    def use_halt(self, stamp_ns: int, velocity_mps: tuple[float, float]) -> None:
        """A frame that showed what the last one did, and the velocity: if the vehicle stands, that is the error.

        Two frames that are alike may also be of a place that looks like the next one.
        """
        self._stands_ns = stamp_ns if self._stands_ns is None else self._stands_ns
        if stamp_ns - self._stands_ns >= STANDS_NS:
            self._rows.clear()
            self._drive = None
            for axis, speed_mps in enumerate(velocity_mps, start=1):
                self._measure(np.eye(6)[axis], speed_mps, HALT_MPS)

    def _measure(self, row: NDArray[np.float64], measured: float, sigma: float) -> None:
        gain = self._covariance @ row / (row @ self._covariance @ row + sigma**2)
        self._mean = self._mean + gain * (measured - row @ self._mean)
        self._covariance = (np.eye(6) - np.outer(gain, row)) @ self._covariance
