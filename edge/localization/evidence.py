"""The evidence of fixes so far, counted by independent segments. Pure.

Fixes that moved as the vehicle did are one body of evidence. Those of it that may be wrong together are one independent
segment: the errors of matches are alike over CORRELATION_M, the views of a road over SAME_ROAD, and the positions of
one recording over SAME_RECORDING, however many segments it has; but those of a drive that is as long, and was found to
move as its vehicle did, are wrong all or none. All count by displacement, so that laps add nothing.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TypeAlias

from edge.config import GatesConfig
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Odometry
from edge.localization.filter import CORRELATION_M
from edge.localization.position_aiding import DeadReckoningOffset, OdometryDatum

STRETCH_WRONG = 5e-3
"""Probability that all of a segment is wrong: it was mapped wrongly, or its road resembles another."""
SAME_ROAD, SAME_RECORDING = 1.5, 5.0
"""Times `confirm_m` within which fixes may be wrong together. A road resembled another one for 128 m at the vehicle's
own pace, whatever recording shows it; 410 m of one recording that were 150 m wrong once confirmed themselves."""
ALIKE_M, ALIKE_SHARE = 3.0, 0.1
"""Two fixes moved as the vehicle did if they differ from its displacement by at most so many meters and that share."""
HISTORIES, KEPT = 8, 64
"""The newest bodies of evidence, and observations of each, that are kept: as many of those as 4 km have."""
SPREAD_M = 1000.0
"""A place that is wrong may be anywhere within so many meters along the road."""


@dataclass(frozen=True)
class Observation(OdometryDatum):
    """A fix that is CORRELATION_M from those before it; sigma_m: of its distance from the truth.

    before: where the observation before it puts the vehicle, moved on by its velocity; None for the first.
    checked_m: how far apart the positions of its drive of the map are, if all moved as that vehicle did; else 0.
    """

    recording: str = ""
    checked_m: float = 0.0
    before: DeadReckoningOffset | None = None


IndependentSegment: TypeAlias = list[Observation]
"""Oldest first."""


@dataclass
class Evidence:
    """Observations that moved as the vehicle did, oldest first, and the most that has spoken against them.

    likelihood: the least that `fix_likelihood` gave to a fix, 1 / m. may_be_shifted: whether all places may be off
    alike.
    """

    observations: list[Observation] = field(default_factory=list)
    likelihood: float = math.inf
    may_be_shifted: bool = False


class EvidenceHistory:
    """The newest bodies of evidence: each says that the vehicle is elsewhere than the others do."""

    def __init__(self, gates: GatesConfig) -> None:
        self._gates = gates
        self._kept: deque[Evidence] = deque(maxlen=HISTORIES)

    def contradict_nothing(self) -> None:
        """The position is aided anew: what contradicted it before was its own error."""
        for evidence in self._kept:
            evidence.likelihood, evidence.may_be_shifted = math.inf, False

    def of(self, fix: PlaceFix, displacement: Odometry) -> Evidence:
        """The newest one that the fix belongs to; one without observations if there is none."""
        alike = (one for one in reversed(self._kept) if _moved_alike(one.observations[-1], fix, displacement))
        return next(alike, Evidence())

    def observe(self, fix: PlaceFix, displacement: Odometry, likelihood: float, *, may_be_shifted: bool) -> None:
        """Add a fix to its evidence."""
        evidence = self.of(fix, displacement)
        if not evidence.observations:
            self._kept.append(evidence)
        evidence.likelihood = min(evidence.likelihood, likelihood)
        evidence.may_be_shifted |= may_be_shifted
        newest = evidence.observations[-1] if evidence.observations else None
        if _is_after_silence(newest, displacement) or all(
            _apart_m(one, displacement) >= CORRELATION_M for one in evidence.observations
        ):
            assert fix.lat_deg is not None and fix.lon_deg is not None
            drift = max(self._gates.drift_percent / 100, fix.velocity_error)
            before = None if newest is None else newest.reckoned((fix.lat_deg, fix.lon_deg), displacement, drift)
            of_map = fix.recording, fix.checked_m or 0.0
            where = fix.lat_deg, fix.lon_deg, fix.sigma_m, displacement
            evidence.observations.append(Observation(*where, None, 0.0, False, *of_map, before))
            del evidence.observations[:-KEPT]

    def wrong(self, evidence: Evidence) -> float:
        """Probability that the newest fix is of another place, before anything speaks for or against it.

        All segments are wrong; or those after a silence are, in which the vehicle may have gone to where they say.
        """
        observations = evidence.observations
        wrong = STRETCH_WRONG ** len(self.independent_segments(observations))
        for at in range(1, len(observations)):
            if _is_after_silence(observations[at - 1], observations[at].displacement):
                unknown_m = observations[at].displacement.unknown_since(observations[at - 1].displacement)
                by_chance = min(1.0, 2 * unknown_m / SPREAD_M)
                wrong += STRETCH_WRONG ** len(self.independent_segments(observations[at:])) * by_chance
        return min(wrong, 1.0)

    def independent_segments(self, observations: list[Observation]) -> list[IndependentSegment]:
        """The independent segments of observations, oldest first."""
        segments: list[IndependentSegment] = []
        for one in observations:
            same = next((segment for segment in segments if not self._independent(one, segment[0])), None)
            if same is None:
                segments.append([one])
            else:
                same.append(one)
        return segments

    def wrong_together(self, observations: list[Observation]) -> IndependentSegment:
        """Those that may be wrong together with the newest one, wherever an independent segment begins."""
        return [one for one in observations if not self._independent(one, observations[-1])]

    def _independent(self, one: Observation, other: Observation) -> bool:
        """Whether two observations are of different segments: apart by displacement, not by what was driven."""
        # By a velocity that may be too large, so that one segment that is wrong is not two.
        unit_m = (1 + self._gates.drift_percent / 100) * self._gates.confirm_m
        # A drive of the map that moved as its vehicle did may be wrong as a whole only, and then has two segments.
        is_whole = min(one.checked_m, other.checked_m) >= SAME_RECORDING * unit_m
        times = SAME_RECORDING if one.recording == other.recording and not is_whole else SAME_ROAD
        return _apart_m(one, other.displacement) >= times * unit_m


def _moved_alike(before: Observation, fix: PlaceFix, displacement: Odometry) -> bool:
    """Whether the fixes moved as the autopilot's velocity says since the newest observation of an evidence."""
    then = before.displacement
    driven_m = math.hypot(*displacement.since(then))
    most_m = alike_m(driven_m, fix.velocity_error) + displacement.unknown_since(then)
    assert fix.lat_deg is not None and fix.lon_deg is not None
    return before.reckoned((fix.lat_deg, fix.lon_deg), displacement, 0.0).distance_m <= most_m


def _is_after_silence(before: Observation | None, displacement: Odometry) -> bool:
    """Whether the velocity was unknown for a while since an observation."""
    return before is not None and displacement.unknown_since(before.displacement) > 0


def alike_m(driven_m: float, velocity_error: float) -> float:
    """By how much two fixes that far apart may differ from the vehicle's displacement and be one evidence."""
    return ALIKE_M + (ALIKE_SHARE + velocity_error) * driven_m


def _apart_m(observation: Observation, displacement: Odometry) -> float:
    """The least that it may be."""
    then = observation.displacement
    return math.hypot(*displacement.since(then)) - abs(displacement.unknown_since(then))
