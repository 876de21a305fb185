"""How probable it is that a position is of another place, and how far off it may be: one argument.

The autopilot has no such checks, and a wrong position does more harm than none. Two hypotheses explain a fix that is
`distance_m` from where the vehicle is by dead reckoning since its last aiding, by GPS or by a fix (`position_aiding`):

    right   the place is right, and dead reckoning is wrong by that distance: as its sigma says, or, where the aiding
            was wrong, by anything
    wrong   the place is another one: probability `place_wrong`, anywhere within SPREAD_M; or, while GPS was the last
            aiding, the map as a whole is shifted, or, where dead reckoning since GPS or since the last matches has the
            vehicle beside the road, its street looks the same (MAP_SHIFTED, ELSEWHERE_M)

`place_wrong` is STRETCH_WRONG for each independent segment (`evidence`). Evidence is gathered from every
match, whether or not a position may be published then.

A protection level is exceeded with at most the stated probability in an hour of driving. Three hypotheses share it:

    right   the place is right: the errors are those of the filter, one every CORRELATION_M of driving
    shifted its segment of the map is shifted by no more than what passes for the vehicle's own motion: the errors are
            that, and those of the filter
    wrong   all independent segments that speak for the place are wrong. Then only dead reckoning without places bounds
            the position: from where GPS had it last, by the vehicle's own velocity. As in RAIM by solution separation,
            the level is the distance from there, plus the error bound of that position.

Where neither bounds the position at that risk, it has no protection level (infinite). docs/integrity.md is the whole
argument, with the tests that could refute it, and what was counted.
"""

from __future__ import annotations

import math
import sys
from functools import reduce
from statistics import NormalDist

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, along_and_across, east_north_of
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import SLOW_MPS
from edge.localization.events import BOUND_WRONG, UNBOUNDED, AutopilotState, ProtectionLevel
from edge.localization.evidence import SAME_RECORDING, SPREAD_M, STRETCH_WRONG, Evidence, EvidenceHistory, alike_m
from edge.localization.filter import CORRELATION_M
from edge.localization.hypotheses import ELSEWHERE_M
from edge.localization.odometer_calibration import AGREE_SIGMAS
from edge.localization.position_aiding import DeadReckoningOffset

ONE_MORE = BOUND_WRONG / STRETCH_WRONG
"""An aiding by GPS was wrong with probability BOUND_WRONG, one by a fix with ONE_MORE times that of the fix: a fix that
is away from it must rest on one independent segment more."""
CARRIED = 1e-3
"""Least probability, a judgment, that the vehicle was carried or towed since. Without it, one that was set 30 m ahead
while it rolled was never believed again, though every keypoint pose showed it."""
MAP_SHIFTED = 1e-4
"""Probability that a map is shifted as a whole, or that a street beside looks the same, by ELSEWHERE_M then: a
judgment, see docs/integrity.md."""
MODEL_ERROR = 1.2
"""Times by which errors may be larger than the filter states: counted on simulated drives."""
SHARE = 0.125
"""Of the risk: of a shifted map, and in each of the two directions of errors on a right segment and on a shifted one.
Wrong places have three of them."""
UNNOTICED_M = alike_m(CORRELATION_M, 0.0)
"""Two observations in a row are one evidence if they differ by no more than that: 9 m. The test allows more for the
velocity's error, which takes that up itself."""


def fix_likelihood(
    fix: PlaceFix, innovation: DeadReckoningOffset | None, cross_track: tuple[float, float] | None
) -> tuple[float, bool]:
    """Likelihood of a position by dead reckoning, 1 / m, infinite where that is not known; whether all places may be
    off. cross_track: distance from the road by dead reckoning, see `Tracker`.
    """
    likelihood, is_shift = math.inf, False
    if innovation is not None:
        likelihood = likelihood_of(innovation.distance_m, math.hypot(innovation.sigma_m, fix.sigma_m), innovation.wrong)
        is_shift = innovation.is_gps and innovation.distance_m > AGREE_SIGMAS * fix.sigma_m
    if cross_track is not None:
        likelihood, is_shift = min(likelihood, likelihood_of(*cross_track, STRETCH_WRONG)), True
    return likelihood, is_shift


def likelihood_of(distance_m: float, sigma_m: float, bound_wrong: float) -> float:
    """Density per meter of an error; bound_wrong: probability that its standard deviation does not hold."""
    normal = math.exp(-((distance_m / sigma_m) ** 2) / 2) / (sigma_m * math.sqrt(math.tau))
    return (1 - bound_wrong) * normal + bound_wrong / SPREAD_M


def wrong_probability(place_wrong: float, likelihood: float, *, may_be_shifted: bool = False) -> float:
    """Probability that a fix is of another place (Bayes), see the module."""
    wrong = place_wrong / SPREAD_M + (MAP_SHIFTED / ELSEWHERE_M if may_be_shifted else 0.0)
    return wrong / (wrong + (1 - place_wrong) * likelihood)


def another_place(evidence: Evidence, place_wrong: float, likelihood: float, *, may_be_shifted: bool) -> float:
    """Probability that a position is of another place than its evidence; infinite where nothing was observed.

    Dead reckoning that drifted since, and came near a shifted map by chance, does not confirm it. Where nothing has
    aided it, it says nothing against a place, and nothing for it.
    """
    if not evidence.observations:
        return math.inf
    likelihood = min(evidence.likelihood, 1 / SPREAD_M if math.isinf(likelihood) else likelihood)
    return wrong_probability(place_wrong, likelihood, may_be_shifted=may_be_shifted or evidence.may_be_shifted)


