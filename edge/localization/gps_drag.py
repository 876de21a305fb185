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

import numpy as np
from numpy.typing import NDArray

from edge.localization.gps_comparison import BURST_M, BURST_SHARE, Comparison, offset_m

MEMORY_S, LEAST_S = 30.0, 8.0
"""Of a drag: 15 m at 0.5 m/s, 8 m at 1 m/s. From 5 s on, pairs of bursts were a drag eight times as often."""
WANDER_S = 60.0
"""In which the errors of an honest GPS and of the map change."""
STEPS_S, MISFIT = (0.0, 4.0), 4.0
"""Without both, bursts of 10 m that come every 45 s were a drag twice in 100 km, and 37 times where a receiver smooths
them over 2 s; with them never, and 5 times."""
RATE_MPS = 2.0  # one standard deviation of a drag, east and north
Array = NDArray[np.float64]


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
