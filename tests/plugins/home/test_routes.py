"""Routes through places of a map: along a drive either way, from one onto another, around a loop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.config import RigConfig
from edge.errors import ConfigError, MapError
from edge.reference_map import open_map_set
from edge_plugins.home import HomeConfig
from edge_plugins.home.checks import BRIEF
from edge_plugins.home.route import RoutePlan, RouteStart, plan_route
from sim import geodetic
from tests.plugins.home.test_way_home import arc, away_m, joined, straight, waypoints_m

MapAlong = Callable[..., Path]
CROSSING = straight(200.0), straight(200.0, 90.0, (-100.0, 121.0))


def plan(path: Path, *places: str, start: RouteStart | None = None, **config: Any) -> RoutePlan:
    rig = RigConfig(left_forward_m=2.0, left_reverse_m=3.0) if config.pop("beside", False) else RigConfig()
    return plan_route(open_map_set(path), start, HomeConfig(**config), rig, places=places)


@pytest.mark.parametrize(("places", "ends_m"), [(("1:40", "1:200"), (40, 200)), (("1:end", "1:60"), (300, 60))])
def test_a_drive_is_driven_again_either_way(map_along: MapAlong, places: tuple[str, str], ends_m: Any) -> None:
    path = map_along(straight(300.0))
    way = plan(path, *places)
    assert waypoints_m(way) == pytest.approx(np.array([(0, ends_m[0]), (0, ends_m[1])]), abs=0.01)
    assert not way.findings
    assert plan(path, places[0], "1:100", places[1]).along_m == way.along_m
    assert way.words == f"{'back ' * (ends_m[0] > ends_m[1])}along drive 1 (drive_0)"


def test_home_is_the_route_back_to_the_start(map_along: MapAlong) -> None:
    path = map_along(joined(straight(60.0), arc(20.0, 90), straight(60.0, -90.0)))
    assert plan(path) == plan(path, "1:end", "1:0")


@pytest.mark.parametrize(("to", "end_m"), [("2:end", 100.0), ("2:0", -100.0)])
def test_where_drives_cross_it_goes_on_along_the_other(map_along: MapAlong, to: str, end_m: float) -> None:
    way = plan(map_along(*CROSSING), "1:0", to)
    assert waypoints_m(way)[[0, -1]] == pytest.approx(np.array([(0, 0), (end_m, 121)]), abs=0.01)
    assert away_m(np.array([(0.0, 121.0)]), waypoints_m(way))[0] < 3.0, "it does not cut the corner"
    (change,) = way.findings
    assert str(change).startswith("warning: from 1")
    assert "from drive 1 (drive_0) onto drive 2 (drive_1), which no drive shows" in change.text


@pytest.mark.parametrize("beside_m", [0.5, 2.0, 5.0])
def test_onto_a_drive_of_the_same_road_it_changes_gently(map_along: MapAlong, beside_m: float) -> None:
    """GPS was wrong by that much between both; the second goes the other way."""
    path = map_along(straight(200.0), straight(200.0, 180.0, (beside_m, 260.0)))
    way = plan(path, "1:0", "2:0")
    assert not way.refusals
    line_m = waypoints_m(way)
    legs_deg = np.degrees(np.arctan2(*np.diff(line_m, axis=0).T))
    assert np.abs(legs_deg).max() < 30.0
    assert line_m[-1] == pytest.approx((beside_m, 260.0), abs=0.01)
    assert way.words.endswith("and back along drive 2 (drive_1)")


def test_three_drives_make_a_round_that_begins_and_ends_at_one_place(map_along: MapAlong) -> None:
    corners = np.array([(0.0, 0.0), (0.0, 150.0), (150.0, 150.0), (150.0, 0.0)])
    sides = [straight(150.0, course, tuple(at)) for course, at in zip((0.0, 90.0, 180.0, 270.0), corners, strict=True)]
    way = plan(map_along(*sides), "1:0", "2:75", "3:75", "4:end", turning_radius_m=3.0)
    assert not way.refusals
    assert way.length_m == pytest.approx(600.0, abs=10.0)
    assert waypoints_m(way)[[0, -1]] == pytest.approx(np.zeros((2, 2)), abs=0.01)


def test_a_loop_is_driven_around_from_where_it_began(map_along: MapAlong) -> None:
    path = map_along(arc(40.0, 360))
    way = plan(path, "1:0", "1:end", start=RouteStart(*geodetic(0.5, 1.0), 0.0, 1.5))
    assert not way.findings
    assert way.length_m == pytest.approx(250.0, abs=4.0)
    assert plan(path, "1:0", "1:end", start=RouteStart(*geodetic(-80.0, 0.0))).refusals == [
        "the vehicle is 80 m from where the way begins; max_start_m is 20"
    ]


def test_out_and_back_needs_a_turn_that_a_person_drives(map_along: MapAlong) -> None:
    (refusal,) = plan(map_along(straight(200.0)), "1:0", "1:end", "1:0", turning_radius_m=0.0).refusals
    assert refusal == "at 200 m: a turn of 180 degrees on the spot: drive past it and ask again, or end the way there"


def test_the_lane_is_that_of_each_direction(map_along: MapAlong) -> None:
    path = map_along(straight(200.0), straight(200.0, 180.0, (1.0, 260.0)))
    way = plan(path, "1:0", "2:0", beside=True)
    assert waypoints_m(way)[[0, -1]] == pytest.approx(np.array([(-2.0, 0.0), (-2.0, 260.0)]), abs=0.01)


def test_drives_at_different_heights_do_not_meet(map_along: MapAlong) -> None:
    path = map_along(*CROSSING)
    assert not plan(path, "1:0", "2:0").refusals
    bridge = map_along(*CROSSING, alt_m=lambda row: 6.0 if 45 < row < 56 else 0.0, name="bridge")
    with pytest.raises(MapError, match=r"drive 1 \(drive_0\) does not come within 8 m of drive 2 \(drive_1\)"):
        plan(bridge, "1:0", "2:0")


def test_a_road_that_leads_back_beside_the_one_that_it_came_on_is_not_turned_onto(map_along: MapAlong) -> None:
    path = map_along(straight(200.0), straight(100.0, 210.0, (-1.0, 200.0)))
    with pytest.raises(MapError, match="does not come within 8 m of drive 2 \\(drive_1\\) as it is driven"):
        plan(path, "1:0", "2:end")
    assert not plan(path, "1:end", "2:end").refusals, "from there on, it may turn as it likes"


def test_gps_that_was_spoofed_on_a_part_refuses_the_routes_over_it(map_along: MapAlong) -> None:
    drive = straight(300.0)
    drive[75:] += (0.0, 15.0)
    path = map_along(drive, driven_m=[np.arange(151) * 2.0])
    assert not plan(path, "1:0", "1:140").refusals
    assert plan(path, "1:120", "1:200").refusals == [
        "from 28 m to 45 m: the GPS position moved 17 m where the vehicle drove 2 m"
    ]
    assert "the GPS position moved" in plan(path, "1:200", "1:290").refusals[0], "it begins where GPS was off already"
    drive[75:] = straight(300.0)[75:]
    drive[20:23] += (0.0, 15.0)
    assert not plan(map_along(drive, driven_m=[np.arange(151) * 2.0], name="before"), "1:100", "1:200").refusals


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("3:0", "3:0: no DRIVE:METERS, DRIVE:end or LAT,LON; drives: 1, 2"),
        ("1:far", "1:far: no DRIVE:METERS"),
        ("1:nan", "1:nan: drive 1"),
        ("home", "home: no DRIVE:METERS"),
        ("1:201", "is 200 m long"),
        ("1:0", "1:0 1:0: all of it is one place"),
        ("91,0", "91,0: no DRIVE"),
        (",".join(map(str, geodetic(50.0, 50.0))), "50 m from the nearest drive; max_start_m is 20"),
    ],
)
def test_a_place_that_is_none_is_one_line(map_along: MapAlong, place: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        plan(map_along(*CROSSING), "1:0", place)


def test_a_position_is_a_place_of_the_nearest_drive(map_along: MapAlong) -> None:
    path = map_along(*CROSSING)
    places = [",".join(map(str, geodetic(*at_m))) for at_m in ((1.0, 20.0), (80.0, 123.0))]
    assert plan(path, *places) == plan(path, "1:20", "2:180")


def test_what_a_pilot_reads_of_a_finding_is_one_line(map_along: MapAlong) -> None:
    drive = joined(straight(9_000.0), arc(2.0, 180), straight(40.0, 180.0), straight(8_000.0, 90.0))
    drive[3000:3040] = np.nan
    path = map_along(drive, straight(30.0), sigma_m=lambda row: 8.0 if row > 7000 else 2.0)
    findings = [
        *plan(path, "1:0", "1:end", start=RouteStart(*geodetic(900.0, 0.0), 170.0, 90.0), max_length_m=10.0).findings,
        *plan(path, "2:0", "2:4").findings,
        *plan(path, "1:0", "2:end", tolerance_m=0.05).findings,
    ]
    assert len({finding.brief.lstrip("0123456789 ")[:9] for finding in findings}) >= 8
    assert not [finding for finding in findings if not 0 < len(finding.brief) <= BRIEF]
