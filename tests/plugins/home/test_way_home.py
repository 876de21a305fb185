"""The way home along drives of known shapes: its line, and what the checks find on it."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.config import RigConfig
from edge.errors import MapError
from edge.geodesy import east_north
from edge.reference_map import open_map_set
from edge_plugins.home import HomeConfig
from edge_plugins.home.drive_line import simplified
from edge_plugins.home.route import RoutePlan, RouteStart, mission_items, plan_route
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG, geodetic

MapAlong = Callable[..., Path]
Points = NDArray[np.float64]
SPACING_M = 2.0


def straight(length_m: float, course_deg: float = 0.0, start: tuple[float, float] = (0.0, 0.0)) -> Points:
    along_m = np.arange(0.0, length_m + SPACING_M / 2, SPACING_M)
    course_rad = math.radians(course_deg)
    return np.array(start) + along_m[:, None] * [math.sin(course_rad), math.cos(course_rad)]


def arc(radius_m: float, degrees: float) -> Points:
    """A left turn from north, which begins at the origin."""
    turned_rad = np.arange(0.0, math.radians(degrees), SPACING_M / radius_m)
    return radius_m * np.column_stack([np.cos(turned_rad) - 1, np.sin(turned_rad)])


def joined(*lines: Points) -> Points:
    """Each line from the end of the one before it; they do not turn."""
    points_m = lines[0]
    for line in lines[1:]:
        points_m = np.vstack([points_m, points_m[-1] + line[1:]])
    return points_m


def plan(
    path: Path, at_m: tuple[float, float] | None = None, heading_deg: float | None = None, **config: Any
) -> RoutePlan:
    start = None if at_m is None else RouteStart(*geodetic(*at_m), heading_deg, 1.0)
    return plan_route(open_map_set(path), start, HomeConfig(**config))


def waypoints_m(way: RoutePlan) -> Points:
    lat_deg, lon_deg = np.array(way.positions_deg).T
    return east_north(lat_deg, lon_deg, (ORIGIN_LAT_DEG, ORIGIN_LON_DEG))


def away_m(points_m: Points, line_m: Points) -> Points:
    """Distance of points from a line, the slow and obvious way: its legs in steps of a centimeter."""
    dense = [
        start + (end - start) * np.linspace(0, 1, 2 + int(np.hypot(*(end - start)) * 100))[:, None]
        for start, end in pairwise(line_m)
    ]
    return np.array([np.hypot(*(np.vstack(dense) - point).T).min() for point in points_m])


def test_a_straight_drive_comes_back_as_two_waypoints(map_along: MapAlong) -> None:
    way = plan(map_along(straight(300.0)))
    assert waypoints_m(way) == pytest.approx(np.array([[0.0, 300.0], [0.0, 0.0]]), abs=0.01)
    assert way.length_m == pytest.approx(300.0, abs=0.01)
    assert not way.findings


@pytest.mark.parametrize("tolerance_m", [0.1, 0.5, 2.0])
def test_no_place_is_further_from_the_waypoints_than_the_tolerance(map_along: MapAlong, tolerance_m: float) -> None:
    drive = joined(straight(40.0), arc(30.0, 90), straight(40.0, -90.0), arc(12.0, 80) @ np.array([[0, 1], [-1, 0]]))
    way = plan(map_along(drive), tolerance_m=tolerance_m)
    assert away_m(drive, waypoints_m(way)).max() <= tolerance_m + 0.02
    assert 2 < len(way.positions_deg) < len(drive) / 2
    assert waypoints_m(way)[-1] == pytest.approx(drive[0], abs=0.01)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.05, 5.0))
def test_simplification_of_any_walk_keeps_within_its_tolerance(seed: int, tolerance_m: float) -> None:
    points_m = np.random.default_rng(seed).normal(0, 2, (60, 2)).cumsum(axis=0)
    kept = simplified(points_m, tolerance_m)
    assert kept[0] == 0
    assert kept[-1] == 59
    assert away_m(points_m, points_m[kept]).max() <= tolerance_m + 0.01


def test_it_begins_where_the_vehicle_is(map_along: MapAlong) -> None:
    way = plan(map_along(straight(300.0)), at_m=(3.0, 101.0))
    assert waypoints_m(way)[0] == pytest.approx((0.0, 101.0), abs=0.01)
    assert way.length_m == pytest.approx(101.0, abs=0.01)


def test_the_newest_drive_is_used_and_another_can_be_named(map_along: MapAlong) -> None:
    maps = open_map_set(map_along(straight(100.0), straight(200.0, 90.0)))
    assert plan_route(maps, None, HomeConfig()).length_m == pytest.approx(200.0, abs=0.01)
    assert plan_route(maps, None, HomeConfig(), drive=1).length_m == pytest.approx(100.0, abs=0.01)
    with pytest.raises(MapError, match="no drive 3; it has 2"):
        plan_route(maps, None, HomeConfig(), drive=3)


def test_an_interrupted_drive_is_one(map_along: MapAlong) -> None:
    """Where its positions were unknown for a while, a live map begins a further segment of the same recording."""
    first, second = straight(100.0), straight(100.0, 0.0, (0.0, 116.0))
    driven_m = [np.arange(51) * 2.0, 116.0 + np.arange(51) * 2.0]
    way = plan(map_along(first, second, driven_m=driven_m, source="20261120T200000Z"))
    assert way.length_m == pytest.approx(216.0, abs=0.01)
    assert not way.findings
    way = plan(map_along(first, second, driven_m=driven_m, source="again", name="again"), max_gap_m=10.0)
    assert the_finding(way) == "from 100 m to 116 m: no position for 16 m; max_gap_m is 10"


def test_a_way_that_ends_where_the_map_was_interrupted_is_no_way_home(map_along: MapAlong) -> None:
    """The odometer began again after 100 m. Further on, the way is the longer part, and the pilot reads of it."""
    for length_m, refuses in ((50.0, True), (200.0, False)):
        first, second = straight(100.0), straight(length_m, 0.0, (0.0, 116.0))
        driven_m = [np.arange(len(line)) * 2.0 for line in (first, second)]
        path = map_along(first, second, driven_m=driven_m, source="20261120T200000Z", name=f"{length_m:.0f}")
        way = plan(path)
        assert the_finding(way, refuses=refuses).startswith("the way ends 116 m short of where the recording began")
        assert way.briefs(refuses=refuses) == ["ends 116 m short of home"]
        assert not plan_route(open_map_set(path), None, HomeConfig(), drive=2).refusals


def test_the_newest_map_of_a_folder_has_the_newest_drive(map_along: MapAlong) -> None:
    for name, length_m, written_s in (("maps/b", 100.0, 3e8), ("maps/a", 200.0, 4e8), ("maps/c", 300.0, 2e8)):
        os.utime(map_along(straight(length_m), name=name) / "map.json", (written_s, written_s))
    way = plan(map_along(straight(10.0), name="other").parent / "maps")
    assert way.length_m == pytest.approx(200.0, abs=0.01)
    assert way.words == "back along drive 1 (drive_0)"


def test_a_drive_that_came_back_on_its_own_road_is_driven_once(map_along: MapAlong) -> None:
    """Out 200 m, back 100 m in the other lane: home is 100 m away, not 300."""
    drive = np.vstack([straight(200.0), straight(100.0, 180.0, (3.0, 200.0))])
    way = plan(map_along(drive), at_m=(3.0, 100.0))
    assert way.length_m == pytest.approx(100.0, abs=1.0)
    assert not way.refusals


def test_another_lane_is_beside_the_drive(map_along: MapAlong) -> None:
    """In left-hand traffic the way home is to the left of the drive, as seen on the way home."""
    drive = joined(straight(60.0), arc(20.0, 90), straight(60.0, -90.0))
    way = plan_route(open_map_set(map_along(drive)), None, HomeConfig(), RigConfig(left_reverse_m=3.5))
    assert away_m(waypoints_m(way), drive) == pytest.approx(3.5, abs=0.1)
    assert waypoints_m(way)[-1] == pytest.approx((3.5, 0.0), abs=0.05)
    assert not way.refusals


def the_finding(way: RoutePlan, refuses: bool = True) -> str:
    (finding,) = way.findings
    assert finding.refuses == refuses
    return finding.text


def test_a_gap_is_refused(map_along: MapAlong) -> None:
    drive = straight(300.0)
    drive[60:75] = np.nan
    path = map_along(drive, driven_m=[np.arange(len(drive)) * SPACING_M])
    assert the_finding(plan(path)) == "from 150 m to 182 m: no position for 32 m; max_gap_m is 20"
    assert not plan(path, max_gap_m=40.0).findings


def test_a_jump_of_the_gps_is_refused(map_along: MapAlong) -> None:
    """The odometer of the drive shows that the vehicle did not move so far."""
    drive = np.vstack([straight(100.0), straight(100.0, 0.0, (0.0, 115.0))])
    driven_m = np.r_[np.arange(51) * 2.0, 102.0 + np.arange(51) * 2.0]
    finding = the_finding(plan(map_along(drive, driven_m=[driven_m])))
    assert finding == "from 100 m to 115 m: the GPS position moved 15 m where the vehicle drove 2 m"


@pytest.mark.parametrize("side", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)])
def test_a_drive_on_which_gps_was_spoofed_is_refused(map_along: MapAlong, side: tuple[float, float]) -> None:
    """By 1 m/s at 5 m/s to 100 m, from 200 m on: no two places are far from each other."""
    drive = joined(straight(400.0), arc(60.0, 90), straight(400.0, -90.0))
    driven_m = np.arange(len(drive)) * SPACING_M
    off_m = np.clip((driven_m - 200.0) / 5.0, 0.0, 100.0)[:, None] * side
    heading_deg = np.degrees(np.arctan2(*np.gradient(drive, axis=0).T))
    honest = map_along(drive, driven_m=[driven_m], heading_deg=lambda row: heading_deg[row])
    assert not plan(honest).refusals
    spoofed = map_along(drive + off_m, driven_m=[driven_m], heading_deg=lambda row: heading_deg[row], name="spoofed")
    assert any("the GPS position moved" in text for text in plan(spoofed).refusals)


def test_positions_that_were_measured_badly_are_refused(map_along: MapAlong) -> None:
    path = map_along(straight(300.0), sigma_m=lambda row: 8.0 if 50 <= row <= 60 or row == 100 else 2.0)
    assert plan(path).refusals == [
        "from 100 m to 100 m: the positions are only known to 8 m; max_sigma_m is 5",
        "from 180 m to 200 m: the positions are only known to 8 m; max_sigma_m is 5",
    ]
    assert not plan(path, max_sigma_m=8.0).findings


def test_an_accuracy_that_was_not_recorded_is_assumed(map_along: MapAlong) -> None:
    path = map_along(straight(300.0), sigma_m=lambda row: math.nan)
    assert not plan(path).findings
    assert "known to 5 m" in the_finding(plan(path, max_sigma_m=4.0))


def test_positions_without_an_odometer_are_no_jumps(map_along: MapAlong) -> None:
    drive = np.vstack([straight(100.0), straight(100.0, 0.0, (0.0, 115.0))])
    assert not plan(map_along(drive, driven_m=[np.full(len(drive), np.nan)])).findings


@pytest.mark.parametrize(("radius_m", "passes"), [(4.0, False), (5.0, False), (7.0, True), (12.0, True), (40.0, True)])
def test_a_bend_is_held_against_the_turning_radius(map_along: MapAlong, radius_m: float, passes: bool) -> None:
    drive = joined(straight(40.0), arc(radius_m, 170), straight(40.0, -170.0))
    way = plan(map_along(drive), tolerance_m=0.1)
    assert bool(way.refusals) != passes, way.findings
    assert all(re.match(r"from \d+ m to \d+ m: needs a turning radius of \d", text) for text in way.refusals)
    assert not plan(map_along(drive, name="again"), tolerance_m=0.1, turning_radius_m=radius_m * 0.8).refusals


def test_a_spike_and_a_turn_on_the_spot_are_refused(map_along: MapAlong) -> None:
    spike = straight(200.0)
    spike[50] += (12.0, 0.0)
    assert "degrees on the spot" in plan(map_along(spike)).refusals[0]
    back = np.vstack([straight(200.0), straight(100.0, 180.0, (0.0, 198.0)), straight(100.0, 90.0, (2.0, 98.0))])
    refusals = plan(map_along(back, name="back")).refusals
    assert refusals[0].startswith("at 204 m: a turn of 180 degrees on the spot: drive past it")


def test_a_vehicle_that_turns_on_the_spot_needs_no_radius(map_along: MapAlong) -> None:
    drive = joined(straight(50.0), straight(50.0, 90.0))
    assert not plan(map_along(drive), turning_radius_m=0.0).refusals


def test_a_start_too_far_from_the_drive_is_refused(map_along: MapAlong) -> None:
    path = map_along(straight(300.0))
    assert (
        the_finding(plan(path, at_m=(31.0, 100.0)))
        == "the vehicle is 31 m from where the way begins; max_start_m is 20"
    )
    assert not plan(path, at_m=(31.0, 100.0), max_start_m=32.0).findings


def test_a_position_that_is_not_known_well_is_refused(map_along: MapAlong) -> None:
    start = RouteStart(*geodetic(0.0, 100.0), sigma_m=25.0)
    way = plan_route(open_map_set(map_along(straight(300.0))), start, HomeConfig())
    assert the_finding(way) == "the vehicle's position is only known to 25 m; max_start_m is 20"


def test_a_vehicle_that_points_away_is_told_to_turn(map_along: MapAlong) -> None:
    path = map_along(straight(300.0))
    assert the_finding(plan(path, (0.0, 100.0), 10.0), refuses=False).startswith(
        "the vehicle points 170 degrees away from the way: it needs 12 m beside it to turn"
    )
    assert plan(path, (0.0, 100.0), 10.0).briefs(refuses=False) == ["turn first, 170 degrees off"]
    assert plan(path, (0.0, 100.0), 10.0, turning_radius_m=15.0).refusals
    assert not plan(path, (0.0, 100.0), 170.0).findings


def test_a_way_that_is_too_long_is_refused(map_along: MapAlong) -> None:
    path = map_along(straight(300.0))
    assert the_finding(plan(path, max_length_m=200.0)) == "the way is 300 m long; max_length_m is 200"


def test_a_vehicle_that_is_at_home_stays_there(map_along: MapAlong) -> None:
    path = map_along(straight(300.0))
    for at_m in ((0.0, 0.0), (1.0, -3.0), (0.0, 0.2)):
        assert plan(path, at_m=at_m).refusals == ["the vehicle is at the end of the way"]


def test_more_waypoints_than_an_autopilot_stores_are_refused(map_along: MapAlong) -> None:
    along_m = np.arange(0.0, 8000.0, 2.0)
    winding = np.column_stack([20 * np.sin(along_m / 25), along_m])
    way = plan(map_along(winding), tolerance_m=0.05)
    assert any("waypoints are more than autopilots store (700)" in text for text in way.refusals)
    assert not plan(map_along(winding, name="again"), tolerance_m=1.0).refusals


def test_a_map_without_positions_is_an_error(map_along: MapAlong) -> None:
    with pytest.raises(MapError, match=r"drive 1 \(drive_0\) has 1 positions"):
        plan(map_along(np.array([[0.0, 0.0], [np.nan, np.nan], [np.nan, np.nan]])))


def test_the_antimeridian_is_no_border(map_along: MapAlong) -> None:
    way = plan(map_along(straight(300.0, 90.0, (-150.0, 0.0)), lon_shift_deg=180.0 - ORIGIN_LON_DEG))
    assert way.length_m == pytest.approx(300.0, abs=0.01)
    assert not way.findings
    assert [round(math.copysign(1, lon_deg)) for _, lon_deg in way.positions_deg] == [-1, 1]


def test_items_are_numbered_as_each_firmware_does(map_along: MapAlong) -> None:
    way = plan(map_along(straight(300.0)))
    ardupilot = mission_items(way, speed_mps=3.0)
    assert [item.command for item in ardupilot] == [16, 178, 16, 16]
    assert ardupilot[1].params[:2] == (1.0, 3.0)
    px4 = mission_items(way, altitude_m=30.0, home_first=False)
    assert [(item.lat_deg, item.lon_deg) for item in px4] == list(way.positions_deg)
    assert {item.altitude_m for item in px4} == {30.0}
