"""Whether a position may be published: one argument, from its probability of being of another place.

The autopilot has no such checks, and a wrong position does more harm than none. Two hypotheses explain a fix that is
`distance_m` from where the autopilot believes to be:

    right   the place is right, and the autopilot is wrong by that distance: as its own uncertainty says, or, where
            what bounded it last was wrong, by anything
    wrong   the place is another one: probability `place_wrong`, anywhere within SPREAD_M; or, while GPS was the last
            to bound the autopilot, the map as a whole is shifted (MAP_SHIFTED, SHIFT_M)

`place_wrong` is STRETCH_WRONG for each stretch that is independent evidence (`claims`). Evidence is gathered from every
match, whether or not a position may be published then. docs/integrity.md is the whole argument, with the tests that
could refute it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, east_north_of
from edge.journal.records import PlaceFix
from edge.localization.bound import BOUND_WRONG, Reckoned
from edge.localization.claims import SAME_RECORDING, SPREAD_M, STRETCH_WRONG, Claim, Claims, alike_m
from edge.localization.dead_reckoning import Displacement
from edge.localization.protection_level import ProtectionLevel, Unnoticed, Wrong, protection_level
from edge.localization.refusals import Reason, Refusal
from edge.localization.report import GpsState
from edge.localization.route_estimate import AGREE_SIGMAS, CORRELATION_M

GPS_SIGMA_M = 3.0
"""The least of a receiver, in each direction, whatever it reports: multipath is not in what it reports."""
ONE_MORE = 20.0
"""What bounded the autopilot last was wrong with BOUND_WRONG; after a fix, with ONE_MORE times that of the fix: what
moves the autopilot away from it must rest on one stretch more than what put it there."""
MAP_SHIFTED, SHIFT_M = 1e-4, 100.0
"""Probability that a map is shifted as a whole, and by how much then: judgments, see docs/integrity.md."""
GROWS, BOUND, ACCURATE_M = 1.2, 2.0, 10.0
"""A reset is not sent where it is less certain than the autopilot; GROWS is by how much one position becomes so after
another on recorded drives (of 551, two by more). Of one that is less accurate than ACCURATE_M the autopilot must be
BOUND times as uncertain, since its uncertainty by the distance driven is a bound, not what is expected; where nothing
measures its velocity, none is sent. Messages that are weighed need none of this."""
CERTAIN = frozenset[Reason](("its protection level is above the alert limit", "less accurate than the autopilot"))
"""Reasons against a position whose place is certain enough."""
UNNOTICED = Unnoticed(STRETCH_WRONG, alike_m(CORRELATION_M, 0.0))
"""Two observations in a row count as one claim if they differ by no more than that: 9 m. What the test allows for the
velocity's error besides, that error needs itself."""


