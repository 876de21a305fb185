"""The vehicle's own motion by what no filter has touched: the gyros' rates and a speed in which GPS has no part. Pure.

An autopilot's heading is no witness of its GPS: EKF3 turned it by 7 to 8.5 degrees within 10 s to follow a GPS that was
dragged aside at 1 m/s, on three recorded drives, so that wheels times heading agreed with GPS. Here the heading is the
integral of rates alone. How it lies to the north, the bias of the gyros and the scale of the speed come from how places
moved while they agreed with GPS (`calibrated`), from the autopilot's heading of then, and from nothing later.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north_of
from edge.localization.dead_reckoning import DeadReckoning, Displacement, Gyros, Integral
from edge.localization.events import GpsFix

RATES_APART_NS = 1_500_000_000
"""The longest silence between two rates. Of six that are requested a second, one has come by then; at one a second, as
eleven recorded drives have them, the heading is uncertain by 2 to 4 degrees after 40 s, which `Gyros` accounts for."""
BIAS_RADPS = math.radians(0.1)
"""One standard deviation of the gyros' bias. On 14 recorded drives it was 0.095 deg/s on average."""
COMPASS_RAD = math.radians(4.0)
"""The same of an autopilot's heading while GPS is right: recorded headings are off by 2 to 4 degrees."""
WITHIN_S = 100.0
"""Time before a moment whose places calibrate: over a longer one, even a small bias turns by no small angle."""
CHANGES = 0.02  # what of own motion's error is not the same before and after, as a share
FIXES_M, KEPT_FIXES, ALIKE_FIXES = 20.0, 64, 3
"""Meters between two fixes of GPS that are kept, and how many in a row are wrong alike, as in bursts of multipath."""
SINCE_M = 120.0
"""Meters driven within which GPS is held against own motion: beyond, the heading by gyros is as uncertain as a drag of
1 m/s turns the way by. With 60 and 180 m besides, GPS with multipath was called wrong after 860 m of a rebuilt road;
of nine drags one was called 2 m sooner."""
Vector = NDArray[np.float64]


class OwnMotion:
    """Integrates rates and speeds: `DeadReckoning`, in the heading by gyros."""

    def __init__(self) -> None:
        self._moved = DeadReckoning()
        self._turned = Integral(RATES_APART_NS, RATES_APART_NS)
        self._began_ns = self._legs = 0
        self._compass_rad = 0.0  # the autopilot's heading less that by the gyros, at the newest rate

    def is_turned(self, now_ns: int) -> bool:
        """Whether rates come."""
        last_ns = self._turned.last_ns
        return last_ns is not None and now_ns - last_ns <= RATES_APART_NS

    def end_leg(self, *, is_same_vehicle: bool = True) -> None:
        """See `DeadReckoning`; the heading begins anew."""
        self._moved.end_leg(is_same_vehicle=is_same_vehicle)
        self._turned = Integral(RATES_APART_NS, RATES_APART_NS)

    def turn(
        self, stamp_ns: int, rate_radps: float, heading_rad: float | None, body_mps: tuple[float, float] | None
    ) -> None:
        """How fast the heading turns clockwise, and how the vehicle moves: ahead and to the left, None if unknown.

        heading_rad: as the autopilot has it, without which nothing begins. Ignored where not after the newest.
        """
        last_ns = self._turned.last_ns
        if last_ns is not None and stamp_ns <= last_ns:
            return
        if last_ns is None or stamp_ns - last_ns > RATES_APART_NS:
            self.end_leg()
            if heading_rad is None:
                return
            self._turned.begin(stamp_ns, (heading_rad, 0.0, 0.0, 0.0), rate_radps, 0.0, 0.0, 0.0)
            self._began_ns, self._legs = stamp_ns, self._legs + 1
            last_ns = stamp_ns
        step_s, elapsed_s = (stamp_ns - last_ns) / 1e9, (stamp_ns - self._began_ns) / 1e9
        before_rad, _, _, _ = self._turned.total or (0.0,) * 4
        by_rad = before_rad + (rate_radps + self._turned.rate[0]) / 2 * step_s
        east_mps, north_mps = 0.0, 0.0
        if body_mps is not None:
            sin, cos, (ahead_mps, left_mps) = math.sin(by_rad), math.cos(by_rad), body_mps
            east_mps, north_mps = ahead_mps * sin - left_mps * cos, ahead_mps * cos + left_mps * sin
            self._moved.add_velocity(stamp_ns, east_mps, north_mps, may_slip=False)
        if step_s:
            # Between two rates, any between them is as likely.
            variance = (rate_radps - self._turned.rate[0]) ** 2 * step_s / 12
            self._turned.add(stamp_ns, rate_radps, variance, north_mps * elapsed_s, -east_mps * elapsed_s)
        if heading_rad is not None:
            self._compass_rad = math.remainder(heading_rad - by_rad, math.tau)

    def displacement(self, stamp_ns: int) -> Displacement | None:
        """Meters at a moment, not turned to the north; None where no rate or no speed is known around then.

        A leg is one of the gyros: over a silence of the speed, the heading is still known.
        """
        moved, turned = self._moved.displacement(stamp_ns), self._turned.at(stamp_ns)
        if moved is None or turned is None:
            return None
        _, variance, *by_bias_m = turned
        elapsed_s = (stamp_ns - self._began_ns) / 1e9
        return replace(moved, leg=self._legs, gyros=Gyros(elapsed_s, self._compass_rad, variance, *by_bias_m))


