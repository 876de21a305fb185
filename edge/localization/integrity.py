"""Whether a position may be published: one argument, from its probability of being of another place.

The autopilot has no such checks, and a wrong position does more harm than none. Two hypotheses explain a fix that is
`distance_m` from where the autopilot believes to be:

    right   the place is right, and the autopilot is wrong by that distance: as its own uncertainty says, or, where
            what bounded it last was wrong, by anything
    wrong   the place is another one: probability `place_wrong`, anywhere within SPREAD_M; or, while GPS was the last
            to bound the autopilot, the map as a whole is shifted (MAP_SHIFTED, SHIFT_M)

`place_wrong` is the product over independent observations. Matches within a correlation length are one observation,
and one stretch of a map, however long it is driven, is never better than STRETCH_WRONG: all of it may have been mapped
wrongly, or resemble another. docs/integrity.md is the whole argument, with the tests that could refute it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import chain
from typing import Literal, TypeAlias

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, east_north_of
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Displacement
from edge.localization.protection_level import ProtectionLevel, Reckoned, Wrong, protection_level
from edge.localization.route_estimate import CORRELATION_M

GpsState: TypeAlias = Literal["healthy", "not healthy", "unknown"]
Reason: TypeAlias = Literal[
    "no position in the map",
    "too old",
    "GPS is healthy",
    "GPS is unknown",
    "the speed is not known",
    "standing",
    "too soon",
    "the newest matches disagree",
    "the displacement is not known",
    "impossibly far",
    "less accurate than the autopilot",
    "not confirmed by another place yet",
    "its protection level is above the alert limit",
]
GPS_SIGMA_M = 3.0
SPREAD_M = 1000.0
STRETCH_WRONG = 5e-3
BOUND_WRONG, ONE_MORE = 0.1, 20.0
"""Probability that what bounded the autopilot last was wrong. After a fix, ONE_MORE times that of the fix: what
moves the autopilot away from it must rest on one stretch more than what put it there."""
MAP_SHIFTED, SHIFT_M = 1e-4, 100.0
SHIFT_SIGMAS = 3.0
BELIEVED, WRONG_AT_LEAST, WRONG_AT_ONE = 0.6, 0.02, 0.002
"""Probability that one observation is of another place, at a confidence of BELIEVED and below, and of 1."""
SAME_DRIVE = 5.0
"""Two stretches of one drive are independent beyond so many times `confirm_m`."""
ALIKE_M, ALIKE_SHARE = 3.0, 0.1
"""Two fixes moved as the vehicle did if they differ from its displacement by at most so many meters and that share."""
ALIKE_AT_M = ALIKE_M + ALIKE_SHARE * CORRELATION_M
"""What that is from one observation to the next."""
CLAIMS, KEPT = 8, 64


@dataclass(frozen=True)
class Situation:
    """What the decision rests on besides the fix, at the time `now_ns`.

    position: the autopilot's own, None if it has none. uncertainty_m: its standard deviation, None if unbounded.
    bound_by_gps: whether GPS bounded it last. speed_mps: None if unknown. last_sent_ns: of the last fix, None if there
    was none. displacement: by the autopilot's velocity at the fix's moment, None if unknown. reckoned: where the
    vehicle is at that moment without any place, None if unknown.
    """

    now_ns: int
    gps: GpsState
    speed_mps: float | None
    position: VehiclePosition | None
    uncertainty_m: float | None
    bound_by_gps: bool
    last_sent_ns: int | None
    displacement: Displacement | None
    reckoned: Reckoned | None = None


@dataclass(frozen=True)
class Refusal:
    """Why a fix is withheld. distance_m: from the autopilot's own position, None if unknown."""

    reason: Reason
    distance_m: float | None = None


@dataclass
class Observation:
    """A fix that counts as evidence of its own, with the displacement of its moment.

    wrong: probability that it is of another place. likelihood: the least that the autopilot's position gave to the
    fixes of this observation, 1 / m. may_be_shifted: whether GPS had bounded the autopilot where a fix contradicted it.
    """

    segment: int
    lat_deg: float
    lon_deg: float
    displacement: Displacement
    wrong: float
    likelihood: float = field(default=math.inf)
    may_be_shifted: bool = False


