"""The belief in a place by keyframe matches of single frames, and how it joins that of the votes. Pure.

    support = inliers * share^2 of the pose by a local map
    odds = (support / EVEN)^POWER, at most MOST_ODDS, of the strongest of two or more that agree; of one alone / ALONE
    of two or more where the vehicle is reckoned to be: support over FAINT

Inliers are such a share of all keypoint matches of the local map and the picture. Two keyframe matches agree if their
poses are as far apart along the map's drive as was driven between them, and alike cross-track and in heading: right
ones are, to a meter or two. A street
that resembles a place often does so for some frames on end: so further matches that agree do not add to the strongest,
and no number of them goes beyond MOST_ODDS. Of one place, the surer of keyframe matches and votes counts; those of two
places speak against each other:

    P(place) = odds / (1 + odds of this place + odds of the other)

Of 1,680 pictures of two simulated roads, each against the map of the other, 124 matched a place; the strongest had a
support of 11.7, the next 9.2, where that was the sum over five keyframes with a pose each, which is twice that of one
pose by all five (in the median 14 to 33 and 8 to 16 on their own roads, home, at night). By one pose, of 125 pictures
of other roads, each against 30 places, 4 matched one, the strongest with 1.2; of 228 local maps where none was right,
the strongest had 2.3, the next 1.1. With roll among the unknowns, of 450 pictures elsewhere 21 had a pose, the
strongest with 3.3, 2.6 and 2.5; without, 13, with 2.7, 2.5 and 1.7.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from edge.sequence import Direction
from edge.sequence.consensus import PlaceBelief, PositionsOf

EVEN, POWER = 3.25, 3.0
"""A logistic regression of those matches gave a power of 2.5 to 3.5, even odds at 1.5 to 3.2, of the sum. Here
they are at 6.5 of that, so that a place is believed from a support of 6.8 on: more places look alike where a map is
larger."""
ALONE = 11.5
"""By how much the odds of one match are lower than those of two that agree: no single one is believed, unless dead
reckoning has the vehicle there."""
MOST_ODDS = 22.0
"""0.957, which the least of a prior brings below what is believed: a street of the same plan is not told from its twin.
"""
ENOUGH = EVEN * MOST_ODDS ** (1 / POWER)
"""Support beyond which more makes no place surer."""
FAINT = 0.25
"""Share of it that says as much where the vehicle is reckoned to be: two poses are believed from 1.7 on. One alone is
not: it would be from 2.0 on by a prior of GPS, where nothing is right."""
KEPT_VOTES = 4
"""Verified frames that count, the newest among them."""
AGREE_M, AGREE_RAD = 2.0, math.radians(10)
"""By which two poses of one place may differ: cross-track, along-track beside the odometer's error, and turned."""
MAPS_APART_M = 6.0
"""The same of two drives on one street, whose positions are by GPS."""
VOTES_M = 60.0
"""Driven since a match, beyond which it does not count."""

PriorOf: TypeAlias = Callable[[int, float], float]


def confidence_of(support: float) -> float:
    """That one match alone is right, by the support of all keyframes."""
    odds: float = min((support / EVEN) ** POWER, MOST_ODDS) / ALONE
    return odds / (1 + odds)


def sign_of(direction: Direction) -> int:
    """Of meters along a drive that is passed in a direction."""
    return 1 if direction == "forward" else -1


@dataclass(frozen=True)
class KeyframeVote:
    """A keyframe match as a vote: the vehicle's point along a drive of the map, and its direction of travel.

    lap_m: see `PlaceVote`. at_m, uncertain_m: driven by then, and how uncertain that is. odds: by this match alone.
    right_m, turn_rad: of the vehicle from the drive, seen along it, and clockwise. is_reckoned: whether it was sought
    where the vehicle must be.
    """

    drive: int
    along_m: float
    direction: Direction
    lap_m: float
    at_m: float
    uncertain_m: float
    odds: float
    right_m: float = 0.0
    turn_rad: float = 0.0
    is_reckoned: bool = False

    @property
    def odds_agreed(self) -> float:
        """Where another vote agrees."""
        return min(self.odds * ALONE / (FAINT**POWER if self.is_reckoned else 1.0), MOST_ODDS)

    def now_m(self, driven_m: float) -> float:
        """Where it puts the vehicle after so much was driven."""
        return self.along_m + (driven_m - self.at_m) * sign_of(self.direction)


class KeyframeConsensus:
    """The newest votes by keyframes, and the belief that they add up to."""

    def __init__(self) -> None:
        self._kept = deque[KeyframeVote | None](maxlen=KEPT_VOTES)

    def add(self, vote: KeyframeVote | None) -> None:
        """Of a verified frame; None if it matched no place of the map."""
        self._kept.append(vote)

    def belief(
        self, driven_m: float, least: float, positions_of: PositionsOf, prior_of: PriorOf | None = None
    ) -> PlaceBelief | None:
        """The place that most speaks for, after so much was driven; None without a match.

        least: the confidence from which it is believed. positions_of: where points along drives lie. prior_of: odds of
        being at a point along a drive without any match.
        """
        kept = [one for one in self._kept if one is not None and driven_m - one.at_m <= VOTES_M]
        best: tuple[float, KeyframeVote, list[KeyframeVote]] | None = None
        for newest in reversed(kept):
            group = [one for one in kept if _agree(newest, one, driven_m, positions_of)]
            odds = max(one.odds_agreed for one in group) if len(group) > 1 else newest.odds
            odds *= prior_of(newest.drive, newest.now_m(driven_m)) if prior_of else 1.0
            if best is None or odds > best[0]:
                best = odds, newest, group
        if best is None:
            return None
        odds, newest, group = best
        confidence = odds / (1 + odds + max((one.odds for one in kept if one not in group), default=0.0))
        where = newest.drive, newest.now_m(driven_m), newest.direction
        return PlaceBelief(*where, confidence, confidence >= least)


def _agree(one: KeyframeVote, other: KeyframeVote, driven_m: float, positions_of: PositionsOf) -> bool:
    """Whether two votes put the vehicle at one place."""
    apart_m = abs(one.uncertain_m - other.uncertain_m) + AGREE_M
    at_m, other_m = one.now_m(driven_m), other.now_m(driven_m)
    if (one.drive, one.direction) == (other.drive, other.direction):
        is_beside = abs(one.right_m - other.right_m) <= AGREE_M and abs(one.turn_rad - other.turn_rad) <= AGREE_RAD
        return is_beside and abs(math.remainder(at_m - other_m, one.lap_m)) <= apart_m
    spots_m = positions_of(np.array([one.drive, other.drive]), np.array([at_m, other_m]))
    return bool(np.hypot(*(spots_m[0] - spots_m[1])) <= apart_m + MAPS_APART_M)


def joined(
    keyframes: PlaceBelief, votes: PlaceBelief | None, least: float, *, is_one_place: bool
) -> tuple[PlaceBelief, PlaceBelief | None]:
    """Both beliefs, weighed with each other: of one place, or against each other. least: see `KeyframeConsensus`."""
    if votes is None:
        return keyframes, None
    odds = [one.confidence / max(1 - one.confidence, 1e-9) for one in (keyframes, votes)]
    if is_one_place:
        of_keyframes = of_votes = max(keyframes.confidence, votes.confidence)
    else:
        of_keyframes, of_votes = (own / (1 + sum(odds)) for own in odds)
    return (
        replace(keyframes, confidence=of_keyframes, is_believed=of_keyframes >= least),
        replace(votes, confidence=of_votes, is_believed=of_votes >= least),
    )