@dataclass(frozen=True)
class Calibrated:
    """Where the vehicle was at a moment, and what own motion is wrong by, as witnesses have shown.

    found, covariance: (5,) and (5, 5), see `_moved`. apart_m: of each witness from the mean of all (2, witnesses).
    apart_var: the variance of that.
    """

    newest: Displacement
    found: Vector
    covariance: Vector
    apart_m: Vector
    apart_var: float

    def predicted(self, now: Displacement) -> tuple[Vector, Vector] | None:
        """Where own motion leads since, by each witness (2, witnesses), and the covariance (2, 2); None if unknown."""
        then, since = self.newest.gyros, _moved(self.newest, [now])
        if then is None or since is None or now.gyros is None:
            return None
        by_m, design = since.by_m[0], since.design[0]
        turned = (now.gyros.turned_rad2 - then.turned_rad2) / 3  # as a random walk of the heading does
        spread = (CHANGES**2 + turned) * float(by_m @ by_m) + now.unknown_sigma_since(self.newest) ** 2
        covariance: Vector = design @ self.covariance @ design.T + (spread + self.apart_var) * np.eye(2)
        return (by_m + design @ self.found)[:, None] + self.apart_m, covariance


def calibrated(before: Sequence[Displacement], at_m: Vector, sigma_m: Vector, drift: float) -> Calibrated | None:
    """By some moments, the oldest first; None where the newest is not by gyros.

    at_m: meters east and north at each of them, by witnesses that agreed but for an offset that stays: (n, 2,
    witnesses), each to sigma_m (n, witnesses) in each direction. drift: one standard deviation of the speed's scale, as
    a share.
    Least squares of where the vehicle was at the newest, of the errors of heading and scale, and of the bias of the
    gyros, the last three with what is known of them anyway.
    """
    newest, count = before[-1], at_m.shape[2]
    moved = _moved(newest, before)
    if newest.gyros is None or moved is None:
        return None
    known_m, precisions = at_m[moved.rows], sigma_m[moved.rows] ** -2.0
    apart_m = known_m.mean(axis=0) - known_m.mean(axis=(0, 2))[:, None]
    total = precisions.sum(axis=1)
    mean_m = ((known_m - apart_m) * precisions[:, None, :]).sum(axis=2) / total[:, None]
    unknown_m = np.array([newest.unknown_sigma_since(before[row]) for row in moved.rows])
    weights = 1 / (1 / total + unknown_m**2)
    weighted = moved.design * weights[:, None, None]
    information = np.diag([0.0, 0.0, COMPASS_RAD**-2, drift**-2, BIAS_RADPS**-2])
    information += np.tensordot(weighted, moved.design, ((0, 1), (0, 1)))
    covariance = np.linalg.inv(information)
    found = covariance @ np.tensordot(weighted, mean_m - moved.by_m, ((0, 1), (0, 1)))
    return Calibrated(newest, found, covariance, apart_m, (count - 1) / float(weights.sum()))


class _Moved(NamedTuple):
    """Meters between a moment and others (n, 2), and what the five unknowns change of them (n, 2, 5). rows: which."""

    rows: list[int]
    by_m: Vector
    design: Vector


