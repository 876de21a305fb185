"""How probable it is that a position is of another place, and how far off it may be: one argument.

The autopilot has no such checks, and a wrong position does more harm than none. Two hypotheses explain a fix that is
`distance_m` from where the autopilot believes to be:

    right   the place is right, and the autopilot is wrong by that distance: as its own covariance says, or, where its
            last aiding was wrong, by anything
    wrong   the place is another one: probability `place_wrong`, anywhere within SPREAD_M; or, while GPS was the last
            to aid the autopilot, the map as a whole is shifted, or, where dead reckoning since GPS or since the last
            matches has the vehicle beside the road, its street looks the same (MAP_SHIFTED, ELSEWHERE_M)

`place_wrong` is STRETCH_WRONG for each independent segment (`evidence`). Evidence is gathered from every
match, whether or not a position may be published then. docs/integrity.md is the whole argument, with the tests that
could refute it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, along_and_across, east_north_of
from edge.journal.records import PlaceFix
from edge.localization.autopilot_covariance import AutopilotCovariance
from edge.localization.dead_reckoning import Odometry
from edge.localization.events import BOUND_WRONG, UNBOUNDED, AutopilotState, ProtectionLevel
from edge.localization.evidence import SAME_RECORDING, SPREAD_M, STRETCH_WRONG, Evidence, EvidenceHistory
from edge.localization.hypotheses import ELSEWHERE_M
from edge.localization.odometer_calibration import AGREE_SIGMAS
from edge.localization.odometry_datum import DeadReckoningOffset
from edge.localization.protection_level import UNNOTICED_M, FaultProbabilities, protection_level

ONE_MORE = BOUND_WRONG / STRETCH_WRONG
"""The last aiding of the autopilot was wrong with probability BOUND_WRONG; after a fix, with ONE_MORE times that of the
fix: a fix that moves the autopilot away must rest on one independent segment more."""
CARRIED = 1e-3
"""Least probability, a judgment, that the vehicle was carried or towed since. Without it, one that was set 30 m ahead
while it rolled was never believed again, though every keypoint pose showed it."""
MAP_SHIFTED = 1e-4
"""Probability that a map is shifted as a whole, or that a street beside looks the same, by ELSEWHERE_M then: a
judgment, see docs/integrity.md."""


@dataclass(frozen=True)
class Innovation:
    """The autopilot's own position against a place, and the cross-track distance of dead reckoning from the road.

    distance_m: None where one of them is not known. sigma_m: of the autopilot's, None if unbounded. by_gps,
    fault_probability: whether GPS aided it last, and the probability that the aiding was wrong. cross_track: see
    `Tracker`.
    """

    distance_m: float | None
    sigma_m: float | None
    by_gps: bool
    fault_probability: float
    cross_track: tuple[float, float] | None

    def likelihood(self, place: PlaceFix) -> tuple[float, bool]:
        """Likelihood of the position by both, 1 / m, infinite without aiding; whether all places may be off."""
        likelihood, is_shift = math.inf, False
        if self.distance_m is not None and self.sigma_m is not None:
            likelihood = likelihood_of(self.distance_m, math.hypot(self.sigma_m, place.sigma_m), self.fault_probability)
            is_shift = self.by_gps and self.distance_m > AGREE_SIGMAS * place.sigma_m
        if self.cross_track is not None:
            likelihood, is_shift = min(likelihood, likelihood_of(*self.cross_track, STRETCH_WRONG)), True
        return likelihood, is_shift

    def contradicts(self, place: PlaceFix) -> bool:
        """Whether they are further apart than both are uncertain."""
        return (self.distance_m or 0.0) > AGREE_SIGMAS * math.hypot(self.sigma_m or math.inf, place.sigma_m)


def innovation_of(
    place: PlaceFix,
    motion: Odometry | None,
    own: AutopilotState,
    bound: AutopilotCovariance,
    cross_track: tuple[float, float] | None,
) -> Innovation:
    """Of an autopilot's position without aiding, as after a reboot: by GPS and motion since."""
    sigma_m = bound.sigma_m(own)
    reckoned = None if sigma_m is not None else bound.dead_reckoning_offset(place, motion, own)
    if reckoned is not None:
        return Innovation(reckoned.distance_m, reckoned.sigma_m, True, BOUND_WRONG, cross_track)
    # One that nothing aids has run away, or is ours.
    is_known = own.position is not None and own.is_aided and place.is_position
    distance_m = distance_from(own.position, place) if own.position is not None and is_known else None
    aiding = bound.aiding
    by_gps, wrong = (aiding.by_gps, aiding.fault_probability) if aiding else (False, BOUND_WRONG)
    return Innovation(distance_m, sigma_m, by_gps, wrong, cross_track)


def likelihood_of(distance_m: float, sigma_m: float, bound_wrong: float) -> float:
    """Density per meter of an autopilot's error; bound_wrong: probability that its uncertainty does not hold."""
    normal = math.exp(-((distance_m / sigma_m) ** 2) / 2) / (sigma_m * math.sqrt(math.tau))
    return (1 - bound_wrong) * normal + bound_wrong / SPREAD_M


def wrong_probability(place_wrong: float, likelihood: float, *, may_be_shifted: bool = False) -> float:
    """Probability that a fix is of another place (Bayes), see the module."""
    wrong = place_wrong / SPREAD_M + (MAP_SHIFTED / ELSEWHERE_M if may_be_shifted else 0.0)
    return wrong / (wrong + (1 - place_wrong) * likelihood)


def another_place(evidence: Evidence, place_wrong: float, likelihood: float, *, may_be_shifted: bool) -> float:
    """Probability that a position is of another place than its evidence; infinite where nothing was observed.

    An autopilot that drifted since, and came near a shifted map by chance, does not confirm it. A position that is not
    known says nothing against a place, and nothing for it.
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
    speed_mps: float,
    gates: GatesConfig,
) -> ProtectionLevel:
    """By the places of one evidence and by dead reckoning without places, whatever the autopilot believes now.

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
    all_wrong = FaultProbabilities(
        _wrong(STRETCH_WRONG**count * alike ** (count - 1), reckoned, fix), shifted, BOUND_WRONG
    )
    before = [one.before for one in history.wrong_together(evidence.observations) if one.before is not None]
    hypotheses = [
        (all_wrong, reckoned),
        *((FaultProbabilities(_wrong(STRETCH_WRONG, one, fix), 0.0, 0.0), one) for one in before),
    ]
    limits = speed_mps, gates.risk_per_hour, SAME_RECORDING * gates.confirm_m
    return reduce(ProtectionLevel.or_more, (protection_level(fix, *one, *limits) for one in hypotheses))


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