def level_of(
    fix: PlaceFix,
    evidence: Evidence,
    history: EvidenceHistory,
    reckoned: DeadReckoningOffset | None,
    speed_mps: float | None,
    gates: GatesConfig,
) -> ProtectionLevel:
    """By the places of one evidence and by dead reckoning without places.

    All independent segments may be wrong, by the same amount: else they would not agree. Or the newest alone is, from
    one of its observations on: then the one before it bounds the position. Infinite where nothing was observed.
    """
    if not evidence.observations:
        return UNBOUNDED
    count = len(history.independent_segments(evidence.observations))
    alike = 2 * UNNOTICED_M / SPREAD_M
    shifted = MAP_SHIFTED
    if reckoned is not None:
        shifted *= _likelihood(reckoned, fix, ELSEWHERE_M) / _likelihood(reckoned, fix)
    all_wrong = _wrong(STRETCH_WRONG**count * alike ** (count - 1), reckoned, fix)
    before = [one.before for one in history.wrong_together(evidence.observations) if one.before is not None]
    hypotheses = [(all_wrong, shifted, reckoned), *((_wrong(STRETCH_WRONG, one, fix), 0.0, one) for one in before)]
    limits = speed_mps or 0.0, gates.risk_per_hour, SAME_RECORDING * gates.confirm_m
    return reduce(ProtectionLevel.or_more, (protection_level(fix, *one, *limits) for one in hypotheses))


def protection_level(
    fix: PlaceFix,
    place_wrong: float,
    map_wrong: float,
    reckoned: DeadReckoningOffset | None,
    speed_mps: float,
    risk_per_hour: float,
    segment_m: float,
) -> ProtectionLevel:
    """Of a fix.

    place_wrong, map_wrong: fault probabilities, that all places of it are other ones, and that its map is shifted as a
    whole. reckoned: None where nothing but places bounds the position. segment_m: meters of driving within which
    places are wrong together; a map that is shifted is so for the whole drive.
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
    by_place = 3 * SHARE * of_segment / max(place_wrong, sys.float_info.min)
    allowed = min(by_place, SHARE * risk_per_hour / max(map_wrong, sys.float_info.min))
    if allowed >= 1:
        return ProtectionLevel(along_m, cross_m)
    if reckoned is None or allowed <= reckoned.wrong or fix.heading_deg is None:
        return UNBOUNDED
    by_reckoning_m = _sigmas((allowed - reckoned.wrong) / (1 - reckoned.wrong) / 2) * reckoned.sigma_m
    off_along_m, off_cross_m = along_and_across((reckoned.east_m, reckoned.north_m), fix.heading_deg)
    further = abs(off_along_m) + by_reckoning_m, abs(off_cross_m) + by_reckoning_m
    return ProtectionLevel(max(along_m, further[0]), max(cross_m, further[1]))


def _sigmas(probability: float) -> float:
    """Standard deviations that a normal error exceeds in either direction with that probability."""
    return -NormalDist().inv_cdf(min(probability, 1.0) / 2)


def _likelihood(reckoned: DeadReckoningOffset, fix: PlaceFix, further_m: float = 0.0) -> float:
    """Of a fix, by what no place had a part in; further_m: standard deviation of another error of the map."""
    sigma_m = math.hypot(reckoned.sigma_m, fix.sigma_m, further_m)
    return likelihood_of(reckoned.distance_m, sigma_m, BOUND_WRONG)


def _wrong(place_wrong: float, reckoned: DeadReckoningOffset | None, fix: PlaceFix) -> float:
    return place_wrong if reckoned is None else wrong_probability(place_wrong, _likelihood(reckoned, fix))


def offset_m(position: VehiclePosition, fix: PlaceFix) -> tuple[float, float]:
    """Meters east and north from the autopilot's position at the fix's time to the fix."""
    assert fix.lat_deg is not None and fix.lon_deg is not None
    return east_north_of(fix.lat_deg, fix.lon_deg, position.at(fix.stamp_ns))


def is_off(own: AutopilotState, place: PlaceFix, least_m: float) -> bool:
    """Whether the autopilot is beyond doubt elsewhere: by over least_m and AGREE_SIGMAS, along-track or cross-track.

    A reset costs what the filter knows of how its heading error has moved it, which it would take back once its compass
    finds that error (EKF3's `setLatLng` clears those covariances). On real ArduPilot 4.6.3, home at night by 2 sigma of
    sequence matches, 126 resets made 5.4 / 7.8 m of 1.4 / 2.2 m alone (median, 95 %), and at dusk 39 resets 11.9 / 17.3
    m of 2.4 / 2.8 m. With 2.5, wheels that are 3 % wrong were corrected sooner on two roads (24.3 -> 17.6 m, 14.3 ->
    9.7 m, 95 %), and right ones were made worse on a third (3.0 -> 22.9 m). least_m: 0 for any reset.
    """
    if not least_m or own.position is None or place.heading_deg is None:
        return True
    off_m = along_and_across(offset_m(own.position, place), place.heading_deg)
    sigmas_m = place.sigma_along_m, place.sigma_cross_track_m
    return any(
        abs(one_m) > max(least_m, AGREE_SIGMAS * sigma_m) for one_m, sigma_m in zip(off_m, sigmas_m, strict=True)
    )


def distance_from(position: VehiclePosition, fix: PlaceFix) -> float:
    """Length of `offset_m`."""
    return math.hypot(*offset_m(position, fix))
