"""Where between two places the best line ends, and how sharply the costs say so.

A line's cost falls and rises again over several places around its best one. A parabola through them has its lowest
point between places; and how many places are nearly as good says how well the lowest one is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.sequence.search import NO_LINE

REACH = 5
"""Places to each side that the parabola goes through: over drives by night, 5 left 4.2 m of error where 1 left 4.8."""
NEARLY = 0.2
"""Share of the way from the lowest cost up to the lowest cost elsewhere, below which a place is nearly as good."""


def end_between_places(costs: NDArray[np.int32], place: int) -> float:
    """Places by which the line ends beyond `place` (negative: before it), within REACH; 0 where costs say nothing.

    costs: (n,) line costs of one segment, NO_LINE where no whole line ends; `place` is the index of the lowest.
    """
    first = max(0, place - REACH)
    around = costs[first : place + REACH + 1]
    known = np.flatnonzero(around != NO_LINE)
    if len(known) < 4:
        return 0.0
    steps = known + first - place
    curvature, slope = _parabola(steps.tolist(), around[known].tolist())
    if curvature <= 0:
        return 0.0
    # Beyond the places that were looked at there is nothing to be known.
    return min(max(-slope / (2 * curvature), float(steps[0])), float(steps[-1]))


def _parabola(steps: list[int], costs: list[int]) -> tuple[float, float]:
    """Coefficients of x**2 and x of the parabola with the least squares, over a positive common factor.

    The normal equations by Cramer's rule, in Python's integers: for so few points a library's solver is all overhead.
    """
    s0, s1, s2, s3, s4 = (sum(step**power for step in steps) for power in range(5))
    t0, t1, t2 = (sum(cost * step**power for step, cost in zip(steps, costs, strict=True)) for power in range(3))
    curvature = t2 * (s2 * s0 - s1**2) - t1 * (s3 * s0 - s1 * s2) + t0 * (s3 * s1 - s2**2)
    slope = s4 * (t1 * s0 - t0 * s1) - s3 * (t2 * s0 - t0 * s2) + s2 * (t2 * s1 - t1 * s2)
    return float(curvature), float(slope)


def places_nearly_as_good(costs: NDArray[np.int32], place: int, elsewhere: int) -> float:
    """Half the number of neighbours in a row, `place` among them, whose cost is near the lowest.

    elsewhere: the lowest cost outside the window of uniqueness, against which "near" is measured.
    """
    limit = costs[place] + NEARLY * (elsewhere - int(costs[place]))
    worse = np.flatnonzero(costs >= limit)
    after = worse[worse > place].min(initial=len(costs))
    before = worse[worse < place].max(initial=-1)
    return float(after - before - 1) / 2
