"""What GPS has shown of the odometer: which share it measures too little, and how certain that is. Pure.

The meters of the wheels are compared with the way of a receiver's own positions, since a filter that fuses the wheels
as well is no measure of them: in 22 m after setting off, ArduPilot's own position followed wheels that were 3 % wrong.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge.geodesy import Origin, east_north_of
from edge.localization.dead_reckoning import MAX_SPEED_MPS, REPORTS_APART_NS

AGREE_SIGMAS = 3.0
"""Standard deviations that two things may be apart and still agree: an honest difference is in 1 of 370 cases more."""
NEAR_SIGMAS = 2.0
"""Those within which nothing is unusual, where a gate need not be as wide: an honest difference is in 1 of 22 more."""
SPAN_M, WITHIN_M = 5.0, 500.0
"""Meters of a span that is compared, and of all spans that count."""
WALK_M, ROUGH_M, LATE_S, LAG_S = 0.2, 0.3, 0.2, 0.15
"""Of a receiver's positions: how much of their error changes within the root of a second, what else differs from one to
the next, how late they come, and how uncertain that is: 0.1 to 0.3 s on 14 recorded drives, by 15 to 25 m of which,
from setting off, an odometer was found to be wrong by 1.8 % too much or too little (rms)."""
CHANGES = 0.02
"""What of an odometer's error is not the same before and after, as a share: on 17 recorded drives 0.0015 (rms) from the
first 60 m to the rest. More than that allows for loads, tires and surfaces that those did not have."""
LEARNED_M, MOST_DRIVES = 100.0, 20
"""Meters that a drive must have compared before its scale counts for later ones, and drives that count, the newest."""
OTHER_M, OTHER = 20.0, 0.04
"""Meters without GPS in which the autopilot must move as the odometer says, but for this share: else it is moved by
something that GPS has not been compared with."""


class ScaleFactor(NamedTuple):
    """By which share a velocity is too low, one standard deviation of that, and by how much it differs later on."""

    mean: float
    sigma: float
    varies: float = 0.0

    def and_also(self, other: ScaleFactor) -> ScaleFactor:
        """Of two that were found independently, with what differs in either."""
        share = other.sigma**2 / (self.sigma**2 + other.sigma**2)
        mean = share * self.mean + (1 - share) * other.mean
        return ScaleFactor(mean, self.sigma * math.sqrt(share), math.hypot(self.varies, other.varies))

    @property
    def later(self) -> float:
        """One standard deviation later on."""
        return math.hypot(self.sigma, self.varies)


def learned(drives: Sequence[ScaleFactor]) -> ScaleFactor | None:
    """What earlier drives of a vehicle show of the next one, the newest last; None of fewer than two that agree.

    Only those since the newest one that disagrees with the last one count, by AGREE_SIGMAS and CHANGES: what was found
    before a tire was changed is void. By how much it varies from drive to drive is what they vary by beyond their
    standard deviations (a random-effects model), in which CHANGES counts as one more drive.
    """
    newest = np.array([one[:2] for one in drives[-MOST_DRIVES:]]).reshape(-1, 2)[::-1]
    off = np.abs(newest[:, 0] - newest[:1, 0])
    agrees = off <= AGREE_SIGMAS * np.hypot(np.hypot(newest[:, 1], newest[:1, 1]), CHANGES)
    count = int(np.argmin([*agrees, False]))
    if count < 2:
        return None
    means, sigmas = newest[:count].T
    excess = max(0.0, float(np.sum((means - np.mean(means)) ** 2 - (1 - 1 / count) * sigmas**2)))
    varies = math.sqrt((CHANGES**2 + excess) / count)
    weights = (sigmas**2 + varies**2) ** -1
    return ScaleFactor(float(np.average(means, weights=weights)), float(np.sum(weights)) ** -0.5, varies)


class _Reading(NamedTuple):
    """Of the odometer: when, meters, and m/s since the one before."""

    stamp_ns: int
    driven_m: float
    speed_mps: float


class _Span(NamedTuple):
    """Meters by the odometer and by the receiver, the variance of the latter but for LAG_S, m/s gained, and radians."""

    driven_m: float
    way_m: float
    variance: float
    gained_mps: float
    course_rad: float


class OdometerCalibration:
    """Compares an odometer with a receiver, as both come, and with what earlier drives of the vehicle found."""

    def __init__(self) -> None:
        self.learned: ScaleFactor | None = None
        """By earlier drives, see `learned`; counts while this drive's receiver does not contradict it."""
        self.found: ScaleFactor | None = None
        """By this drive alone, None before LEARNED_M are compared."""
        self.is_changed = False
        """Whether this drive contradicts what was learned, as after a change of tires."""
        self.scale: ScaleFactor | None = None
        """Of the odometer, None while nothing is shown, or where the autopilot does not move by it."""
        self._fix: tuple[int, Origin] | None = None  # the newest
        self._readings: deque[_Reading] = deque(maxlen=16)  # for which no fix has come yet
        self._newest: _Reading | None = None
        self._began: tuple[_Reading, Origin] | None = None  # where a span did
        self._spans: deque[_Span] = deque()
        self._without: tuple[float, float] | None = None  # meters by the odometer and by the autopilot, without GPS

    def learn(self, scale: ScaleFactor | None) -> None:
        """Begin with what earlier drives have found."""
        self.learned, self.scale = scale, self.scale or scale

    def add_fix(self, stamp_ns: int, at: Origin) -> None:
        """Where a healthy receiver was, by a report that came at a time."""
        stamp_ns -= round(LATE_S * 1e9)
        (before_ns, before), self._fix, self._without = self._fix or (stamp_ns, at), (stamp_ns, at), None
        if not 0 < stamp_ns - before_ns <= REPORTS_APART_NS:
            self._began = None
            return
        while self._readings and self._readings[0].stamp_ns <= stamp_ns:
            reading = self._readings.popleft()
            if reading.stamp_ns >= before_ns:
                share = (reading.stamp_ns - before_ns) / (stamp_ns - before_ns)
                here = before[0] + share * (at[0] - before[0]), before[1] + share * (at[1] - before[1])
                self._compare(reading, here)

    def add_meters(self, stamp_ns: int, driven_m: float, own_m: float | None) -> None:
        """What the odometer has counted by a time; own_m: what the autopilot has driven by its own velocity."""
        before = self._newest
        if not math.isfinite(driven_m) or (before is not None and stamp_ns <= before.stamp_ns):
            return
        speed_mps = 0.0 if before is None else (driven_m - before.driven_m) / (stamp_ns - before.stamp_ns) * 1e9
        self._newest = _Reading(stamp_ns, driven_m, speed_mps)
        if not abs(speed_mps) <= MAX_SPEED_MPS:  # another counter, or damage
            self._readings.clear()
            self._began, self._without = None, None
            return
        self._readings.append(self._newest)
        if self._fix is not None and stamp_ns - self._fix[0] > 2 * REPORTS_APART_NS and own_m is not None:
            self._check(driven_m, own_m)

    def _check(self, driven_m: float, own_m: float) -> None:
        """Without GPS, the autopilot has to move as the odometer says."""
        began_m, own_began_m = self._without or (driven_m, own_m)
        way_m = driven_m - began_m
        if way_m >= OTHER_M and abs(own_m - own_began_m - way_m) > OTHER * way_m:
            self.scale = None
        self._without = (driven_m, own_m) if way_m >= OTHER_M or way_m < 0 else (began_m, own_began_m)

    def _compare(self, reading: _Reading, here: Origin) -> None:
        began = self._began
        if began is None or reading.driven_m - began[0].driven_m < ROUGH_M:  # it stands, and the receiver wanders
            self._began = reading, here
            return
        before, there = began
        driven_m, seconds = reading.driven_m - before.driven_m, (reading.stamp_ns - before.stamp_ns) / 1e9
        if driven_m < SPAN_M:
            return
        east_m, north_m = east_north_of(*here, there)
        course_rad, chord_m = math.atan2(east_m, north_m), math.hypot(east_m, north_m)
        turned_rad = math.remainder(course_rad - self._spans[-1].course_rad, math.tau) if self._spans else 0.0
        way_m = chord_m * (1 + min(1.0, turned_rad**2) / 24)  # on an arc it is longer than the chord
        variance, gained_mps = WALK_M**2 * seconds + ROUGH_M**2, reading.speed_mps - before.speed_mps
        self._spans.append(_Span(driven_m, way_m, variance, gained_mps, course_rad))
        self._began = reading, here
        while sum(one.driven_m for one in self._spans) > WITHIN_M:
            self._spans.popleft()
        self.scale = self._found()

    def _found(self) -> ScaleFactor | None:
        if len(self._spans) < 2:  # one span shows neither how late the receiver is, nor what differs from span to span
            return self.learned
        # By least squares, with how late the receiver is beside LATE_S: from a standstill on, all are late by as much.
        spans = np.array(self._spans)
        design, ways_m, variances = spans[:, [0, 3]], spans[:, 1], spans[:, 2]
        information = (design.T / variances) @ design + np.diag([0.0, LAG_S**-2])
        covariance = np.linalg.inv(information)
        found = covariance @ (design.T @ (ways_m / variances))
        # What differs from span to span by more than a receiver does, differs later on as well: wheels that spin.
        off_m2 = float(np.sum((ways_m - design @ found) ** 2 - variances))
        varies = max(0.0, off_m2) / float(np.sum(spans[:, 0] ** 2))
        mean, sigma = float(found[0]) - 1, math.sqrt(covariance[0, 0] + varies / len(spans))
        if float(np.sum(spans[:, 0])) >= LEARNED_M:
            self.found = ScaleFactor(mean, sigma)
        old = self.learned
        self.is_changed = old is not None and abs(mean - old.mean) > AGREE_SIGMAS * math.hypot(sigma, old.later)
        if old is None or self.is_changed:
            return ScaleFactor(mean, sigma, math.sqrt(varies + CHANGES**2))
        found_now = ScaleFactor(mean, sigma, math.sqrt(varies + min(CHANGES, old.varies) ** 2))
        return ScaleFactor(old.mean, old.later).and_also(found_now)
