"""What fixes have shown so far: observations that count once each, joined to claims of where the vehicle is. Pure.

Fixes within a correlation length of each other are one observation. Observations that moved as the vehicle did are one
claim, and those of a claim that may be wrong together are one of its stretches.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import chain
from typing import TypeAlias

from edge.config import GatesConfig
from edge.geodesy import east_north_of
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Displacement
from edge.localization.protection_level import Reckoned
from edge.localization.route_estimate import CORRELATION_M

STRETCH_WRONG = 5e-3
BELIEVED, WRONG_AT_LEAST, WRONG_AT_ONE = 0.6, 0.02, 0.002
"""Probability that one observation is of another place, at a confidence of BELIEVED and below, and of 1."""
SAME_DRIVE = 5.0
"""Two stretches of one drive are independent beyond so many times `confirm_m`."""
ALIKE_M, ALIKE_SHARE = 3.0, 0.1
"""Two fixes moved as the vehicle did if they differ from its displacement by at most so many meters and that share."""
CLAIMS, KEPT = 8, 64


@dataclass
class Observation:
    """A fix that counts as evidence of its own, with the displacement of its moment.

    sigma_m: of its distance from the truth. wrong: probability that it is of another place. likelihood: the least that
    the autopilot's position gave to the fixes of this observation, 1 / m. may_be_shifted: whether GPS had bounded the
    autopilot where a fix contradicted it. before: where the observation before it puts the vehicle, moved on by its
    velocity; None for the first of a claim.
    """

    segment: int
    lat_deg: float
    lon_deg: float
    sigma_m: float
    displacement: Displacement
    wrong: float
    likelihood: float = field(default=math.inf)
    may_be_shifted: bool = False
    before: Reckoned | None = None


Claim: TypeAlias = list[Observation]
"""Oldest first."""


class Claims:
    """The newest claims, and the observations that they rest on."""

    def __init__(self, gates: GatesConfig) -> None:
        self._gates = gates
        self._claims: deque[Claim] = deque(maxlen=CLAIMS)

    def clear(self) -> None:
        """Nothing that was observed counts any more."""
        self._claims.clear()

    def contradict_nothing(self) -> None:
        """The autopilot's position is bounded anew: what disagreed with it before was its own error."""
        for observation in chain.from_iterable(self._claims):
            observation.likelihood, observation.may_be_shifted = math.inf, False

    def observe(self, fix: PlaceFix, displacement: Displacement, likelihood: float, *, may_be_shifted: bool) -> Claim:
        """Keep the fix where it is an observation of its own; the claim that it belongs to."""
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
            here = fix.segment, fix.lat_deg, fix.lon_deg, fix.sigma_m, displacement
            before = self._reckoned_from(claim[-1], fix, displacement) if claim else None
            claim.append(Observation(*here, wrong, likelihood, may_be_shifted, before))
            del claim[:-KEPT]
        return claim

    def stretches(self, claim: Claim) -> list[Claim]:
        """The independent stretches of a claim, oldest first."""
        stretches: list[Claim] = []
        for one in claim:
            same = next((stretch for stretch in stretches if not self._independent(one, stretch[0])), None)
            if same is None:
                stretches.append([one])
            else:
                same.append(one)
        return stretches

    def _reckoned_from(self, before: Observation, fix: PlaceFix, displacement: Displacement) -> Reckoned:
        off_east_m, off_north_m, driven_m = _off(before, fix, displacement)
        drift = max(self._gates.drift_percent / 100, fix.velocity_error)
        return Reckoned(-off_east_m, -off_north_m, math.hypot(before.sigma_m, drift * driven_m))

    def _independent(self, one: Observation, other: Observation) -> bool:
        """Whether two observations are of different stretches: apart by displacement, not by what was driven."""
        times = SAME_DRIVE if one.segment == other.segment else 1.0
        # By a velocity that may be too large, so that a whole stretch that is wrong is not two.
        further = 1 + self._gates.drift_percent / 100
        return _apart_m(one, other.displacement) >= times * further * self._gates.confirm_m


def wrong_by_confidence(confidence: float) -> float:
    """Probability that a belief of that confidence is of another place, by one observation alone."""
    share = min(max((confidence - BELIEVED) / (1 - BELIEVED), 0.0), 1.0)
    return float(WRONG_AT_LEAST ** (1 - share) * WRONG_AT_ONE**share)


def stretch_wrong(stretch: Claim) -> float:
    """Probability that all observations of a stretch are of other places."""
    return max(STRETCH_WRONG, math.prod(one.wrong for one in stretch))


def _off(before: Observation, fix: PlaceFix, displacement: Displacement) -> tuple[float, float, float]:
    """Meters east and north of a fix from where the vehicle went by its velocity, and how far it went."""
    assert fix.lat_deg is not None and fix.lon_deg is not None
    east_m, north_m = east_north_of(fix.lat_deg, fix.lon_deg, (before.lat_deg, before.lon_deg))
    moved_east_m = displacement.east_m - before.displacement.east_m
    moved_north_m = displacement.north_m - before.displacement.north_m
    return east_m - moved_east_m, north_m - moved_north_m, math.hypot(moved_east_m, moved_north_m)


def _moved_alike(before: Observation, fix: PlaceFix, displacement: Displacement) -> bool:
    """Whether the fixes moved as the autopilot's velocity says since the newest observation of a claim."""
    if before.displacement.leg != displacement.leg:
        return False
    off_east_m, off_north_m, driven_m = _off(before, fix, displacement)
    return math.hypot(off_east_m, off_north_m) <= alike_m(driven_m, fix.velocity_error)


def alike_m(driven_m: float, velocity_error: float) -> float:
    """By how much two fixes that far apart may differ from the vehicle's displacement and count as one claim."""
    return ALIKE_M + (ALIKE_SHARE + velocity_error) * driven_m


def _apart_m(observation: Observation, displacement: Displacement) -> float:
    then = observation.displacement
    return math.hypot(displacement.east_m - then.east_m, displacement.north_m - then.north_m)
