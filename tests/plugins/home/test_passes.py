"""Drives that come by the vehicle more than once: which pass the way home begins with, and where none is chosen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.config import RigConfig
from edge.reference_map import open_map_set
from edge_plugins.home import HomeConfig
from edge_plugins.home.route import RoutePlan, RouteStart, plan_route
from sim import geodetic
from tests.plugins.home.test_way_home import Points, arc, joined, straight, waypoints_m

MapAlong = Callable[..., Path]
BRIDGE_M = 6.0
FIRST_PASS_M = 140.0
ON_BRIDGE = (0.0, FIRST_PASS_M)


def over_a_bridge() -> Points:
    """North, a loop to the left of 60 m radius, and over the way out at 140 m, on to the middle of the bridge."""
    loop = arc(60.0, 270)
    return joined(straight(200.0), loop, straight(60.0, 90.0))


def streets_side_by_side(apart_m: float) -> Points:
    """300 m north, to the next street, and 150 m back on it."""
    return joined(straight(300.0), straight(apart_m, 90.0), straight(150.0, 180.0))


def out_and_back(turn_radius_m: float = 6.0) -> Points:
    """200 m north, a turn to the right as wide as a car needs it, and 100 m back, 3.5 m beside."""
    half = arc(turn_radius_m, 180) * [-1, 1]
    into_lane = np.array([[0.0, 0.0], [3.5 - 2 * turn_radius_m, -10.0]])
    return joined(straight(200.0), half, into_lane, straight(100.0, 180.0))


def length_m(drive: Points) -> float:
    return float(np.hypot(*np.diff(drive, axis=0).T).sum())


def plan(
    path: Path, at_m: tuple[float, float], sigma_m: float = 1.5, route_m: float | None = None, **config: Any
) -> RoutePlan:
    start = RouteStart(*geodetic(*at_m), sigma_m=sigma_m, route_m=route_m)
    return plan_route(open_map_set(path), start, HomeConfig(turning_radius_m=0.0, **config))


def undecided(way: RoutePlan) -> list[str]:
    return [text for text in way.refusals if "are not one road" in text]


def test_on_a_bridge_over_the_way_out_it_goes_back_over_the_bridge(map_along: MapAlong) -> None:
    drive = over_a_bridge()
    path = map_along(drive, alt_m=lambda row: BRIDGE_M if row > 130 else 0.0)
    way = plan(path, ON_BRIDGE, route_m=length_m(drive))
    assert way.length_m == pytest.approx(length_m(drive), abs=3.0), "140 m are the road below"
    assert waypoints_m(way)[1][0] < -10.0, "to the west, where the vehicle came from"
    assert not undecided(way)


@pytest.mark.parametrize("alt_m", [BRIDGE_M, 0.0, np.nan], ids=["bridge", "crossing", "no height"])
def test_where_it_is_not_known_how_far_it_drove_nothing_is_chosen(map_along: MapAlong, alt_m: float) -> None:
    before_place = (0.0, FIRST_PASS_M - 1.0)  # at a place itself two rows of the line are as near
    way = plan(map_along(over_a_bridge(), alt_m=lambda row: alt_m if row > 130 else 0.0), before_place)
    assert undecided(way) == [
        "the vehicle may be where the drive was at 138 m and 540 m from its start, which are not one road: drive on to"
        " where it passed once"
    ]


@pytest.mark.parametrize(("since_m", "is_decided"), [(0.0, True), (100.0, True), (400.0, False)])
def test_what_was_driven_since_the_last_place_bounds_which_pass_it_is(
    map_along: MapAlong, since_m: float, is_decided: bool
) -> None:
    """After 400 m the vehicle can have driven back over the loop to the road below."""
    drive = over_a_bridge()
    way = plan(map_along(drive), ON_BRIDGE, route_m=length_m(drive) + since_m)
    assert bool(undecided(way)) != is_decided


@pytest.mark.parametrize("apart_m", [12.0, 30.0])
def test_a_street_beside_is_another_one(map_along: MapAlong, apart_m: float) -> None:
    drive = streets_side_by_side(apart_m)
    path, at_m = map_along(drive), (apart_m, 150.0)
    way = plan(path, at_m, sigma_m=apart_m / 3, route_m=length_m(drive))
    assert way.length_m == pytest.approx(length_m(drive), abs=3.0)
    assert undecided(plan(path, at_m, sigma_m=apart_m / 3)), "as well as the position is known, it may be on either"
    assert not undecided(plan(path, at_m, sigma_m=1.0)), "it is on this one"


@pytest.mark.parametrize("route_known", [False, True])
def test_the_other_lane_is_the_same_road(map_along: MapAlong, route_known: bool) -> None:
    """Also where the height wanders as recorded."""
    drive = out_and_back()
    path = map_along(drive, alt_m=lambda row: 0.7 * np.sin(row / 25))
    way = plan(path, (3.5, 98.0), route_m=length_m(drive) if route_known else None)
    assert way.length_m == pytest.approx(98.0, abs=3.0)
    assert not undecided(way)


@pytest.mark.parametrize(("driven_m", "longer_m"), [(0.5, 6.5), (3.0, 0.0), (12.0, 0.0)])
def test_right_after_a_turn_it_goes_home_in_the_lane_that_it_came_on(
    map_along: MapAlong, driven_m: float, longer_m: float
) -> None:
    """The lane is 6.5 m away: the way led around the turn again, which is refused where that was on the spot."""
    drive = joined(straight(200.0), arc(3.25, 180) * [-1, 1], straight(driven_m, 180.0))
    at_m = (6.5, 200.0 - driven_m)
    start = RouteStart(*geodetic(*at_m), heading_deg=180.0, sigma_m=1.5, route_m=length_m(drive))
    way = plan_route(open_map_set(map_along(drive)), start, HomeConfig(turning_radius_m=2.0))
    assert not way.refusals
    assert way.length_m == pytest.approx(at_m[1] + longer_m, abs=1.0)


@pytest.mark.parametrize("slope", [0.06, 0.1, 0.15])
def test_a_ramp_back_over_the_level_below_is_not_left_sideways(map_along: MapAlong, slope: float) -> None:
    drive = joined(straight(60.0), arc(2.0, 180) * [-1, 1], straight(40.0, 180.0))
    rises_from = 33
    path = map_along(drive, alt_m=lambda row: max(0.0, (row - rises_from) * 2.0 * slope))
    way = plan(path, (4.0, 20.0), route_m=length_m(drive))
    assert way.length_m == pytest.approx(length_m(drive), abs=4.0)
    assert undecided(plan(path, (4.0, 20.0)))


def test_a_lap_of_a_block_is_driven_back_as_it_was_driven(map_along: MapAlong) -> None:
    """The second pass goes the same way as the first: nothing shows that one can turn from it onto the first."""
    drive = joined(straight(100.0), arc(25.0, 360), straight(20.0))
    way = plan(map_along(drive), (0.0, 120.0), route_m=length_m(drive))
    assert way.length_m == pytest.approx(length_m(drive), abs=3.0)


AS_FLOWN = (-220.77, 326.48), (-221.67, 329.87), (-222.76, 333.5), (-223.46, 335.55), (-224.05, 337.2), (-224.7, 339.02)
AND_TURNED = (-225.33, 341.11), (-225.59, 343.08), (-225.17, 344.85), (-223.58, 345.66), (-222.05, 344.47)
"""Places of a drive on road 993, whose U-turn was mapped: GPS failed behind it. The other lane is 3.5 m beside."""


@pytest.mark.parametrize("left_m", [0.0, 3.5])
@pytest.mark.parametrize("places", [3, 4, 5])
def test_a_turn_that_was_mapped_is_not_the_first_leg(map_along: MapAlong, places: int, left_m: float) -> None:
    """It was refused, since the lane beside the arc turns "by 120 degrees on the spot", or led around it again."""
    drive = np.array([*AS_FLOWN, *AND_TURNED[:places]]) - AS_FLOWN[0]
    start = RouteStart(*geodetic(*(np.array((-219.52, 342.22)) - AS_FLOWN[0])), 131.9, 1.5, length_m(drive) + 4.0)
    config = HomeConfig(turning_radius_m=2.0)
    way = plan_route(open_map_set(map_along(drive)), start, config, RigConfig(left_reverse_m=left_m))
    assert not way.findings
    assert waypoints_m(way)[0][1] < 17.5, "where the lane begins, 2 m before the arc"


@pytest.mark.parametrize(("back_m", "rise_m", "way_m"), [(3.0, 0.0, 197.0), (8.0, 0.0, 192.0), (3.0, 0.4, 206.0)])
@pytest.mark.parametrize("degrees", [150, 170])
def test_behind_a_turn_the_way_is_the_lane(
    map_along: MapAlong, back_m: float, rise_m: float, way_m: float, degrees: int
) -> None:
    """A road that climbs in its bend is driven as it was: the leg beside may lie below."""
    drive = joined(straight(200.0), arc(3.25, degrees) * [-1, 1])
    path = map_along(drive, alt_m=lambda row: max(0, row - 100) * rise_m)
    start = RouteStart(*geodetic(6.5, 200.0 - back_m), 180.0, 1.5, length_m(drive) + back_m)
    way = plan_route(open_map_set(path), start, HomeConfig(turning_radius_m=3.0))
    assert not way.refusals
    assert way.length_m == pytest.approx(way_m, abs=4.0)
