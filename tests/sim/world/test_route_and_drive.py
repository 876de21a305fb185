from __future__ import annotations

import itertools

import numpy as np
import pytest

from sim.world.drive import ACCELERATION_MPS2, WorldDrive, plan_drive
from sim.world.route import KINDS, generate_route

ROUTE = generate_route(7, 600.0)


def drive(direction: str = "forward", **options: float) -> WorldDrive:
    return plan_drive(ROUTE, direction, seed=3, **options)  # type: ignore[arg-type]


def positions(motion: WorldDrive, step_s: float) -> np.ndarray:
    poses = [motion.pose(t) for t in np.arange(0, motion.duration_s, step_s)]
    return np.array([(pose.east_m, pose.north_m) for pose in poses])


@pytest.mark.parametrize("seed", range(20))
def test_a_route_never_comes_near_itself(seed: int) -> None:
    points = generate_route(seed, 1500.0).points_m[::10]
    apart_m = np.linalg.norm(points[:, None] - points[None], axis=-1)
    far_along = np.abs(np.subtract.outer(np.arange(len(points)), np.arange(len(points)))) > 10
    assert apart_m[far_along].min() > 30


def test_arc_length_is_meters_and_left_is_left() -> None:
    steps = [np.hypot(*np.subtract(ROUTE.at(s)[:2], ROUTE.at(s + 1)[:2])) for s in np.arange(0.0, 600.0, 7.3)]
    assert np.allclose(steps, 1.0, atol=2e-3)
    east, north, heading = ROUTE.at(100.0)
    left = np.subtract(ROUTE.at(100.0, 3.0)[:2], (east, north))
    assert np.hypot(*left) == pytest.approx(3.0)
    # Cross product of forward and left points up: left is a quarter turn against the clock.
    assert np.sin(heading) * left[1] - np.cos(heading) * left[0] == pytest.approx(3.0)


def test_districts_cover_the_route_and_neighbors_differ() -> None:
    districts = generate_route(5, 3000.0).districts
    assert districts[0].start_m == 0
    assert districts[-1].end_m >= 3000
    assert {d.kind for d in districts} == set(KINDS)
    assert all(a.end_m == b.start_m and a.kind != b.kind for a, b in itertools.pairwise(districts))


def test_a_drive_goes_from_rest_to_rest_without_jumps() -> None:
    motion = drive(stops=2)
    speeds = np.array([motion.pose(t).speed_mps for t in np.arange(0, motion.duration_s, 0.05)])
    assert motion.distance_m(0.0) == 0
    assert motion.distance_m(motion.duration_s) == 600
    assert motion.pose(motion.duration_s + 9).speed_mps == 0
    assert np.abs(np.diff(speeds)).max() <= 1.2 * ACCELERATION_MPS2 * 0.05 + 0.2
    assert np.linalg.norm(np.diff(positions(motion, 0.05), axis=0), axis=1).max() < 0.05 * 1.1 * speeds.max()


def test_speed_varies_around_the_wanted_one_and_the_drive_stops_where_it_should() -> None:
    cruise = np.array([drive(speed_mps=10.0).pose(t).speed_mps for t in np.arange(10, 45, 0.5)])
    assert cruise.min() < 9
    assert cruise.max() > 10.5
    assert cruise.max() <= 13.01
    motion = drive(stops=3)
    standing = np.diff(motion.distances_m) == 0
    halts = np.flatnonzero(standing[1:] & ~standing[:-1])
    assert len(halts) == 3
    assert standing.sum() * 0.05 > 3 * 3


def test_speed_and_heading_are_those_of_the_positions() -> None:
    motion = drive()
    for time_s in (5.0, 20.0, 33.3):
        before, after, pose = motion.pose(time_s - 0.05), motion.pose(time_s + 0.05), motion.pose(time_s)
        east, north = after.east_m - before.east_m, after.north_m - before.north_m
        assert np.hypot(east, north) / 0.1 == pytest.approx(pose.speed_mps, rel=0.05)
        off_deg = (np.degrees(np.arctan2(east, north)) - pose.heading_deg + 180) % 360 - 180
        assert abs(off_deg) < 1.5


def test_the_way_home_is_the_route_backwards_on_the_other_lane() -> None:
    out, home = drive("forward"), drive("reverse")
    assert home.route_m(0.0) == 600
    assert home.route_m(home.duration_s) == 0
    for route_m in (100.0, 300.0, 500.0):
        a = out.pose(out.time_at_s(route_m))
        b = home.pose(home.time_at_s(600.0 - route_m))
        assert (b.heading_deg - a.heading_deg) % 360 == pytest.approx(180, abs=0.5)
        to_home = np.array((b.east_m - a.east_m, b.north_m - a.north_m))
        right = np.array((np.cos(np.radians(a.heading_deg)), -np.sin(np.radians(a.heading_deg))))
        assert to_home @ right == pytest.approx(3.5, abs=0.1)  # left-hand traffic: home is on the right


def test_a_shaking_car_lifts_its_nose_when_it_pulls_away_and_drives_where_a_stiff_one_does() -> None:
    stiff, shaking = drive(), drive(shaking=1.0)
    poses = [(stiff.pose(t), shaking.pose(t)) for t in np.arange(0.0, stiff.duration_s, 0.1)]
    assert all((a.east_m, a.north_m, a.heading_deg) == (b.east_m, b.north_m, b.heading_deg) for a, b in poses)
    assert {(a.pitch_deg, a.roll_deg) for a, _ in poses} == {(0.0, 0.0)}
    pulling = np.mean([b.pitch_deg for _, b in poses[10:50]])
    braking = np.mean([b.pitch_deg for _, b in poses[-50:-10]])
    assert pulling > 0.4 and braking < -0.4
    assert 0.1 < np.std([b.roll_deg for _, b in poses]) < 0.6