@dataclass(frozen=True)
class Situation:
    """What the decision rests on besides the fix, at the time `now_ns`.

    position: the autopilot's own, None if it has none. uncertainty_m: its standard deviation, None if unbounded.
    bound_by_gps, bound_wrong: whether GPS bounded it last, and the probability that what did was wrong. speed_mps: None
    if unknown. last_sent_ns: of the last fix, None if there was none. displacement: by the autopilot's velocity at the
    fix's moment, None if unknown. reckoned: where the vehicle is at that moment without any place, None if unknown.
    is_aided: whether anything besides our positions measures the autopilot's velocity.
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
    is_aided: bool = True
    bound_wrong: float = BOUND_WRONG


@dataclass(frozen=True)
class Limits:
    """Of the message that would carry a position: seconds between two, and of the oldest exposure.

    is_reset: whether the autopilot takes it as it is instead of weighing it.
    """

    period_s: float
    oldest_s: float
    is_reset: bool = False


@dataclass(frozen=True)
class Decision:
    """Whether a position may be published.

    refusal: why it may not, None if it may. level: its protection level; None where its place is not certain enough.
    bound_wrong: the probability that it is wrong as a bound of the autopilot's, once that has used it.
    """

    refusal: Refusal | None
    level: ProtectionLevel | None = None
    bound_wrong: float = BOUND_WRONG


class Integrity:
    """The observations so far, and the decision on each fix."""

    def __init__(self, gates: GatesConfig) -> None:
        self._gates = gates
        self._claims = Claims(gates)

    def contradict_nothing(self) -> None:
        """GPS or the last fix bounded the autopilot's position: what disagreed with it before was its own error."""
        self._claims.contradict_nothing()

    def observe(self, fix: PlaceFix, situation: Situation) -> None:
        """Keep what a fix shows, whether or not it may be published now."""
        if situation.displacement is not None and fix.is_position and not fix.disputed:
            likelihood, is_shift = _by_autopilot(fix, situation)
            self._claims.observe(fix, situation.displacement, likelihood, may_be_shifted=is_shift)

    def decide(self, fix: PlaceFix, situation: Situation, limits: Limits) -> Decision:
        """Whether the fix may be published: not if any of `refusals.RULES` holds. What was observed stays as it is."""
        claim = Claim()
        if situation.displacement is not None and fix.is_position:
            claim = self._claims.of(fix, situation.displacement)
        level = self._protection_level(fix, claim, situation) if claim.observations else None
        place_wrong = self._claims.wrong(claim)
        bound_wrong = min(BOUND_WRONG, ONE_MORE * place_wrong)
        for reason, holds in self.rules(fix, situation, limits, claim, place_wrong, level):
            if holds:
                refusal = Refusal(reason, _distance_m(situation, fix))
                return Decision(refusal, level if reason in CERTAIN else None, bound_wrong)
        return Decision(None, level, bound_wrong)

    def rules(
        self,
        fix: PlaceFix,
        now: Situation,
        limits: Limits,
        claim: Claim,
        place_wrong: float,
        level: ProtectionLevel | None,
    ) -> Iterator[tuple[Reason, bool]]:
        """Each reason, and whether it holds. One may rest on those before, so none is asked after one that holds."""
        gates, age_s = self._gates, (now.now_ns - fix.stamp_ns) / 1e9
        since_s = math.inf if now.last_sent_ns is None else (now.now_ns - now.last_sent_ns) / 1e9
        yield "no position in the map", not fix.is_position
        yield "too old", not 0 <= age_s <= limits.oldest_s
        yield "GPS is healthy", now.gps == "healthy" and not gates.with_gps
        yield "GPS is unknown", now.gps == "unknown" and not gates.with_gps
        yield "the speed is not known", now.speed_mps is None or not math.isfinite(now.speed_mps)
        yield "standing", now.speed_mps is not None and now.speed_mps < gates.min_speed_mps
        yield "too soon", since_s < limits.period_s
        yield "the newest matches disagree", fix.disputed
        yield "the displacement is not known", now.displacement is None
        # A position that nothing bounds, as after a reboot without GPS, is no yardstick: it may be the mere origin.
        distance_m = _distance_m(now, fix) if now.uncertainty_m is not None else None
        is_bounded = distance_m is not None
        yield "impossibly far", distance_m is not None and distance_m > gates.max_move_m
        # An autopilot that drifted since, and came near a shifted map by chance, does not confirm it. A position that
        # is not known says nothing against a place, and nothing for it.
        likelihood, is_shift = _by_autopilot(fix, now)
        likelihood = min(claim.likelihood, likelihood if is_bounded else 1 / SPREAD_M)
        is_shift |= claim.may_be_shifted
        wrong = wrong_probability(place_wrong, likelihood, may_be_shifted=is_shift)
        yield "not confirmed by another place yet", level is None or wrong > gates.risk
        assert level is not None
        yield "its protection level is above the alert limit", not level.is_within(gates.alert_limit_m or math.inf)
        yield "less accurate than the autopilot", fix.sigma_m > _most_sigma_m(now, limits)

    def _protection_level(self, fix: PlaceFix, claim: Claim, situation: Situation) -> ProtectionLevel:
        """By the places of the claim and by what no place had a part in, whatever the autopilot believes now.

        All stretches may be wrong; by different amounts they would not be one claim. Or the newest one alone is, from
        one of its observations on: then that before it bounds the position.
        """
        reckoned, count = situation.reckoned, len(self._claims.stretches(claim.observations))
        alike = 2 * UNNOTICED.most_m / SPREAD_M
        shifted = MAP_SHIFTED
        if reckoned is not None:
            shifted *= _likelihood(reckoned, fix, SHIFT_M) / _likelihood(reckoned, fix)
        all_wrong = Wrong(_wrong(STRETCH_WRONG**count * alike ** (count - 1), reckoned, fix), shifted, BOUND_WRONG)
        level = self._level(fix, all_wrong, reckoned, situation)
        for one in self._claims.wrong_together(claim.observations):
            if one.before is not None:
                newest_wrong = Wrong(_wrong(STRETCH_WRONG, one.before, fix), 0.0, 0.0)
                level = level.or_more(self._level(fix, newest_wrong, one.before, situation))
        return level

    def _level(self, fix: PlaceFix, wrong: Wrong, reckoned: Reckoned | None, situation: Situation) -> ProtectionLevel:
        gates, speed_mps = self._gates, situation.speed_mps or 0.0
        stretch_m = SAME_RECORDING * gates.confirm_m
        return protection_level(fix, wrong, UNNOTICED, reckoned, speed_mps, gates.risk_per_hour, stretch_m)


