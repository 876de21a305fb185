"""How far a position may be from the truth at a stated risk, along-track and cross-track. Pure.

A protection level is exceeded with at most the stated probability in an hour of driving. Three hypotheses share it:

    right   the place is right: the errors are those of the filter, one every CORRELATION_M of driving
    shifted its segment of the map is shifted by no more than what passes for the vehicle's own motion: the errors are
            that, and those of the filter
    wrong   all independent segments that speak for the place are wrong. Then only dead reckoning without places bounds
            the position: from where GPS had it last, by the vehicle's own velocity. As in RAIM by solution separation,
            the level is the distance from there, plus the error bound of that position.

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
"""Of the risk: of a shifted map, and in each of the two directions of errors on a right segment and on a shifted one.
Wrong places have three of them."""
UNNOTICED_M = alike_m(CORRELATION_M, 0.0)
"""Two observations in a row are one evidence if they differ by no more than that: 9 m. The test allows more for the
velocity's error, which takes that up itself."""


@dataclass(frozen=True)
class FaultProbabilities:
    """Fault probabilities: that all places of a fix are other ones, that its map is shifted as a whole, and that the
    last aiding of the position without places was wrong.
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
    segment_m: float,
) -> ProtectionLevel:
    """Of a fix.

    reckoned: None where nothing but places bounds the position. segment_m: meters of driving within which places are
    wrong together; a map that is shifted is so for the whole drive.
    """
    driven_m = 3600 * max(speed_mps, SLOW_MPS)
    by_errors = MODEL_ERROR * _sigmas(SHARE * risk_per_hour * CORRELATION_M / driven_m)
    of_segment = risk_per_hour * segment_m / driven_m
    by_shift = MODEL_ERROR * _sigmas(SHARE * of_segment / STRETCH_WRONG)
    along_m, cross_m = (
        max(by_errors * sigma_m, UNNOTICED_M + by_shift * sigma_m)
        for sigma_m in (fix.sigma_along_m, fix.sigma_cross_track_m)
    )
    # Of the probability of being wrong, what may exceed the level: from 1 on, nothing else needs to bound the position.
    by_place = 3 * SHARE * of_segment / max(wrong.place, sys.float_info.min)
    allowed = min(by_place, SHARE * risk_per_hour / max(wrong.map, sys.float_info.min))
    if allowed >= 1:
        return ProtectionLevel(along_m, cross_m)
    if reckoned is None or allowed <= wrong.bound or fix.heading_deg is None:
        return UNBOUNDED
    by_reckoning_m = _sigmas((allowed - wrong.bound) / (1 - wrong.bound) / 2) * reckoned.sigma_m
    off_along_m, off_cross_m = along_and_across((reckoned.east_m, reckoned.north_m), fix.heading_deg)
    further = abs(off_along_m) + by_reckoning_m, abs(off_cross_m) + by_reckoning_m
    return ProtectionLevel(max(along_m, further[0]), max(cross_m, further[1]))


def _sigmas(probability: float) -> float:
    """Standard deviations that a normal error exceeds in either direction with that probability."""
    return -NormalDist().inv_cdf(min(probability, 1.0) / 2)
