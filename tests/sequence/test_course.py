"""Which places of a map a vehicle cannot pass on its course."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import ModelKey
from edge.sequence import MotionPrior
from edge.sequence.consensus import FEWER_LINES
from edge.sequence.evidence import Roads
from edge_plugins.mapping.builder import Place
from sim.compare.temporary_map import MappedDrive, temporary_map

NORTH, EAST, SOUTH, WEST = 0.0, math.pi / 2, math.pi, -math.pi / 2
CONFIG = AcceptanceConfig(window_m=40.0)
CORNER = np.array([(0.0, 2.0 * place) if place < 100 else (2.0 * (place - 100), 200.0) for place in range(200)])
"""200 m north, then 200 m east."""
ROUTE_M: NDArray[np.float64] = 2.0 * np.arange(200.0)


def roads(east_north_m: NDArray[np.float64], lap: int | None = None, route_m: NDArray[np.float64] = ROUTE_M) -> Roads:
    return Roads(east_north_m, route_m, [(0, len(route_m))], [lap], CONFIG)


def test_a_road_is_against_the_course_that_it_nowhere_leads_along() -> None:
    against = roads(CORNER).against(NORTH)
    near_corner = 119  # the last place whose window reaches to the leg that leads north
    assert not against["forward"][:near_corner].any()
    assert against["forward"][near_corner + 4 :].all()
    assert against["reverse"].all()
    assert roads(CORNER).against(WEST)["reverse"][:75].all()
    assert not roads(CORNER).against(WEST)["reverse"][120:].any()


@pytest.mark.parametrize("off_deg", [0, 55, -55, 65, 180])
def test_a_course_may_differ_by_sixty_degrees(off_deg: float) -> None:
    straight = np.column_stack([np.zeros(200), ROUTE_M])
    against = roads(straight).against(math.radians(off_deg))
    assert against["forward"].all() == (abs(off_deg) > 60)
    assert against["reverse"].all() == (abs(off_deg) < 120)


def test_where_positions_are_unknown_nothing_is_against_a_course() -> None:
    unknown = CORNER.copy()
    unknown[80:90] = np.nan
    against = roads(unknown).against(SOUTH)
    assert not against["forward"][65:105].any()
    assert against["forward"][:55].all()
    assert not any(of.any() for of in roads(CORNER, route_m=np.full(200, np.nan)).against(SOUTH).values())
    assert not any(of.any() for of in roads(np.zeros((200, 2))).against(SOUTH).values())


def test_a_lap_goes_on_at_its_beginning() -> None:
    """At its last places, which lead east, a vehicle may already go as the first ones do."""
    assert not roads(CORNER, lap=200).against(NORTH)["forward"][185:].any()
    assert roads(CORNER).against(NORTH)["forward"][185:].all()


def test_a_match_against_the_course_is_neither_the_best_nor_the_one_that_it_is_held_against() -> None:
    """Going home, the front camera sees what a front drive saw the other way better than what a rear drive saw."""
    rng = np.random.default_rng(2)
    seen_home, seen_out = rng.normal(size=(2, 200, 2, 64)).astype(np.float32)
    places = [Place(row, row * 2.0 / 110_574, 8.0, route_m=row * 2.0) for row in range(200)]
    drives = [MappedDrive(seen_home, places, "rear"), MappedDrive(seen_out[::-1], places, "front")]
    key, config = ModelKey("made", "0" * 64, "fc6", 64), Config()
    homeward = [0.4 * seen_home[place] + 0.9 * seen_out[place] for place in range(150, 50, -1)]
    believed, priors = {}, []
    with temporary_map(drives, key) as maps:
        for course_rad in (None, SOUTH, NORTH):
            matcher = SequenceMatcher(maps, config)
            matches = [
                matcher.push(
                    raw + rng.normal(scale=0.3, size=raw.shape), MotionPrior(2.0 * frame, course_rad=course_rad)
                )
                for frame, raw in enumerate(homeward)
            ]
            part, last = matcher.search.part, matches[-1]
            assert part is not None
            assert part.excludes == (course_rad is not None)
            assert last is not None
            priors.append(matcher._consensus.settings.prior)
            believed[course_rad] = (last.map, last.direction, last.accepted)
    assert believed[None][1:] == ("forward", True), "places of the front drive, passed the wrong way"
    assert believed[SOUTH][1:] == ("reverse", True)
    assert believed[NORTH][1:] == ("forward", True)
    assert priors == [priors[0], priors[0] * FEWER_LINES, priors[0] * FEWER_LINES]