def _moved(then: Displacement, others: Sequence[Displacement]) -> _Moved | None:
    """By the autopilot's heading of then: of that leg, by gyros, from WITHIN_S before on; None where none is."""
    before = then.gyros
    rows = [row for row, one in enumerate(others) if before is not None and _is_near(one, then.leg, before.time_s)]
    if before is None or not rows:
        return None
    known = [(others[row], others[row].gyros or before) for row in rows]
    sin, cos = math.sin(before.compass_rad), math.cos(before.compass_rad)
    turn = np.array([[cos, -sin], [sin, cos]])  # of rows
    by_m = np.array([one.since(then) for one, _ in known]) @ turn
    bias_m = [(one.bias_east_m - before.bias_east_m, one.bias_north_m - before.bias_north_m) for _, one in known]
    aside_m = np.stack([by_m[:, 1], -by_m[:, 0]], axis=1)
    design = np.zeros((len(rows), 2, 5))
    design[:, :, :2] = np.eye(2)
    design[:, :, 2], design[:, :, 3] = aside_m, by_m
    design[:, :, 4] = np.array(bias_m) @ turn - before.time_s * aside_m
    return _Moved(rows, by_m, design)


def _is_near(one: Displacement, leg: int, then_s: float) -> bool:
    return one.gyros is not None and one.leg == leg and then_s - one.gyros.time_s <= WITHIN_S


class Departure(NamedTuple):
    """GPS less own motion, meters east and north; evidence: half the square of it across the way, over its variance."""

    evidence: float = 0.0
    east_m: float = 0.0
    north_m: float = 0.0


class GpsTrack:
    """GPS against own motion alone: whether it goes on from its own earlier fixes as the vehicle moves.

    An autopilot that steers by a GPS that is dragged aside leaves the road, and GPS stays on it: no place contradicts
    that. Only across the way, since along it wheels may slip, and a vehicle that stays on its road sees its places.
    """

    def __init__(self, drift: float) -> None:
        """drift: one standard deviation of the speed's scale, as a share."""
        self._drift = drift
        self.clear()

    def clear(self) -> None:
        """Nothing is known of what was before."""
        self._fixes: deque[tuple[float, GpsFix, Displacement]] = deque(maxlen=KEPT_FIXES)  # with the meters by then
        self._newest: tuple[float, GpsFix, Displacement] | None = None

    def add(self, gps: GpsFix | None, motion: Displacement | None) -> None:
        """GPS and own motion at an exposure, None where not known."""
        self._newest = None
        if gps is None or motion is None or motion.gyros is None:
            return
        if not self._fixes or motion.leg != self._fixes[-1][2].leg:
            self._fixes.clear()
            self._fixes.append((0.0, gps, motion))
        before_m, _, before = self._fixes[-1]
        self._newest = before_m + math.hypot(*motion.since(before)), gps, motion
        if self._newest[0] - before_m >= FIXES_M:
            self._fixes.append(self._newest)

    def departure(self) -> Departure:
        """By how much GPS has departed within SINCE_M; none where not known."""
        at_m, gps, motion = self._newest or (0.0, None, None)
        before = [one for one in self._fixes if at_m - one[0] >= SINCE_M]
        if gps is None or motion is None or len(before) < 2:  # one has no direction
            return Departure()
        here = gps.lat_deg, gps.lon_deg
        fixes_m = np.array([east_north_of(one.lat_deg, one.lon_deg, here) for _, one, _ in before])
        sigmas_m = math.sqrt(ALIKE_FIXES) * np.array([[one.sigma_m] for _, one, _ in before])
        shown = calibrated([one for *_, one in before], fixes_m[:, :, None], sigmas_m, self._drift)
        where = None if shown is None else shown.predicted(motion)
        length_m = math.hypot(*fixes_m[-1])
        if where is None or length_m < SINCE_M / 2:  # it has turned around
            return Departure()
        across = np.array([-fixes_m[-1][1], fixes_m[-1][0]]) / length_m
        off_m, variance = -where[0][:, 0], float(across @ where[1] @ across) + gps.sigma_m**2
        return Departure(float(off_m @ across) ** 2 / (2 * variance), float(off_m[0]), float(off_m[1]))
