"""How far the vehicle has driven and moved, by its own speed and velocity, at the moment of any frame.

Where nothing measures its velocity, `VelocityError` finds from places what that is wrong by.

Both are integrated by the trapezoid rule, whatever the autopilot's position jumps to. Driving backwards leads over
places that were passed already, so the distance to sample by stands still until the vehicle is further than before.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SPEED_VALID_NS = 1_000_000_000  # how long a speed holds beyond its stamp
LONGEST_GAP_NS = 2_000_000_000  # the longest silence that two reports are believed to span
STANDING_MPS = 0.1  # a standing EKF still reports 0.04 m/s (recorded Rover 4.6.3)
MAX_SPEED_MPS = 350.0  # a speed beyond it is damage, or not a number
KEPT = 1024
TURN_FRAMES, COURSE_M, AROUND_RAD = 36, 5.0, math.radians(135)
"""Used frames of which the first and the last third are held against each other, the distance that gives a course, and
how far it must have turned."""
BEGINS_MPS, GROWS_MPS2 = 0.1, 0.15
"""Standard deviations of the error of a velocity when nothing measures it any more, and of its growth."""
WANDERS_MPS, WANDERS_MPS2 = 0.6, 0.015
"""By how much both change besides within a second: with these, on three recorded drives of PX4 without a velocity aid,
what is left of the error is 0.2 to 0.9 of its standard deviation (rms)."""
STANDS_NS = 1_500_000_000
"""How long a picture must stay the same."""
ANYWHERE_M, JUMPED_M, WANDERS_M = 1000.0, 30.0, 0.3
"""Of the odometer against a drive of the map: its standard deviation before the first line, the difference from which
on a line lies elsewhere on the drive, and what else changes within a second."""
LINE_M, SLOPE_MPS, HALT_MPS, LEFT_MPS = 12.0, 1.0, 0.1, 1.0
"""Standard deviations of the middle of a line, of which many are alike; of the error by the slope of the first one, by
a halt, and by the velocity to the left."""
BACKED_M = 30.0
"""The most that must be driven again before the distance grows; further back nobody remembers the places."""


@dataclass(frozen=True)
class Displacement:
    """Meters east and north since the beginning of a leg; those of different legs cannot be compared.

    drift: share of the newest meters that may be wrong, where nothing measures the velocity; 0 where something does.
    """

    leg: int
    east_m: float
    north_m: float
    drift: float = 0.0


class ReportedMotion(NamedTuple):
    """What an autopilot reports of its motion at a moment.

    distance_m: driven, None where not known. is_measured: whether it is by sensors, or by the velocity less what was
    found of its error. velocity_mps: east and north, as reported. heading_rad: clockwise from north.
    """

    distance_m: float | None
    is_measured: bool
    velocity_mps: tuple[float, float]
    heading_rad: float

    @property
    def measured_m(self) -> float | None:
        """Meters driven, None where nothing measures them."""
        return self.distance_m if self.is_measured else None


class _Integral:
    """A rate with one or more components, integrated over time; the last KEPT reports can be looked up."""

    def __init__(self, valid_ns: int) -> None:
        """valid_ns: how long the newest rate holds beyond its stamp."""
        self._valid_ns = valid_ns
        self._stamps_ns: list[int] = []
        self._totals: list[tuple[float, ...]] = []
        self._rate: tuple[float, ...] = ()

    @property
    def last_ns(self) -> int | None:
        """Stamp of the newest report, None before the first."""
        return self._stamps_ns[-1] if self._stamps_ns else None

    @property
    def total(self) -> tuple[float, ...] | None:
        """The integral up to the newest report, None before the first."""
        return self._totals[-1] if self._totals else None

    def add(self, stamp_ns: int, *rate: float) -> None:
        """A rate at a time after the newest; after a gap that is too long the integral goes on from where it was."""
        total = self.total or (0.0,) * len(rate)
        gap_ns = stamp_ns - self._stamps_ns[-1] if self._stamps_ns else 0
        if 0 < gap_ns <= LONGEST_GAP_NS:
            total = tuple(
                before + (new + old) / 2 * gap_ns / 1e9
                for before, new, old in zip(total, rate, self._rate, strict=True)
            )
        self._stamps_ns.append(stamp_ns)
        self._totals.append(total)
        self._rate = rate
        if len(self._stamps_ns) > 2 * KEPT:
            del self._stamps_ns[:KEPT], self._totals[:KEPT]

    def clear(self) -> None:
        """Start at zero with the next report."""
        self._stamps_ns, self._totals = [], []

    def at(self, stamp_ns: int) -> tuple[float, ...] | None:
        """The integral at a moment: between two reports by interpolation; None where no rate is valid."""
        index = bisect_right(self._stamps_ns, stamp_ns)
        if index == 0:
            return None
        before_ns, before = self._stamps_ns[index - 1], self._totals[index - 1]
        if index == len(self._stamps_ns):
            ahead_ns = stamp_ns - before_ns
            if ahead_ns > self._valid_ns:
                return None
            return tuple(value + rate * ahead_ns / 1e9 for value, rate in zip(before, self._rate, strict=True))
        share = (stamp_ns - before_ns) / (self._stamps_ns[index] - before_ns)
        after = self._totals[index]
        return tuple(value + share * (end - value) for value, end in zip(before, after, strict=True))


class DeadReckoning:
    """Distance driven by the best source of speed that still reports, and displacement by velocity."""

    def __init__(self) -> None:
        self._distance = _Integral(SPEED_VALID_NS)
        self._displacement = _Integral(LONGEST_GAP_NS)
        self._legs = 0
        self.gaps = 0
        """How often speeds came so late that the distance driven meanwhile is not known."""
        self._speed_mps = self._furthest_m = 0.0
        self._source = 0
        self._answered = (0, 0.0)

    def add_speed(self, stamp_ns: int, speed_mps: float, source: int) -> None:
        """A ground speed, negative backwards; `source` ranks its origin, 0 the best.

        A worse source counts only after a second without a better one. Ignored where it is not after the newest, or is
        no speed.
        """
        if not abs(speed_mps) <= MAX_SPEED_MPS:
            return
        last_ns = self._distance.last_ns
        if last_ns is not None:
            gap_ns = stamp_ns - last_ns
            if gap_ns <= 0 or (source > self._source and gap_ns < SPEED_VALID_NS):
                return
            self.gaps += gap_ns > LONGEST_GAP_NS
        forward_mps = speed_mps if abs(speed_mps) >= STANDING_MPS else 0.0
        ahead_m = self._distance.total[0] if self._distance.total else 0.0
        self._furthest_m = max(self._furthest_m, ahead_m)
        backed = forward_mps < 0 and self._furthest_m - ahead_m >= BACKED_M
        self._distance.add(stamp_ns, 0.0 if backed else forward_mps, abs(forward_mps))
        self._speed_mps, self._source = abs(speed_mps), source

    def add_velocity(self, stamp_ns: int, east_mps: float, north_mps: float) -> None:
        """A velocity over ground. Ignored where it is not after the newest, or is none."""
        if not math.hypot(east_mps, north_mps) <= MAX_SPEED_MPS:
            return
        last_ns = self._displacement.last_ns
        if last_ns is not None and stamp_ns <= last_ns:
            return
        if last_ns is None or stamp_ns - last_ns > LONGEST_GAP_NS:
            self.begin_leg()
        self._displacement.add(stamp_ns, east_mps, north_mps)

    def begin_leg(self) -> None:
        """The displacement before cannot be compared with what follows."""
        self._displacement.clear()
        self._legs += 1

    @property
    def total_m(self) -> float | None:
        """All meters driven, in either direction, up to the newest report; None before the first."""
        total = self._distance.total
        return None if total is None else total[1]

    def distance_m(self, stamp_ns: int) -> float | None:
        """Meters to sample places by at `stamp_ns`, see the module; None when no speed was known around then.

        Never less than it was before.
        """
        driven = self._distance.at(stamp_ns)
        return None if driven is None else self._not_less(stamp_ns, driven[0])

    def _not_less(self, stamp_ns: int, distance_m: float) -> float:
        """Hold a distance that was extrapolated while braking, until the vehicle has really driven it."""
        answered_ns, answered_m = self._answered
        if stamp_ns < answered_ns:
            return distance_m
        self._answered = (stamp_ns, max(distance_m, answered_m))
        return self._answered[1]

    def displacement(self, stamp_ns: int) -> Displacement | None:
        """Meters east and north at `stamp_ns`; None when that is outside the leg, or too long ago."""
        moved = self._displacement.at(stamp_ns)
        return None if moved is None else Displacement(self._legs, *moved)

    def speed_mps(self, now_ns: int) -> float | None:
        """The newest ground speed, None when it is older than a second."""
        last_ns = self._distance.last_ns
        return None if last_ns is None or now_ns - last_ns > SPEED_VALID_NS else self._speed_mps


class _Row(NamedTuple):
    """A frame of a line: where the vehicle headed (2,), and the error that was assumed of its velocity in that way."""

    stamp_ns: int
    odometer_m: float
    ahead: NDArray[np.float64]
    assumed_mps: float


def _means(rows: Iterable[_Row]) -> tuple[NDArray[np.float64], float]:
    """Of what rows have besides stamp and odometer."""
    kept = list(rows)
    return np.mean([row.ahead for row in kept], axis=0), sum(row.assumed_mps for row in kept) / len(kept)


class VelocityError:
    """What an autopilot's velocity is wrong by where nothing measures it, found from places: a Kalman filter.

    state (5,): meters by which the odometer is ahead of the drive of the map that is matched; error in m/s east and
    north; its growth in m/s^2 ahead and to the left.

    Such a velocity is integrated from accelerometers: its changes are right, and its error grows steadily. Where the
    middles of the matched lines are is measured, as is the velocity to the left, since a vehicle moves the way it
    heads, and all of the velocity while the picture stays the same, since the vehicle stands.
    """

    def __init__(self, length: int) -> None:
        """length: frames in a sequence."""
        self._length = length
        self.begin()

    def begin(self) -> None:
        """The velocity is measured: what it is wrong by, once it is not, begins now."""
        self._mean = np.zeros(5)
        self._covariance = np.diag([ANYWHERE_M, BEGINS_MPS, BEGINS_MPS, GROWS_MPS2, GROWS_MPS2]) ** 2
        self._last_ns: int | None = None
        self._ahead = np.array([0.0, 1.0])
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
    def _ahead_mps(self) -> float:
        return float(self._ahead @ self._mean[1:3])

    @property
    def sigma_mps(self) -> float:
        """One standard deviation of the error ahead."""
        return math.sqrt(self._ahead @ self._covariance[1:3, 1:3] @ self._ahead)

    def predict(self, stamp_ns: int, heading_rad: float, velocity_mps: tuple[float, float]) -> None:
        """Go on to a frame, at which the vehicle heads there and its velocity is reported as that, east and north."""
        elapsed_s = 0.0 if self._last_ns is None else max(0.0, (stamp_ns - self._last_ns) / 1e9)
        self._last_ns = stamp_ns
        ahead = self._ahead = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        left = np.array([-ahead[1], ahead[0]])
        assumed_mps = self._ahead_mps
        moves = np.eye(5)
        moves[0, 1:3] = elapsed_s * ahead
        moves[1:3, 3:] = elapsed_s * np.column_stack([ahead, left])
        noise = elapsed_s * np.array([WANDERS_M, WANDERS_MPS, WANDERS_MPS, WANDERS_MPS2, WANDERS_MPS2]) ** 2
        self._mean = moves @ self._mean
        self._mean[0] -= elapsed_s * assumed_mps
        self._covariance = moves @ self._covariance @ moves.T + np.diag(noise)
        self._measure(np.array([0.0, *left, 0.0, 0.0]), float(left @ np.array(velocity_mps)), LEFT_MPS)

    def add_frame(self, stamp_ns: int, odometer_m: float) -> None:
        """A frame at which the vehicle moved; odometer_m: by the velocity less its error."""
        self._stands_ns = None
        self._rows.append(_Row(stamp_ns, odometer_m, self._ahead, self._ahead_mps))

    def use_line(self, drive: object, middle_m: float, length_m: float) -> None:
        """The believed match of the frame that was added last, by its line along that drive, in the way of travel."""
        if len(self._rows) < self._length:
            return
        newest, middle = self._rows[-1], self._rows[self._length // 2]
        since_s = (newest.stamp_ns - middle.stamp_ns) / 1e9
        ahead, assumed_mps = _means(islice(self._rows, self._length // 2, None))
        row = np.array([1.0, *(-since_s * ahead), since_s**2 / 2, 0.0])
        off_m = middle.odometer_m - middle_m - since_s * assumed_mps
        if drive != self._drive or abs(off_m - row @ self._mean) > JUMPED_M:
            self._drive = drive
            took_s = (newest.stamp_ns - self._rows[0].stamp_ns) / 1e9
            too_far_mps = (newest.odometer_m - self._rows[0].odometer_m - length_m) / took_s
            ahead, assumed_mps = _means(self._rows)
            slope = np.array([0.0, *ahead, -took_s / 2, 0.0])
            # Of the mean over the line, from which the newest error has wandered away.
            self._measure(slope, too_far_mps + assumed_mps, math.hypot(SLOPE_MPS, WANDERS_MPS * math.sqrt(took_s / 3)))
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
            for axis in (1, 2):
                self._measure(np.eye(5)[axis], velocity_mps[axis - 1], HALT_MPS)

    def _measure(self, row: NDArray[np.float64], measured: float, sigma: float) -> None:
        gain = self._covariance @ row / (row @ self._covariance @ row + sigma**2)
        self._mean = self._mean + gain * (measured - row @ self._mean)
        self._covariance = (np.eye(5) - np.outer(gain, row)) @ self._covariance


class TurnAround:
    """Whether the vehicle has turned around and now drives back, by its displacement at each used frame."""

    def __init__(self) -> None:
        self._recent: deque[Displacement] = deque(maxlen=TURN_FRAMES)

    def add(self, displacement: Displacement | None) -> bool:
        """True at the frame at which it drives the other way; then not again before it has turned once more."""
        if displacement is None or (self._recent and displacement.leg != self._recent[-1].leg):
            self._recent.clear()
        if displacement is None:
            return False
        self._recent.append(displacement)
        third = TURN_FRAMES // 3
        if len(self._recent) < TURN_FRAMES:
            return False
        before, after = (_course(self._recent[at], self._recent[at + third - 1]) for at in (0, TURN_FRAMES - third))
        turned = before is not None and after is not None and abs(math.remainder(after - before, math.tau)) > AROUND_RAD
        if turned:
            self._recent.clear()
        return turned


def _course(first: Displacement, last: Displacement) -> float | None:
    """The direction of travel in radians, None where the vehicle hardly moved."""
    east_m, north_m = last.east_m - first.east_m, last.north_m - first.north_m
    return math.atan2(east_m, north_m) if math.hypot(east_m, north_m) > COURSE_M else None
