"""Whether positions move as the odometer and the heading say: those of a spoofed GPS move otherwise.

A position is compared with earlier ones, each with the motion since: steps as long as the odometer says, in the
direction of the heading. Both may differ by one scale and rotation, the median of the drive so far: wheels and a
compass are wrong alike for long. What disagrees is never compared with, so that a spoofed GPS stays wrong.

A burst of multipath agrees once the way is long enough, since either may be wrong by then. So what a position differs
from the best known one before is in its standard deviation, and scale and rotation are learned between positions that
are as doubtful.
"""

from __future__ import annotations

import cmath
import math
from array import array
from bisect import bisect_right, insort
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import Origin, east_north, east_north_of
from edge.reference_map.place_records import sigmas_m

WINDOWS_M = (0.0, 20.0, 50.0, 100.0, 200.0)
"""How far back the compared position is by the odometer; the first is the last position, from which GPS may jump."""
OFF_M, OFF_SIGMAS, OFF_SHARE = 5.0, 4.3, 0.05
"""By how much both may differ: the greater of the first and so many standard deviations of a position (3 of a
difference), and that share of the way. On recorded drives of rovers with GPS they differed by at most 1.4 m over 20 m,
2.9 m over 50, 5.5 m over 100 and 7.3 m over 200; with a spoofing drift of 1 m/s at 4 m/s by 16 to 43 m."""
DRIFT = 0.02
"""One standard deviation of the way by odometer and heading: a third of what both differed by at most, see above."""
LEARNED_M, LEARNED_FROM_M, LEARNED_LEAST = 100.0, 20.0, 5
"""Scale and rotation are learned over windows of this length, at first shorter ones, and used from so many on."""
STRAIGHT_M, GENTLE_M, GENTLE_DEG = 20.0, 40.0, 30.0
"""A longer step may have a corner in it, so its direction is not known: only lengths are compared over it. But for one
that turned by less than that: over 40 m of 40 simulated roads, its direction misplaced it by 2.9 m (95 %)."""
KEPT_AGREED = 256
"""Positions before the longest window that are kept at most: a drive of ten hours costs 16 bytes a place."""
CREPT_M, CREPT_SHARE, CREPT_TIMES = (50.0, 100.0, 200.0, 400.0), 0.003, 2.7
"""Windows in which positions may creep by less than counts as wrong; the share of the way by which odometer and heading
are off in one; and how many variances of both the square of a difference must be. Of five recorded drives of ArduPilot,
whose GPS was right, none crept by anything; of four of PX4, without wheels, by 4 to 10 m over 430 m (3 to 8 m when only
the median of a drive counted as right). A map that crept by 24 m over 900 of 1,200 m had positions 18 sigma off."""
CREPT_NEAR_M, CREPT_BIASES, CREPT_EITHER = 50.0, 32, 3.0
"""Positions are means of those so near, since they wander over some 60 m. Scale and rotation of so many windows of each
of the two greatest lengths may be the right ones. What is off by these counts by this part of its square."""
LEAST_SIGMA_M = 1.4
"""Of an honest GPS, whatever an autopilot states: what its error changes by within a window."""
MOST_BIAS = 0.2
"""Scale and rotation are at most this far from none: a fifth, or 11 degrees."""


@dataclass(frozen=True)
class PositionOutlier:
    """A position that is off by so many meters from where the vehicle drove. since: how many positions before."""

    since: int
    off_m: float
    moved_m: float
    driven_m: float

    def __str__(self) -> str:
        words = f"the GPS position moved {self.moved_m:.0f} m where the vehicle drove {self.driven_m:.0f} m"
        return words if self.moved_m > self.driven_m + self.off_m / 2 else f"{words}, {self.off_m:.0f} m beside it"


class PlanarOdometry(NamedTuple):
    """How a vehicle has moved by odometer and heading: meters, east + north i, and those of the way.

    unknown: steps of unknown length, and of unknown direction, up to here.
    """

    meters: complex
    way_m: float
    unknown: tuple[int, int]


