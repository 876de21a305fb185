"""What keyframe matches add up to, and how that goes with the votes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import AcceptanceConfig
from edge.sequence import Direction
from edge.sequence.consensus import PlaceBelief
from edge.sequence.keyframe_consensus import (
    ALONE,
    ENOUGH,
    MOST_ODDS,
    KeyframeConsensus,
    KeyframeVote,
    PriorOf,
    confidence_of,
    joined,
)
from edge.sequence.prior import LEAST

FROM = AcceptanceConfig().confidence_from
STRONG, WEAK = MOST_ODDS / ALONE, 1 / ALONE
"""Odds by one match alone."""


def vote(
    along_m: float, at_m: float, odds: float = STRONG, *, drive: int = 0, direction: Direction = "forward"
) -> KeyframeVote:
    return KeyframeVote(drive, along_m, direction, 1e12, at_m, 0.05 * at_m, odds)


def side_by_side(drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Meters of drives that lie on one another but for a few meters, and of a third one far away."""
    return np.column_stack([np.where(drives == 2, 500.0, 3.0 * drives), along_m])


def belief(*seen: KeyframeVote | None, prior_of: PriorOf | None = None) -> PlaceBelief | None:
    keyframes = KeyframeConsensus()
    for one in seen:
        keyframes.add(one)
    last_m = max(one.at_m for one in seen if one is not None)
    return keyframes.belief(last_m, FROM, side_by_side, prior_of)


def is_believed(*seen: KeyframeVote | None, prior_of: PriorOf | None = None) -> bool:
    found = belief(*seen, prior_of=prior_of)
    return found is not None and found.is_believed


def test_two_matches_as_far_apart_as_was_driven_are_believed_and_one_is_not() -> None:
    found = belief(vote(100, 0), vote(104.5, 4))
    assert found is not None and found.is_believed
    assert found.along_m == 104.5
    assert not is_believed(vote(100, 0))
    apart = replace(vote(104, 4), right_m=3.0), replace(vote(104, 4), turn_rad=0.2)
    assert not any(is_believed(vote(100, 0), one) for one in (vote(96, 4), vote(108, 4), *apart))
    assert is_believed(vote(100, 0, direction="reverse"), vote(96, 4, direction="reverse"))
    assert is_believed(vote(100, 4), vote(100, 4)), "of a vehicle that stands"


def test_matches_that_agree_are_as_sure_as_the_strongest_of_them_however_many_there_are() -> None:
    """What resembles a place does so for some frames on end."""
    weak = [vote(100 + at_m, at_m, WEAK) for at_m in (0, 4, 8, 12)]
    found = belief(*weak)
    assert found is not None and found.confidence == pytest.approx(0.5)
    assert is_believed(*weak[:3], vote(112, 12))
    strong = belief(*(vote(100 + at_m, at_m) for at_m in (0, 4, 8, 12)))
    assert strong is not None and strong.confidence == pytest.approx(MOST_ODDS / (1 + MOST_ODDS))


def test_a_match_at_another_place_and_frames_without_one_end_a_belief() -> None:
    agreeing = vote(100, 0), vote(104, 4)
    assert is_believed(*agreeing, None)
    assert not is_believed(*agreeing, vote(300, 8), vote(304, 12)), "two against two"
    assert not is_believed(*agreeing, None, None, None)


def test_two_drives_on_one_street_agree_and_two_streets_do_not() -> None:
    assert is_believed(vote(100, 0), vote(104, 4, drive=1))
    assert not is_believed(vote(100, 0), vote(104, 4, drive=2))


def test_dead_reckoning_makes_a_place_of_one_match_and_keeps_a_twin_from_being_believed() -> None:
    assert is_believed(vote(100, 0), prior_of=lambda drive, along_m: 14.0)
    assert not is_believed(vote(100, 0, WEAK), prior_of=lambda drive, along_m: 14.0)
    assert not is_believed(vote(100, 0), vote(104, 4), prior_of=lambda drive, along_m: LEAST)


def test_one_match_where_it_is_reckoned_is_never_believed_by_a_faint_pose_and_two_that_agree_are() -> None:
    """By the strongest support (2.3) of 228 local maps where none was right, and the highest odds of a prior."""
    alone = confidence_of(2.3)
    seen = [replace(vote(100 + at_m, at_m, alone / (1 - alone)), is_reckoned=True) for at_m in (0, 4)]
    found = belief(seen[0], prior_of=lambda drive, along_m: 16.0)
    assert found is not None and found.confidence < 0.5, "of which a pose would be published"
    assert not is_believed(None, seen[0], replace(seen[1], along_m=110.0), prior_of=lambda drive, along_m: 16.0)
    assert is_believed(*seen)
    assert not is_believed(*(replace(one, is_reckoned=False) for one in seen))


def test_of_one_place_the_surer_of_votes_and_keyframes_counts_and_two_places_speak_against_each_other() -> None:
    keyframes = PlaceBelief(0, 100.0, "forward", 0.95, is_believed=True)
    votes = replace(keyframes, confidence=0.6, is_believed=False)
    assert [one and one.confidence for one in joined(keyframes, votes, FROM, is_one_place=True)] == [0.95, 0.95]
    elsewhere = replace(votes, along_m=300.0, confidence=0.95, is_believed=True)
    both = joined(keyframes, elsewhere, FROM, is_one_place=False)
    assert not any(one is None or one.is_believed for one in both)
    assert joined(keyframes, None, FROM, is_one_place=False) == (keyframes, None)


def test_one_match_is_as_sure_as_its_support_and_no_surer_than_two() -> None:
    assert [confidence_of(support) for support in (ENOUGH, 100.0)] == pytest.approx([STRONG / (1 + STRONG)] * 2)
    assert confidence_of(1.5) < 0.01 < confidence_of(6.0) < 0.4
