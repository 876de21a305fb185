"""The lines of the left and of the right region alone, on the ground: how likely each of them lies where. Pure.

A region that is far beside the map's drive resembles it little, and the best single place would often be a wrong one:
so what is answered is how likely each place is. Each row of a line is compared where its vehicle was by its own
reckoning, since a vehicle that leaves its lane within a line would else be where it resembled the map most. Where the
odometer's scale is not known well, that is done at every scale that it may have, and each counts as far as it is likely
and the rows then fit: at a wrong scale, a line fits its oldest rows rather than all, and lags behind. On five
roads in four lights, with what was known before as accurate as 1 to 3 m, positions across by these likelihoods were as
far off as they said, from 4 m on the map's side of the lane to 6 m on the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

FINE = 4
"""Steps for each place."""
REACH = 16
"""Places beyond the line of both regions, in each direction, where the line of one of them is looked for."""
EVIDENCE = 0.2
"""Mean cost over a number of rows by which a place is less likely by a factor of e, times that number: where the
likelihoods fitted views beside the lane best, 0.14 to 0.24."""
WRONG = 0.02
"""Probability that the costs of a region say nothing."""
LEAST_ROWS = 0.6
"""Share of the rows that must be on the map wherever a line is looked for."""

CERTAIN = np.ones(1)
"""Of a motion that is known."""

SIDES = -0.5, 0.5
"""Of the left and of the right region: the share of the parallax by which its line lies further along."""
BEYOND_PLACES = np.linspace(-REACH, REACH, 2 * REACH * FINE + 1)
"""Where the likelihood of a line is known, in places (n,) beyond the line of both regions."""


class RegionLine(NamedTuple):
    """The line of one region: where it may lie, and how clearly it stands out.

    likely: (n,) how likely it lies at each of BEYOND_PLACES, sum 1. contrast: share by which its lowest mean cost is
    below the median one, 0 to 1.
    """

    likely: Vector
    contrast: float


class Passed(NamedTuple):
    """A point of a drive of the map, or of a lane beside it, that a vehicle passed.

    place_m: meters (2,). along: unit vector (2,) of travel there. since_m: (4,) how the vehicle moved since, see
    `route_estimate`.
    """

    place_m: Vector
    along: Vector
    since_m: Vector


@dataclass(frozen=True)
class RegionLines:
    """The lines of the left and of the right region alone, on the ground.

    passed: what the line of both together passed at its mean row. seen: the same where the vehicle's place across the
    road counts, further on. parallax: meters by which the line of the right region lies further along than that of the
    left one for each meter to the left of the map's drive. beyond_m: (n,) BEYOND_PLACES in meters. faint: see
    `Sighting`.
    """

    passed: Passed
    seen: Passed
    parallax: float
    beyond_m: Vector
    left: RegionLine
    right: RegionLine
    faint: float = 1.0


def region_line(
    costs: NDArray[np.float64], moved_places: NDArray[np.float64], priors: NDArray[np.float64] = CERTAIN
) -> RegionLine | None:
    """The line of a region; None where too much is beyond the map.

    costs: (n, S) of each row, moved by a number of places around 0. moved_places: (k, n) by how many places each row
    lies beyond the line, more than the line as a whole does, for k motions that the vehicle may have made. priors: (k,)
    how likely each motion is.
    """
    fine = _between_places(costs)
    start = (fine.shape[1] - len(BEYOND_PLACES)) // 2
    steps = np.rint(moved_places * FINE).astype(np.intp).clip(-start, start)
    at = start + steps[..., np.newaxis] + np.arange(len(BEYOND_PLACES))
    rows = fine[np.arange(len(fine))[:, np.newaxis], at]
    is_known = ~np.isnan(rows).any(axis=-1)
    if is_known.mean() < LEAST_ROWS:
        return None
    sums = np.where(is_known[..., np.newaxis], rows, 0.0).sum(axis=1)
    counts = np.maximum(1, is_known.sum(axis=-1, keepdims=True))
    lines = sums / counts
    likely = priors @ np.exp((lines.min() - lines) * counts / EVIDENCE)
    best = lines[lines.min(axis=-1).argmin()]
    median = float(np.median(best))
    contrast = 1 - float(best.min()) / median if median > 0 else 0.0
    return RegionLine((1 - WRONG) * likely / likely.sum() + WRONG / len(likely), contrast)


def _between_places(costs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Costs (n, (S - 1) * FINE + 1), by the cubic curve through the four places around each (Catmull-Rom)."""
    padded = np.concatenate([costs[:, :1], costs, costs[:, -1:]], axis=1)
    last = padded.shape[1] - 3
    before, here, after, beyond = (padded[:, i : last + i, np.newaxis] for i in range(4))
    t = np.arange(FINE) / FINE
    cubic = 3 * (here - after) + beyond - before
    between = here + t / 2 * (after - before + t * (2 * before - 5 * here + 4 * after - beyond + t * cubic))
    return np.concatenate([between.reshape(len(costs), -1), costs[:, -1:]], axis=1)