@dataclass(frozen=True)
class _ConsistentPosition:
    """A position that agreed: meters, east + north i. doubt_m: the part of sigma_m that it does not state itself."""

    number: int
    point: complex
    sigma_m: float
    at: PlanarOdometry
    doubt_m: float = 0.0


def steps_of(driven_m: NDArray[np.float64], heading_deg: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Meters (N - 1,), east + north i, between positions of a drive, by odometer and heading (N,); NaN: not known."""
    step_m, turned_deg = np.diff(driven_m), (np.diff(heading_deg) + 180.0) % 360.0 - 180.0
    straight_m = np.where(np.abs(turned_deg) <= GENTLE_DEG, GENTLE_M, STRAIGHT_M)
    steps = step_m * np.exp(1j * np.radians(90.0 - heading_deg[:-1] - turned_deg / 2))
    return np.where(np.abs(step_m) <= straight_m, steps, np.nan)


class GpsMotion:
    """The positions of one drive, one after another."""

    def __init__(self) -> None:
        self._agreed: list[_ConsistentPosition] = []  # of the longest window, and up to KEPT_AGREED more
        self._ways_m: list[float] = []  # of those that agreed, by the odometer
        self._ratios = array("d"), array("d")  # real and imaginary parts, sorted
        self._way_m, self._moved, self._number = 0.0, 0j, 0
        self._unknown = 0, 0
        self._last = math.nan, math.nan
        self._origin: Origin | None = None

    def move(self, driven_m: float, heading_deg: float) -> None:
        """The vehicle has driven on, by its odometer, and has a heading now; NaN where not known."""
        before, self._last = self._last, (driven_m, heading_deg)
        lengths, directions = self._unknown
        if math.isnan(driven_m - before[0]):
            self._unknown = lengths + (not math.isnan(before[0]) or bool(self._agreed)), directions
            return
        self._way_m += abs(driven_m - before[0])
        step = steps_of(*np.array([before, self._last]).T)[0]
        self._unknown = lengths, directions + cmath.isnan(step)
        self._moved += 0j if cmath.isnan(step) else complex(step)

    @property
    def doubt_m(self) -> float:
        """One standard deviation of the last position that agreed, besides what it states."""
        return self._agreed[-1].doubt_m if self._agreed else 0.0

    @property
    def moved(self) -> PlanarOdometry:
        """How the vehicle has moved up to now."""
        return PlanarOdometry(self._moved, self._way_m, self._unknown)

    def truly(self, then: PlanarOdometry, now: PlanarOdometry) -> complex:
        """Meters moved meanwhile, less what odometer and heading were wrong by so far."""
        return self._bias() * (now.meters - then.meters)

    def disagreement_at(self, lat_deg: float, lon_deg: float, sigma_m: float) -> PositionOutlier | None:
        """The same as `disagreement`, of a position in degrees."""
        self._origin = self._origin or (lat_deg, lon_deg)
        return self.disagreement(east_north_of(lat_deg, lon_deg, self._origin), sigma_m)

    def disagreement(self, point_m: tuple[float, float], sigma_m: float) -> PositionOutlier | None:
        """Compare a position, east and north, with those before; None where it agrees, and is compared with later."""
        self._number += 1
        now = _ConsistentPosition(self._number, complex(*point_m), sigma_m, self.moved)
        bias = self._bias()
        rows = [row for row in map(self._row_before, WINDOWS_M) if row >= 0]
        if (found := next(filter(None, (self._compared(row, now, bias) for row in rows)), None)) is not None:
            return found
        doubt_m = self._doubt_m(rows, now, bias)
        now = replace(now, sigma_m=math.hypot(sigma_m, doubt_m), doubt_m=doubt_m)
        self._learn(now)
        self._agreed.append(now)
        self._ways_m.append(self._way_m)
        first = self._row_before(WINDOWS_M[-1])
        if first > KEPT_AGREED:
            del self._agreed[:first], self._ways_m[:first]
        return None

    def _row_before(self, window_m: float) -> int:
        """The last position that agreed and is at least so far back; -1 where there is none."""
        return bisect_right(self._ways_m, self._way_m - window_m) - 1

    def _compared(self, row: int, now: _ConsistentPosition, bias: complex) -> PositionOutlier | None:
        then, way_m, off_m = self._agreed[row], self._way_m - self._ways_m[row], self._off_m(row, now, bias)
        if off_m <= max(OFF_M, OFF_SIGMAS * max(then.sigma_m, now.sigma_m)) + OFF_SHARE * way_m:
            return None
        return PositionOutlier(now.number - then.number, off_m, abs(now.point - then.point), way_m)

    def _off_m(self, row: int, now: _ConsistentPosition, bias: complex) -> float:
        """By how much a position differs from where an earlier one and the motion since put it; 0 where not known."""
        then = self._agreed[row]
        (lengths, directions), unknown = then.at.unknown, now.at.unknown
        if lengths != unknown[0]:
            return 0.0
        moved = now.point - then.point
        if directions != unknown[1]:
            return max(0.0, abs(moved) - abs(bias) * (self._way_m - self._ways_m[row]))
        return abs(moved - bias * (now.at.meters - then.at.meters))

    def _doubt_m(self, rows: list[int], now: _ConsistentPosition, bias: complex) -> float:
        """One standard deviation by what a position differs from the best known one before: either may be right."""
        if not rows:
            return 0.0
        drift_m = {row: DRIFT * (self._way_m - self._ways_m[row]) for row in rows}
        sigma_m, row = min((math.hypot(self._agreed[row].sigma_m, off_m), row) for row, off_m in drift_m.items())
        return math.sqrt(max(0.0, self._off_m(row, now, bias) ** 2 - sigma_m**2) / 2)

    def _learn(self, now: _ConsistentPosition) -> None:
        """From a position that is as doubtful: if both are off, they are by as much."""
        near = self._row_before(LEARNED_FROM_M)
        rows = [row for row in (self._row_before(LEARNED_M), 0, near) if 0 <= row <= near]
        alike = (self._agreed[row] for row in rows if abs(self._agreed[row].doubt_m - now.doubt_m) <= now.doubt_m / 2)
        then = next(alike, now)
        if then.at.unknown != now.at.unknown or then.at.meters == now.at.meters:
            return
        ratio = (now.point - then.point) / (now.at.meters - then.at.meters)
        insort(self._ratios[0], ratio.real)
        insort(self._ratios[1], ratio.imag)

    def _bias(self) -> complex:
        """What the odometer and the heading have to be multiplied by."""
        real, imaginary = self._ratios
        if len(real) < LEARNED_LEAST:
            return 1.0
        off = complex(real[len(real) // 2] - 1.0, imaginary[len(imaginary) // 2])
        return 1.0 + off * min(1.0, MOST_BIAS / max(abs(off), 1e-9))


def disagreements(
    points_m: NDArray[np.float64],
    sigma_m: NDArray[np.float64],
    driven_m: NDArray[np.float64],
    heading_deg: NDArray[np.float64],
) -> Iterator[PositionOutlier | None]:
    """Of each position of a drive in turn: points_m (N, 2) east and north, all others (N,)."""
    motion = GpsMotion()
    for point_m, *values in zip(points_m, sigma_m, driven_m, heading_deg, strict=True):
        position_sigma_m, meters, degrees = map(float, values)
        motion.move(meters, degrees)
        yield motion.disagreement((float(point_m[0]), float(point_m[1])), position_sigma_m)


def crept_m2(
    points_m: NDArray[np.float64],
    sigma_m: NDArray[np.float64],
    driven_m: NDArray[np.float64],
    heading_deg: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Square meters (N,) by which the positions of a drive differ more and more from how it moved: their variance.

    Each position is the middle of windows of CREPT_M, over which both differ by a vector. What the standard deviations
    at its ends and CREPT_SHARE of the way do not explain is spread over the window, of that in which it is most. Both
    are compared by the scale and rotation of the drive, and by those of any other window: where most of a drive crept,
    its median is the creep. What crept evenly all along is like wheels and a compass that are wrong. Of two
    places, what lies between them is how far one may be off against the other. A jump that counts as wrong is not
    creeping: places behind it are as certain as before, and elsewhere, which a hypothesis finds. With it, on a map of
    which 400 m were 300 m off a position 303 m off was published. Arguments: see `disagreements`.
    """
    way_m, points = np.maximum.accumulate(driven_m), points_m @ np.array([1.0, 1j])
    if len(points) < 2:
        return np.zeros(len(points))
    steps = steps_of(driven_m, heading_deg)
    moved = np.concatenate([[0j], np.cumsum(np.where(np.isfinite(steps), steps, np.diff(points)))])
    share, known_m2 = np.zeros(len(points)), np.maximum(sigma_m, LEAST_SIGMA_M) ** 2
    unlike = np.diff(points) - np.diff(moved)
    unlike[np.abs(unlike) > np.maximum(OFF_M, OFF_SIGMAS * np.maximum(sigma_m[1:], sigma_m[:-1]))] = 0
    begin, end = np.searchsorted(way_m, way_m - CREPT_NEAR_M), np.searchsorted(way_m, way_m + CREPT_NEAR_M, "right")
    both = np.cumsum([np.append(0, moved), np.append([0, 0], np.cumsum(unlike))], axis=1)
    moved, apart = (both[:, end] - both[:, begin]) / (end - begin)
    windows = []
    for window_m in CREPT_M:  # first and last rows around each position; at the ends of the drive, of the nearest
        first_m = np.clip(way_m - window_m / 2, way_m[0], max(way_m[0], way_m[-1] - window_m))
        last = np.searchsorted(way_m, first_m + window_m).clip(1, len(way_m) - 1)
        first = np.searchsorted(way_m, first_m).clip(0, last - 1)
        length_m = np.maximum(way_m[last] - way_m[first], CREPT_M[0])
        usual_m2 = known_m2[first] + known_m2[last] + (CREPT_SHARE * length_m) ** 2
        windows.append((apart[last] - apart[first], moved[last] - moved[first] + 1e-9, usual_m2, length_m))
    each = max(1, len(points) // CREPT_BIASES)
    apart_m, moved_m, usual_m2, _ = np.hstack([np.array(window)[:, ::each] for window in windows[-2:]])
    biases, doubts = apart_m / moved_m, usual_m2.real / np.abs(moved_m) ** 2
    right = zip([np.median(biases.real) + 1j * np.median(biases.imag), *biases], [0.0, *doubts], strict=True)
    for (bias, doubt), (apart_m, moved_m, usual_m2, length_m) in product(right, windows):
        off_m2, most_m2 = np.abs(apart_m - bias * moved_m) ** 2, usual_m2 + doubt * np.abs(moved_m) ** 2
        share = np.maximum(share, np.where(off_m2 > CREPT_TIMES * most_m2, off_m2 - most_m2, 0.0) / length_m)
    return np.concatenate([[0.0], np.cumsum((share[1:] + share[:-1]) / 2 / CREPT_EITHER * np.diff(way_m))])


def moved_as_driven(places: NDArray[np.void]) -> bool:
    """Whether all positions of a drive's places, records of PLACE (N,), moved as its route_m and headings say."""
    known = ("lat_deg", "lon_deg", "heading_deg", "route_m")
    is_known = all(np.isfinite(places[name]).all() for name in known)
    if not is_known or np.abs(np.diff(places["route_m"])).max(initial=0.0) > STRAIGHT_M:
        return False
    points_m = east_north(places["lat_deg"], places["lon_deg"])
    found = disagreements(points_m, sigmas_m(places), places["route_m"], places["heading_deg"])
    return all(one is None for one in found)
