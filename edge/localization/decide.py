"""Whether a position is published: from what is known to a `Fix` or a `NoFix`. Read this first. Pure.

A position passes only if no rule of RULES holds, and what is not known counts as against it. One may rest on those
before it, so none is asked after one that holds. docs/positions.md says what each means.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from msgspec import Struct

from edge.config import GatesConfig
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Odometry
from edge.localization.events import BOUND_WRONG, UNBOUNDED, AutopilotState, Fix, FixRequest, ProtectionLevel
from edge.localization.evidence import Evidence, EvidenceHistory
from edge.localization.integrity import (
    CARRIED,
    ONE_MORE,
    another_place,
    distance_from,
    fix_likelihood,
    is_off,
    level_of,
)
from edge.localization.position_aiding import PositionAiding


@dataclass(frozen=True)
class GateInputs:
    """The inputs that the rules check; None: not known.

    autopilot, is_blurred: see `StateEstimate`. place: the position. age_s: since its moment. distance_m: from the
    autopilot's own. away_m: from where the vehicle is by dead reckoning, 0 where nothing has aided that since boot.
    wrong: probability of another place, infinite where nothing was observed. level: how far off it may be. is_needed:
    of a reset, whether the autopilot is beyond doubt elsewhere.
    """

    gates: GatesConfig
    request: FixRequest
    autopilot: AutopilotState
    is_blurred: bool
    place: PlaceFix | None = None
    age_s: float = math.inf
    distance_m: float | None = None
    away_m: float = 0.0
    wrong: float = math.inf
    level: ProtectionLevel = UNBOUNDED
    is_needed: bool = True

    @property
    def waits_for_gps(self) -> bool:
        """Whether the autopilot would get a position beside its GPS, which nobody asked for."""
        return self.request.moves_autopilot and not self.gates.with_gps


class Rule(NamedTuple):
    """A reason as the journal and the pilot have it, and when it holds; detail: what else is said of it."""

    reason: str
    holds: Callable[[GateInputs], bool]
    detail: Callable[[GateInputs], str] = lambda facts: ""


GPS_HEALTHY = "GPS is healthy"
NOT_NEEDED = "no reset is needed"
NO_PLACES = "the places do not agree yet"
STANDING = "standing"
TWO_AUTOPILOTS = "two autopilots have the same ids"
RULES = (
    Rule(TWO_AUTOPILOTS, lambda now: now.autopilot.is_doubled),
    # After one position with the stamp of the old clock, the next hundred would count as half a second old.
    Rule(
        "the autopilot's clock is not known",
        lambda now: now.request.moves_autopilot and not now.autopilot.is_clock_known,
    ),
    Rule("nothing is recognized now", lambda now: bool(now.request.unable), lambda now: now.request.unable),
    Rule("recognized, but not exactly", lambda now: now.place is None and now.is_blurred),
    Rule(NO_PLACES, lambda now: now.place is None),
    Rule("too old", lambda now: not 0 <= now.age_s <= now.request.oldest_s),
    Rule(GPS_HEALTHY, lambda now: now.autopilot.gps == "healthy" and now.waits_for_gps),
    Rule(
        "GPS is unknown",
        lambda now: now.autopilot.gps == "unknown" and now.waits_for_gps,
        lambda now: now.autopilot.gps_why,
    ),
    Rule(
        "the speed is not known",
        lambda now: now.autopilot.speed_mps is None or not math.isfinite(now.autopilot.speed_mps),
    ),
    # One error would be sent again and again, and the filter believe it more each time.
    Rule(STANDING, lambda now: (now.autopilot.speed_mps or 0.0) < now.gates.min_speed_mps),
    Rule("the innovation test fails", lambda now: now.place is not None and now.place.disputed),
    Rule("impossibly far", lambda now: now.away_m > now.gates.max_move_m),
    Rule("not confirmed by another place yet", lambda now: math.isinf(now.wrong) or now.wrong > now.gates.risk),
    Rule(
        "its protection level is above the alert limit",
        lambda now: not now.level.is_within(now.gates.alert_limit_m or math.inf),
    ),
    Rule(NOT_NEEDED, lambda now: not now.is_needed),
)
"""In the order in which they are checked."""


class NoFix(Struct, frozen=True, tag="Refusal"):
    """Why a position is withheld.

    detail: what else is known of the reason. fix: the position, None where there is none. distance_m: from the
    autopilot's own position. level: see `Fix`. None: not known.
    """

    reason: str
    detail: str = ""
    fix: PlaceFix | None = None
    distance_m: float | None = None
    level: ProtectionLevel | None = None

    def __str__(self) -> str:
        return f"{self.reason}: {self.detail}" if self.detail else self.reason


def refusal(facts: GateInputs) -> NoFix | None:
    """The first reason that holds, None where a position may be published."""
    rule = next((one for one in RULES if one.holds(facts)), None)
    if rule is None:
        return None
    return NoFix(rule.reason, rule.detail(facts), facts.place, facts.distance_m, facts.level)


@dataclass(frozen=True)
class StateEstimate:
    """What is known when a position is asked for.

    place: that position, None while the vehicle is lost. motion: by the autopilot's velocity at its moment.
    pose_sigma_m: see `Fix`. autopilot: what the autopilot reports, without a GPS that is ignored. aiding: of the
    vehicle's position. evidence: by the places so far. cross_track: see `Tracker`. is_blurred: whether the newest
    frame's place is recognized, and no sequence match shows where exactly.
    """

    place: PlaceFix | None
    motion: Odometry | None
    pose_sigma_m: float | None
    autopilot: AutopilotState
    aiding: PositionAiding
    evidence: EvidenceHistory
    cross_track: tuple[float, float] | None
    is_blurred: bool


def decide(now_ns: int, known: StateEstimate, limits: FixRequest, gates: GatesConfig) -> Fix | NoFix:
    """A position that may be published at a moment, or why none may."""
    place, motion, own, aiding, history = known.place, known.motion, known.autopilot, known.aiding, known.evidence
    if place is None:
        return refusal(GateInputs(gates, limits, own, known.is_blurred)) or NoFix(NO_PLACES)

    # What speaks for the place, what dead reckoning says of it, and how probable another one is (Bayes).
    evidence = Evidence() if motion is None or not place.is_position else history.of(place, motion)
    place_wrong = history.wrong(evidence)
    innovation = aiding.innovation(place, motion, own)
    likelihood, may_be_shifted = fix_likelihood(place, innovation, known.cross_track)
    wrong = another_place(evidence, place_wrong, likelihood, may_be_shifted=may_be_shifted)
    # How far off it may be, also by GPS and motion since, in which no place has a part.
    level = level_of(
        place, evidence, history, aiding.innovation(place, motion, own, without_places=True), own.speed_mps, gates
    )

    away_m = 0.0 if innovation is None else innovation.distance_m
    is_aided = aiding.is_bounded and own.is_aided
    facts = GateInputs(
        gates,
        limits,
        own,
        known.is_blurred,
        place,
        age_s=(now_ns - place.stamp_ns) / 1e9,
        distance_m=None if own.position is None or not place.is_position else distance_from(own.position, place),
        away_m=away_m if aiding.is_bounded else 0.0,
        wrong=wrong,
        level=level,
        is_needed=not (limits.is_reset and is_aided) or is_off(own, place, gates.min_move_m),
    )
    bound_wrong = min(BOUND_WRONG, max(CARRIED, ONE_MORE * place_wrong))
    return refusal(facts) or Fix(place, level, bound_wrong, motion, known.pose_sigma_m)