class Integrity:
    """The observations so far, and the decision on each fix."""

    def __init__(self, gates: GatesConfig) -> None:
        self._gates = gates
        self._claims: deque[list[Observation]] = deque(maxlen=CLAIMS)
        self._bound_wrong, self._published_wrong = BOUND_WRONG, 1.0
        self.protection_level: ProtectionLevel | None = None
        """Of the newest fix; None where its place is not certain enough to be published."""

    def reset(self) -> None:
        """The autopilot has rebooted: its dead reckoning starts again."""
        self._claims.clear()

    def bound(self, *, by_gps: bool) -> None:
        """GPS or the last fix bounded the autopilot's position: what disagreed with it before was its own error."""
        self._bound_wrong = BOUND_WRONG if by_gps else min(BOUND_WRONG, ONE_MORE * self._published_wrong)
        for observation in chain.from_iterable(self._claims):
            observation.likelihood, observation.may_be_shifted = math.inf, False

    def refusal(self, fix: PlaceFix, situation: Situation, period_s: float, oldest_s: float) -> Refusal | None:
        """Why the fix may not be published; None if it may."""
        self.protection_level = None
        gates, age_s = self._gates, (situation.now_ns - fix.stamp_ns) / 1e9
        since_s = math.inf if situation.last_sent_ns is None else (situation.now_ns - situation.last_sent_ns) / 1e9
        speed_mps = situation.speed_mps
        rules: tuple[tuple[bool, Reason], ...] = (
            (not fix.is_position, "no position in the map"),
            (not 0 <= age_s <= oldest_s, "too old"),
            (situation.gps == "healthy" and not gates.with_gps, "GPS is healthy"),
            (situation.gps == "unknown" and not gates.with_gps, "GPS is unknown"),
            (speed_mps is None or not math.isfinite(speed_mps), "the speed is not known"),
            (speed_mps is not None and speed_mps < gates.min_speed_mps, "standing"),
            (since_s < period_s, "too soon"),
            (fix.disputed, "the newest matches disagree"),
            (situation.displacement is None, "the displacement is not known"),
        )
        for against, reason in rules:
            if against:
                return Refusal(reason)
        return self._too_uncertain(fix, situation)

    def _too_uncertain(self, fix: PlaceFix, situation: Situation) -> Refusal | None:
        assert situation.displacement is not None
        gates = self._gates
        distance_m = distance_from(situation.position, fix) if situation.position is not None else None
        likelihood = 1 / SPREAD_M
        if distance_m is not None and situation.uncertainty_m is not None:
            sigma_m = math.hypot(situation.uncertainty_m, fix.sigma_m)
            likelihood = likelihood_of(distance_m, sigma_m, self._bound_wrong)
        is_shift = situation.bound_by_gps and distance_m is not None and distance_m > SHIFT_SIGMAS * fix.sigma_m
        claim = self._observe(fix, situation.displacement, likelihood, may_be_shifted=is_shift)
        if distance_m is not None and distance_m > gates.max_move_m:
            return Refusal("impossibly far", distance_m)
        likelihood = min(likelihood, *(observation.likelihood for observation in claim))
        # An autopilot that drifted since, and came near a shifted map by chance, does not confirm it.
        is_shift = any(observation.may_be_shifted for observation in claim)
        stretches = self._stretches_wrong(claim)
        place_wrong = math.prod(stretches)
        if wrong_probability(place_wrong, likelihood, may_be_shifted=is_shift) > gates.risk:
            return Refusal("not confirmed by another place yet", distance_m)
        self.protection_level = self._protection_level(fix, stretches, situation)
        if gates.alert_limit_m and not self.protection_level.is_within(gates.alert_limit_m):
            return Refusal("its protection level is above the alert limit", distance_m)
        self._published_wrong = place_wrong
        return None

    def _protection_level(self, fix: PlaceFix, stretches: list[float], situation: Situation) -> ProtectionLevel:
        """By the places of the claim and by what no place had a part in, whatever the autopilot believes now.

        stretches: probability that each is wrong. Those that are wrong by different amounts would not be one claim.
        """
        place_wrong = math.prod(stretches) * (2 * ALIKE_AT_M / SPREAD_M) ** (len(stretches) - 1)
        reckoned, likelihood, shifted = situation.reckoned, 1 / SPREAD_M, MAP_SHIFTED
        if reckoned is not None:
            sigma_m = math.hypot(reckoned.sigma_m, fix.sigma_m)
            likelihood = likelihood_of(reckoned.distance_m, sigma_m, BOUND_WRONG)
            if_shifted = likelihood_of(reckoned.distance_m, math.hypot(sigma_m, SHIFT_M), BOUND_WRONG)
            shifted = MAP_SHIFTED * if_shifted / (MAP_SHIFTED * if_shifted + likelihood)
        wrong = Wrong(wrong_probability(place_wrong, likelihood), shifted, BOUND_WRONG)
        gates, speed_mps = self._gates, situation.speed_mps or 0.0
        return protection_level(fix, wrong, reckoned, speed_mps, gates.risk_per_hour, SAME_DRIVE * gates.confirm_m)

    def _observe(
        self, fix: PlaceFix, displacement: Displacement, likelihood: float, *, may_be_shifted: bool
    ) -> list[Observation]:
        """Keep the fix where it is an observation of its own; the claim that it belongs to, oldest first."""
        claim = next((one for one in reversed(self._claims) if _moved_alike(one[-1], fix, displacement)), None)
        if claim is None:
            claim = []
            self._claims.append(claim)
        wrong = wrong_by_confidence(fix.confidence)
        near = [one for one in claim if one.segment == fix.segment and _apart_m(one, displacement) < CORRELATION_M]
        if near:
            near[-1].likelihood = min(near[-1].likelihood, likelihood)
            near[-1].wrong = min(near[-1].wrong, wrong)
            near[-1].may_be_shifted |= may_be_shifted
        else:
            assert fix.lat_deg is not None and fix.lon_deg is not None
            here = fix.segment, fix.lat_deg, fix.lon_deg, displacement
            claim.append(Observation(*here, wrong, likelihood, may_be_shifted))
            del claim[:-KEPT]
        return claim

    def _stretches_wrong(self, claim: list[Observation]) -> list[float]:
        """Of each independent stretch of a claim, the probability that its observations are of other places."""
        stretches: list[list[Observation]] = []
        for one in claim:
            same = next((stretch for stretch in stretches if not self._independent(one, stretch[0])), None)
            if same is None:
                stretches.append([one])
            else:
                same.append(one)
        return [max(STRETCH_WRONG, math.prod(one.wrong for one in stretch)) for stretch in stretches]

    def _independent(self, one: Observation, other: Observation) -> bool:
        """Whether two observations are of different stretches: apart by displacement, not by what was driven."""
        times = SAME_DRIVE if one.segment == other.segment else 1.0
        return _apart_m(one, other.displacement) >= times * self._gates.confirm_m


