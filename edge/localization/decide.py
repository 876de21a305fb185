"""Whether a position is published: from what is known to a `Fix` or a `NoFix`. Read this first. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edge.config import GatesConfig
from edge.journal.records import PlaceFix
from edge.localization.autopilot_covariance import AutopilotCovariance
from edge.localization.dead_reckoning import Odometry
from edge.localization.events import BOUND_WRONG, AutopilotState, Fix, FixRequest
from edge.localization.evidence import Evidence, EvidenceHistory
from edge.localization.fix_rules import NO_PLACES, RULES, GateInputs, NoFix, Rule, refusal
from edge.localization.integrity import CARRIED, ONE_MORE, another_place, innovation_of, is_off, level_of


@dataclass(frozen=True)
class StateEstimate:
    """What is known when a position is asked for.

    place: that position, None while the vehicle is lost. motion: by the autopilot's velocity at its moment.
    pose_sigma_m: see `Fix`. autopilot: what the autopilot reports, without what is known to be wrong of it, which
    is_led says that there is. covariance: of its position. evidence: by the places so far. cross_track: see `Tracker`.
    is_blurred: whether the newest frame's place is recognized, and no sequence match shows where exactly.
    """

    place: PlaceFix | None
    motion: Odometry | None
    pose_sigma_m: float | None
    autopilot: AutopilotState
    covariance: AutopilotCovariance
    evidence: EvidenceHistory
    cross_track: tuple[float, float] | None
    is_blurred: bool
    is_led: bool = False


def decide(
    now_ns: int, known: StateEstimate, limits: FixRequest, gates: GatesConfig, rules: Sequence[Rule] = RULES
) -> Fix | NoFix:
    """A position that may be published at a moment, or why none may."""
    place, motion, own, bound, history = known.place, known.motion, known.autopilot, known.covariance, known.evidence
    if place is None:
        return refusal(GateInputs(gates, limits, own, known.is_blurred), rules) or NoFix(NO_PLACES)

    # What speaks for the place, what the autopilot and own motion say of it, and how probable another one is (Bayes).
    evidence = Evidence() if motion is None or not place.is_position else history.of(place, motion)
    place_wrong = history.wrong(evidence)
    autopilot = innovation_of(place, motion, own, bound, known.cross_track)
    likelihood, may_be_shifted = autopilot.likelihood(place)
    wrong = another_place(evidence, place_wrong, likelihood, may_be_shifted=may_be_shifted)
    # How far off it may be, also by GPS and motion since, in which no place has a part.
    reckoned = bound.dead_reckoning_offset(place, motion, own)
    level = level_of(place, evidence, history, reckoned, own.speed_mps or 0.0, gates)

    facts = GateInputs(
        gates,
        limits,
        own,
        known.is_blurred,
        place,
        age_s=(now_ns - place.stamp_ns) / 1e9,
        distance_m=autopilot.distance_m,
        move_m=0.0 if autopilot.sigma_m is None else autopilot.distance_m or 0.0,
        is_contradicted=autopilot.contradicts(place),
        wrong=wrong,
        level=level,
        is_needed=not limits.is_reset
        or autopilot.sigma_m is None
        or known.is_led
        or is_off(own, place, gates.min_move_m),
    )
    bound_wrong = min(BOUND_WRONG, max(CARRIED, ONE_MORE * place_wrong))
    return refusal(facts, rules) or Fix(place, level, bound_wrong, motion, known.pose_sigma_m)
