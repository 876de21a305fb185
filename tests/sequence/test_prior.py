"""Places by what is known without any: where GPS and odometry reckon the vehicle, and how well."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edge.sequence.consensus import AwayOf, ConsensusSettings, PlaceBelief, PlaceConsensus, PlaceVote
from edge.sequence.prior import OFF_ROAD_M, Prior
from tests.sequence.test_consensus import STRONG

SETTINGS = ConsensusSettings()
ROAD_M = np.column_stack([np.zeros(501), np.linspace(0.0, 1000.0, 501)])
"""A mapped road of 1 km, straight to the north."""
WEAK = replace(STRONG, uniqueness=1.006, sharpness=0.04)


def prior(spot_m: tuple[float, float], sigma_m: float) -> Prior:
    return Prior(sigma_m, np.square(ROAD_M - spot_m).sum(axis=1).astype(np.float32))


def odds(spot_m: tuple[float, float], sigma_m: float, place_m: float) -> float:
    there_m = math.hypot(spot_m[0], spot_m[1] - place_m)
    return float(prior(spot_m, sigma_m).odds(np.array([there_m]))[0])


def of(spot_m: tuple[float, float]) -> AwayOf:
    return lambda drives, along_m: np.hypot(spot_m[0], along_m - spot_m[1])


def test_a_place_where_the_vehicle_is_reckoned_is_more_probable_the_better_that_is_known() -> None:
    by_sigma = [odds((0.0, 500.0), sigma_m, 500.0) for sigma_m in (3.0, 30.0, 100.0, 300.0, 1e5)]
    assert by_sigma == sorted(by_sigma, reverse=True)
    assert by_sigma[0] > 11.5, "votes of even odds are believed"
    assert by_sigma[1] > 2.0
    assert by_sigma[-1] == pytest.approx(1.0, rel=1e-3), "unknown: nothing changes"


def test_a_place_elsewhere_than_reckoned_is_less_probable() -> None:
    assert odds((0.0, 500.0), 3.0, 700.0) <= 0.25
    assert odds((0.0, 500.0), 100.0, 700.0) > 0.3, "2 standard deviations"


@pytest.mark.parametrize("sideways_m", [20.0, 50.0, OFF_ROAD_M])
def test_beside_the_road_by_gps_no_place_of_it_is_more_probable(sideways_m: float) -> None:
    """A parallel road that is not mapped."""
    assert odds((sideways_m, 500.0), 3.0, 500.0) < 1.0


@pytest.mark.parametrize("sideways_m", [0.0, 20.0, 50.0])
def test_a_road_there_speaks_for_a_place_and_that_the_vehicle_is_reckoned_there_does_not(
    sideways_m: float,
) -> None:
    """A road beside the map's that looks like it is reckoned there as well."""
    spot_m = sideways_m, 500.0
    assert prior(spot_m, 37.0).near(np.array([sideways_m]))[0] > 4.0
    assert odds(spot_m, 37.0, 500.0) == pytest.approx(prior(spot_m, 37.0).road)
    assert odds(spot_m, 37.0, 500.0) < 2.5


def test_where_no_place_has_a_position_nothing_is_known() -> None:
    nowhere = Prior(3.0, np.zeros(0, np.float32))
    assert nowhere.road == 1.0
    assert nowhere.odds(np.array([np.nan])) == 1.0


def drive(
    reckoned: bool, spots: list[tuple[float, float]], votes: list[PlaceVote]
) -> tuple[PlaceConsensus, PlaceBelief]:
    consensus, last = PlaceConsensus(SETTINGS), None
    for frame, (spot_m, vote) in enumerate(zip(spots, votes, strict=True)):
        known = (prior(spot_m, 3.0), of(spot_m)) if reckoned else ()
        last = consensus.update(vote, 2.0 * frame, 1.0, *known)
    assert last is not None
    return consensus, last


def test_weak_votes_are_believed_where_the_vehicle_is_reckoned_and_not_by_themselves() -> None:
    at_m = [100.0 + 2.0 * frame for frame in range(50)]
    votes = [replace(WEAK, along_m=one) for one in at_m]
    consensus, both = drive(True, [(0.0, one) for one in at_m], votes)
    assert consensus.by_votes is not None
    assert both.is_believed
    assert not consensus.by_votes.is_believed
    assert consensus.by_votes == drive(False, [(0.0, one) for one in at_m], votes)[1], "as without any reckoning"


def test_votes_for_a_place_beside_whose_road_the_vehicle_is_reckoned_are_believed_less() -> None:
    at_m = [100.0 + 2.0 * frame for frame in range(50)]
    votes = [replace(WEAK, along_m=one, uniqueness=1.1) for one in at_m]
    consensus, both = drive(True, [(40.0, one) for one in at_m], votes)
    assert consensus.by_votes is not None
    assert consensus.by_votes.is_believed
    assert not both.is_believed


def test_what_was_matched_before_the_vehicle_came_onto_the_map_does_not_count_against_a_place() -> None:
    """200 m of unmapped road that leads to the map, whose matches are anywhere, then 60 m of the map."""
    before = [replace(WEAK, along_m=300.0 + 37.0 * frame % 600.0, uniqueness=1.1) for frame in range(100)]
    after = [replace(WEAK, along_m=2.0 * frame, uniqueness=1.1) for frame in range(30)]
    spots = [(0.0, -200.0 + 2.0 * frame) for frame in range(130)]
    consensus, both = drive(True, spots, before + after)
    assert both.is_believed
    assert both.along_m == pytest.approx(58.0)
    assert consensus.by_votes is not None
    assert not consensus.by_votes.is_believed
