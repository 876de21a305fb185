"""Whether GPS is dragged off, by how it has moved against looks within the last half minute. Pure.

A look is right to decimeters. What GPS and the map are off by is meters, but changes over a minute. So the course of
their difference says more than its size. Over the looks of MEMORY_S it is likely (Gaussian, each of east and north)

    honest   if it wanders, and one burst of multipath begins or ends at any look, at once or within STEPS_S
    dragged  if it wanders, and grows steadily since any look that is at least LEAST_S ago

Both are means over all looks. A drag explains what it must: where the best one leaves MISFIT standard deviations more
than chance does, as among several bursts, it is no evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north_of
from edge.localization.events import GpsFix
from edge.localization.gps_comparison import BURST_M, BURST_SHARE, Comparison, meters_from, offset_m

MEMORY_S, LEAST_S = 30.0, 8.0
"""Of a drag: 15 m at 0.5 m/s, 8 m at 1 m/s. From 5 s on, pairs of bursts were a drag eight times as often."""
WANDER_S = 60.0
"""In which the errors of an honest GPS and of the map change."""
STEPS_S, MISFIT = (0.0, 4.0), 4.0
"""Without both, bursts of 10 m that come every 45 s were a drag twice in 100 km, and 37 times where a receiver smooths
them over 2 s; with them never, and 5 times."""
RATE_MPS = 2.0  # one standard deviation of a drag, east and north
APART_S = 1.0  # looks that are nearer in time than that are alike
CONFIRMED_CHI2 = 11.83
"""Squared distance of a look from where own motion led, in standard deviations, that 1 of 370 honest ones exceeds."""
Array = NDArray[np.float64]


class Drag:
    """The newest looks, and own motion between them where the next look confirms it."""

    def __init__(self) -> None:
        self._looks: list[Comparison] = []
        self._since: list[Comparison] = []
        self.evidence = -math.inf
        """By the looks so far, see `drag_evidence`."""

    def clear(self) -> None:
        """Nothing is known of GPS."""
        self._looks, self._since, self.evidence = [], [], -math.inf

    @property
    def looks(self) -> list[Comparison]:
        """Without what lay between them."""
        return [one for one in self._looks if one.motion is not None]

    def is_due(self, stamp_s: float) -> bool:
        """Whether the last look, or what was added since, is some time ago."""
        return bool(self._looks) and stamp_s - (self._since or self._looks)[-1].stamp_s >= APART_S

    def at(self, stamp_s: float) -> float:
        """The evidence, until the last look is forgotten."""
        return self.evidence if self._looks and stamp_s - self._looks[-1].stamp_s <= MEMORY_S else -math.inf

    def add(self, look: Comparison, led: tuple[Array, Array] | None) -> None:
        """One more look. led: meters (2,) that own motion leads there from the last one, and the covariance."""
        if self._since and led is not None:
            off_m = meters_from(self._looks[-1], look) - led[0]
            spread = led[1] + look.place_sigma_m**2 * np.eye(2)
            if float(off_m @ np.linalg.solve(spread, off_m)) <= CONFIRMED_CHI2:
                self._looks += self._since
        recent = [one for one in self._looks if look.stamp_s - one.stamp_s <= MEMORY_S]
        self._looks, self._since = [*recent, look], []
        self.evidence = drag_evidence(self._looks)

    def go_on(self, gps: GpsFix, led: tuple[Array, Array], stamp_s: float) -> tuple[float, Array]:
        """The evidence without a look, and how far GPS is from where own motion leads: (2,) meters.

        Only across the way, since along it wheels may slip.
        """
        last = self.looks[-1]
        off_m = np.array(east_north_of(gps.lat_deg, gps.lon_deg, (last.lat_deg, last.lon_deg))) - led[0]
        left = last.axes[1]
        here = replace(last, off_left_m=float(left @ off_m), look_sigma_m=math.sqrt(float(left @ led[1] @ left)))
        self._since.append(replace(here, motion=None, stamp_s=stamp_s))
        return drag_evidence([*self._looks, *self._since]), off_m


def drag_evidence(looks: Sequence[Comparison]) -> float:
    """Logarithm of how much more likely the newest comparisons with looks are if GPS is dragged than if it is honest.

    Minus infinity where they are too few.
    """
    newest_s = looks[-1].stamp_s
    recent = [one for one in looks if newest_s - one.stamp_s <= MEMORY_S]
    at_s, off_m = np.array([one.stamp_s for one in recent]), np.array([offset_m(one) for one in recent])
    since_s = at_s[:, None] - at_s
    ramps = RATE_MPS * np.maximum(0.0, since_s[:, newest_s - at_s >= LEAST_S])
    if not ramps.shape[1]:
        return -math.inf
    steps = np.hstack([np.clip((since_s[:, 1:] + 1e-9) / max(step_s, 1e-9), 0.0, 1.0) for step_s in STEPS_S])
    heads_rad = np.array([one.heading_rad for one in recent])
    covariance = looks[-1].slow_sigma_m ** 2 * np.exp(-np.abs(since_s) / WANDER_S)
    # What is constant along the way turns with it; half is the share of each of east and north.
    covariance += looks[-1].whole_sigma_m ** 2 / 2 * np.cos(heads_rad[:, None] - heads_rad)
    covariance += np.diag([(one.look_sigma_m or 0.0) ** 2 for one in recent])
    precision = np.linalg.inv(covariance)
    dragged, stepped = (_gains(ways, off_m, precision) for ways in (ramps, BURST_M * steps))
    # Half of chi-square with two degrees of freedom for each look.
    left = float((off_m * (precision @ off_m)).sum()) / 2 - float(dragged.max())
    if left > len(recent) + MISFIT * math.sqrt(len(recent)):
        return -math.inf
    honest = np.logaddexp(math.log(1 - BURST_SHARE), math.log(BURST_SHARE) + _mean(stepped))
    return float(_mean(dragged) - honest)


def _gains(ways: Array, off_m: Array, precision: Array) -> Array:
    """Logarithm (k,) of how much likelier offsets (n, 2) become by each way (n, k) to go east and north, by normals."""
    spread = 1 + (ways * (precision @ ways)).sum(axis=0)
    gains: Array = ((ways.T @ precision @ off_m) ** 2).sum(axis=1) / spread / 2 - np.log(spread)
    return gains


def _mean(logarithms: Array) -> float:
    return float(np.logaddexp.reduce(logarithms)) - math.log(len(logarithms))
