"""How far a position may be from the truth at a stated risk, along the road and across it. Pure.

A protection level is exceeded with at most the stated probability in an hour of driving. Three hypotheses share it:

    right   the place is right: the errors are those of the filter, one every CORRELATION_M of driving
    shifted its stretch of the map is shifted by no more than what passes for the vehicle's own motion: the errors are
            that, and those of the filter
    wrong   all stretches of the map that speak for the place are wrong. Then only what no place had a part in bounds
            the position: where GPS had it last, and how the vehicle has moved since by its own velocity. As in RAIM by
            solution separation, the level is the distance from there, and what that position may be wrong by.

Where neither bounds the position at that risk, it has no protection level (infinite). docs/integrity.md has the
argument, and what was counted.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from statistics import NormalDist

from edge.geodesy import along_and_across
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import SLOW_MPS
from edge.localization.events import UNBOUNDED, ProtectionLevel
from edge.localization.evidence import STRETCH_WRONG, alike_m
from edge.localization.filter import CORRELATION_M
from edge.localization.odometry_datum import DeadReckoningOffset

MODEL_ERROR = 1.2
"""Times by which errors may be larger than the filter states: counted on simulated drives."""
SHARE = 0.125
"""Of the risk: of a shifted map, and in each of the two directions of errors on a right stretch and on a shifted one.
Wrong places have three of them."""
UNNOTICED_M = alike_m(CORRELATION_M, 0.0)
"""Two observations in a row count as one claim if they differ by no more than that: 9 m. What the test allows for the
velocity's error besides, that error needs itself."""


@dataclass(frozen=True)
class FaultProbabilities:
    """Fault probabilities: that all places of a fix are other ones, that its map is shifted as a whole, and that what
    bounded the position last without places was wrong.
    """

    place: float
    map: float
    bound: float


def protection_level(
    fix: PlaceFix,
    wrong: FaultProbabilities,
    reckoned: DeadReckoningOffset | None,
    speed_mps: float,
    risk_per_hour: float,
    stretch_m: float,
) -> ProtectionLevel:
    """Of a fix.

    reckoned: None where nothing but places bounds the position. stretch_m: meters of driving within which places are
    wrong together; a map that is shifted is so for the whole drive.
    """
    driven_m = 3600 * max(speed_mps, SLOW_MPS)
    by_errors = MODEL_ERROR * _sigmas(SHARE * risk_per_hour * CORRELATION_M / driven_m)
    of_a_stretch = risk_per_hour * stretch_m / driven_m
    by_shift = MODEL_ERROR * _sigmas(SHARE * of_a_stretch / STRETCH_WRONG)
    along_m, across_m = (
        max(by_errors * sigma_m, UNNOTICED_M + by_shift * sigma_m)
        for sigma_m in (fix.sigma_along_m, fix.sigma_cross_track_m)
    )
    # Of the probability of being wrong, what may exceed the level: from 1 on, nothing else needs to bound the position.
    by_place = 3 * SHARE * of_a_stretch / max(wrong.place, sys.float_info.min)
    allowed = min(by_place, SHARE * risk_per_hour / max(wrong.map, sys.float_info.min))
    if allowed >= 1:
        return ProtectionLevel(along_m, across_m)
    if reckoned is None or allowed <= wrong.bound or fix.heading_deg is None:
        return UNBOUNDED
    by_reckoning_m = _sigmas((allowed - wrong.bound) / (1 - wrong.bound) / 2) * reckoned.sigma_m
    off_along_m, off_across_m = along_and_across((reckoned.east_m, reckoned.north_m), fix.heading_deg)
    further = abs(off_along_m) + by_reckoning_m, abs(off_across_m) + by_reckoning_m
    return ProtectionLevel(max(along_m, further[0]), max(across_m, further[1]))


def _sigmas(probability: float) -> float:
    """Standard deviations that a normal error exceeds in either direction with that probability."""
    return -NormalDist().inv_cdf(min(probability, 1.0) / 2)
