"""The vehicle's own motion by what no filter has touched: the gyros' rates and a speed in which GPS has no part. Pure.

An autopilot's heading is no witness of its GPS: EKF3 turned it by 7 to 8.5 degrees within 10 s to follow a GPS that was
dragged aside at 1 m/s, on three recorded drives, so that wheels times heading agreed with GPS. Here the heading is the
integral of rates alone. How it lies to the north, the bias of the gyros and the scale of the speed come from how places
moved while they agreed with GPS (`predicted`), from the autopilot's heading of then, and from nothing later.
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
from edge.localization.odometer import CHANGES

RATES_APART_NS = 1_500_000_000
"""The longest silence between two rates. Of six that are requested a second, one has come by then; at one a second, as
eleven recorded drives have them, the heading is uncertain by 2 to 4 degrees after 40 s, which `Gyros` accounts for."""
BIAS_RADPS = math.radians(0.1)
"""One standard deviation of the gyros' bias. On 14 recorded drives it was 0.095 deg/s on average."""
COMPASS_RAD = math.radians(4.0)
"""The same of an autopilot's heading while GPS is right: recorded headings are off by 2 to 4 degrees."""
WITHIN_S = 100.0
"""Time before a moment whose places calibrate: over a longer one, even a small bias turns by no small angle."""
FIXES_M, KEPT_FIXES, ALIKE_FIXES = 20.0, 64, 3
"""Meters between two fixes of GPS that are kept, and how many in a row are wrong alike, as in bursts of multipath."""
SINCE_M = 60.0, 120.0, 180.0
"""Meters driven within which GPS is held against own motion: beyond, the heading by gyros is as uncertain as a drag of
1 m/s turns the way by."""
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


def predicted(
    before: Sequence[Displacement], at_m: Vector, sigma_m: Vector, now: Displacement, drift: float
) -> tuple[Vector, Vector] | None:
    """Where own motion since the newest of some moments leads, and its covariance (2, 2); None where not known.

    at_m: meters east and north at each of them, the oldest first, by witnesses that agreed but for an offset that stays
    (n, 2, witnesses), each to sigma_m (n,) in each direction. drift: one standard deviation of the speed's scale, as a
    share. The result is (2, witnesses). Least squares of where the vehicle was at the newest, of the errors of heading
    and scale, and of the bias of the gyros, the last three with what is known of them anyway.
    """
    newest, count = before[-1], at_m.shape[2]
    then, since = newest.gyros, _moved(newest, now)
    if then is None or since is None or now.gyros is None:
        return None
    information, seen = np.diag([0.0, 0.0, COMPASS_RAD**-2, drift**-2, BIAS_RADPS**-2]), np.zeros(5)
    apart, weights = np.zeros((2, count)), 0.0
    for motion, there_m, sigma in zip(before, at_m, sigma_m, strict=True):
        moved = _moved(newest, motion)
        if moved is None or then.time_s - (motion.gyros or then).time_s > WITHIN_S:
            continue
        mean_m, weight = there_m.mean(axis=1), 1 / (sigma**2 / count + newest.unknown_sigma_since(motion) ** 2)
        information += weight * moved.design.T @ moved.design
        seen += weight * moved.design.T @ (mean_m - moved.by_m)
        apart, weights = apart + weight * (there_m - mean_m[:, None]), weights + weight
    covariance = np.linalg.inv(information)
    turned = (now.gyros.turned_rad2 - then.turned_rad2) / 3  # as a random walk of the heading does
    spread = (CHANGES**2 + turned) * float(since.by_m @ since.by_m) + now.unknown_sigma_since(newest) ** 2
    spread += (count - 1) / weights
    where: Vector = (since.by_m + since.design @ covariance @ seen)[:, None] + apart / weights
    return where, since.design @ covariance @ since.design.T + spread * np.eye(2)


@dataclass(frozen=True)
class _Moved:
    """Meters between two moments (2,), and what the five unknowns of `predicted` change of the second place (2, 5)."""

    by_m: Vector
    design: Vector


def _moved(then: Displacement, now: Displacement) -> _Moved | None:
    """By the autopilot's heading of then; None where the one is of another leg, or not by gyros."""
    before, after = then.gyros, now.gyros
    if before is None or after is None or then.leg != now.leg:
        return None
    sin, cos = math.sin(before.compass_rad), math.cos(before.compass_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    by_m = turn @ now.since(then)
    aside_m = np.array([by_m[1], -by_m[0]])
    by_bias = turn @ (after.bias_east_m - before.bias_east_m, after.bias_north_m - before.bias_north_m)
    return _Moved(by_m, np.column_stack([np.eye(2), aside_m, by_m, by_bias - before.time_s * aside_m]))


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
        """By how much GPS has departed within any of SINCE_M, the most evident; none where not known."""
        found = Departure()
        if self._newest is None:
            return found
        at_m, gps, motion = self._newest
        for since_m in SINCE_M:
            before = [one for one in self._fixes if at_m - one[0] >= since_m]
            if len(before) < 2:  # one has no direction
                continue
            here = gps.lat_deg, gps.lon_deg
            fixes_m = np.array([east_north_of(one.lat_deg, one.lon_deg, here) for _, one, _ in before])
            sigmas_m = math.sqrt(ALIKE_FIXES) * np.array([one.sigma_m for _, one, _ in before])
            where = predicted([one for *_, one in before], fixes_m[:, :, None], sigmas_m, motion, self._drift)
            length_m = math.hypot(*fixes_m[-1])
            if where is None or length_m < since_m / 2:  # it has turned around
                continue
            across = np.array([-fixes_m[-1][1], fixes_m[-1][0]]) / length_m
            off_m, variance = -where[0][:, 0], float(across @ where[1] @ across) + gps.sigma_m**2
            evidence = float(off_m @ across) ** 2 / (2 * variance)
            found = max(found, Departure(evidence, float(off_m[0]), float(off_m[1])))
        return found