def _by_autopilot(fix: PlaceFix, now: Situation) -> tuple[float, bool]:
    """How likely the autopilot's position makes a fix, 1 / m, and whether a shifted map may be why they differ.

    Infinite where nothing bounds that position.
    """
    if now.position is None or now.uncertainty_m is None:
        return math.inf, False
    distance_m = distance_from(now.position, fix)
    likelihood = likelihood_of(distance_m, math.hypot(now.uncertainty_m, fix.sigma_m), now.bound_wrong)
    return likelihood, now.bound_by_gps and distance_m > AGREE_SIGMAS * fix.sigma_m


def _distance_m(now: Situation, fix: PlaceFix) -> float | None:
    return None if now.position is None or not fix.is_position else distance_from(now.position, fix)


def _most_sigma_m(now: Situation, limits: Limits) -> float:
    """The largest standard deviation of a position that makes the autopilot's no worse."""
    if not now.is_aided:
        return ACCURATE_M
    if not limits.is_reset or now.uncertainty_m is None:
        return math.inf
    return max(min(GROWS * now.uncertainty_m, ACCURATE_M), now.uncertainty_m / BOUND)


def likelihood_of(distance_m: float, sigma_m: float, bound_wrong: float) -> float:
    """Density per meter of an autopilot's error; bound_wrong: probability that its uncertainty does not hold."""
    normal = math.exp(-((distance_m / sigma_m) ** 2) / 2) / (sigma_m * math.sqrt(math.tau))
    return (1 - bound_wrong) * normal + bound_wrong / SPREAD_M


def wrong_probability(place_wrong: float, likelihood: float, *, may_be_shifted: bool = False) -> float:
    """Probability that a fix is of another place (Bayes), see the module."""
    wrong = place_wrong / SPREAD_M + (MAP_SHIFTED / SHIFT_M if may_be_shifted else 0.0)
    return wrong / (wrong + (1 - place_wrong) * likelihood)


def _likelihood(reckoned: Reckoned, fix: PlaceFix, further_m: float = 0.0) -> float:
    """Of a fix, by what no place had a part in; further_m: standard deviation of another error of the map."""
    sigma_m = math.hypot(reckoned.sigma_m, fix.sigma_m, further_m)
    return likelihood_of(reckoned.distance_m, sigma_m, BOUND_WRONG)


def _wrong(place_wrong: float, reckoned: Reckoned | None, fix: PlaceFix) -> float:
    return place_wrong if reckoned is None else wrong_probability(place_wrong, _likelihood(reckoned, fix))


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