def wrong_by_confidence(confidence: float) -> float:
    """Probability that a belief of that confidence is of another place, by one observation alone."""
    share = min(max((confidence - BELIEVED) / (1 - BELIEVED), 0.0), 1.0)
    return float(WRONG_AT_LEAST ** (1 - share) * WRONG_AT_ONE**share)


def likelihood_of(distance_m: float, sigma_m: float, bound_wrong: float) -> float:
    """Density per meter of an autopilot's error; bound_wrong: probability that its uncertainty does not hold."""
    normal = math.exp(-((distance_m / sigma_m) ** 2) / 2) / (sigma_m * math.sqrt(math.tau))
    return (1 - bound_wrong) * normal + bound_wrong / SPREAD_M


def wrong_probability(place_wrong: float, likelihood: float, *, may_be_shifted: bool = False) -> float:
    """Probability that a fix is of another place (Bayes), see the module."""
    wrong = place_wrong / SPREAD_M + (MAP_SHIFTED / SHIFT_M if may_be_shifted else 0.0)
    return wrong / (wrong + (1 - place_wrong) * likelihood)


def _moved_alike(before: Observation, fix: PlaceFix, displacement: Displacement) -> bool:
    """Whether the fixes moved as the autopilot's velocity says since the newest observation of a claim."""
    if before.displacement.leg != displacement.leg:
        return False
    assert fix.lat_deg is not None and fix.lon_deg is not None
    east_m, north_m = east_north_of(fix.lat_deg, fix.lon_deg, (before.lat_deg, before.lon_deg))
    moved_east_m = displacement.east_m - before.displacement.east_m
    moved_north_m = displacement.north_m - before.displacement.north_m
    share = ALIKE_SHARE + fix.velocity_error
    allowed_m = ALIKE_M + share * math.hypot(moved_east_m, moved_north_m)
    return math.hypot(east_m - moved_east_m, north_m - moved_north_m) <= allowed_m


def _apart_m(observation: Observation, displacement: Displacement) -> float:
    then = observation.displacement
    return math.hypot(displacement.east_m - then.east_m, displacement.north_m - then.north_m)


def offset_m(position: VehiclePosition, fix: PlaceFix) -> tuple[float, float]:
    """Meters east and north from the autopilot's position at the fix's time to the fix.

    The autopilot's newest position is moved to that time by its velocity.
    """
    apart_s = (fix.stamp_ns - position.stamp_ns) / 1e9
    assert fix.lat_deg is not None and fix.lon_deg is not None
    east_m, north_m = east_north_of(fix.lat_deg, fix.lon_deg, (position.lat_deg, position.lon_deg))
    return east_m - position.east_mps * apart_s, north_m - position.north_mps * apart_s


def distance_from(position: VehiclePosition, fix: PlaceFix) -> float:
    """Length of `offset_m`."""
    return math.hypot(*offset_m(position, fix))


class Uncertainty:
    """Standard deviation of the autopilot's position: set by GPS or a fix, and growing with the distance driven."""

    def __init__(self, drift_percent: float) -> None:
        self._drift = drift_percent / 100
        self._bound: tuple[float, float] | None = None  # standard deviation, and meters driven at that time
        self.by_gps = False
        """Whether GPS set it last."""

    def bind(self, sigma_m: float, driven_m: float | None, *, by_gps: bool = False) -> None:
        """Set the standard deviation at a distance driven."""
        if driven_m is not None:
            self._bound, self.by_gps = (sigma_m, driven_m), by_gps

    def reset(self) -> None:
        """The autopilot has rebooted: nothing bounds its position any more."""
        self._bound, self.by_gps = None, False

    def at(self, driven_m: float | None, reported_m: float | None, velocity_error: float = 0.0) -> float | None:
        """Standard deviation now: the larger of ours and the autopilot's own; None where nothing has bounded it.

        velocity_error: what its velocity is found to be wrong by, as a share of it.
        """
        if self._bound is None or driven_m is None:
            return None
        sigma_m, since_m = self._bound
        drift = max(self._drift, velocity_error)
        ours_m = math.hypot(sigma_m, drift * max(0.0, driven_m - since_m))
        return ours_m if reported_m is None else max(ours_m, reported_m)
