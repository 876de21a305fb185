"""A vehicle whose autopilot has no velocity that anything measures: it moves by its wheels or its camera, or not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.vehicle import Vehicle
from edge.telemetry.vehicle_velocity import Aid
from tests.common import S
from tests.telemetry.speaker import Speaker, connect


def unaided(speaker: Speaker) -> Vehicle:
    """Drives north at 10 m/s for 2 s; from then on nothing measures its velocity."""
    vehicle = connect(speaker)
    for tenth in range(20, 41):
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=10.0, ve_mps=0.0), tenth * S // 10)
    vehicle.velocity.aid = Aid(is_any=False)
    return vehicle


def run_away(vehicle: Vehicle, speaker: Speaker, *, wheels_mps: float | None = None) -> None:
    """From 4.1 s to 8 s its filter goes north and ever faster west."""
    for tenth in range(41, 81):
        now_ns = tenth * S // 10
        if wheels_mps is not None:
            message = mavlink.MAVLink_wheel_distance_message(tenth * 100_000, 1, [wheels_mps * tenth / 10] + [0.0] * 15)
            vehicle.handle(speaker.say(message), now_ns)
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=12.0, ve_mps=-float(tenth)), now_ns)


def moved_m(vehicle: Vehicle, first_ns: int, last_ns: int) -> tuple[float, float]:
    first, last = vehicle.motion.displacement(first_ns), vehicle.motion.displacement(last_ns)
    assert first is not None and last is not None and first.odometry_epoch == last.odometry_epoch
    return last.east_m - first.east_m, last.north_m - first.north_m


def driven_m(vehicle: Vehicle, first_ns: int, last_ns: int) -> float:
    first_m, last_m = vehicle.motion.distance_m(first_ns), vehicle.motion.distance_m(last_ns)
    assert first_m is not None and last_m is not None
    return last_m - first_m


def test_a_velocity_that_nothing_measures_counts_for_nothing() -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    run_away(vehicle, speaker)
    assert vehicle.motion.displacement(8 * S) is None
    assert vehicle.motion.speed_mps(8 * S) is None
    assert vehicle.motion.distance_m(8 * S) is None


def test_wheels_measure_it_along_the_heading() -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    run_away(vehicle, speaker, wheels_mps=9.0)
    assert moved_m(vehicle, 5 * S, 8 * S) == pytest.approx((0.0, 27.0), abs=0.1)
    assert driven_m(vehicle, 6 * S, 8 * S) == pytest.approx(18.0, abs=0.1)


@pytest.mark.parametrize(("apart_s", "is_known"), [(2, True), (3, False)])
def test_wheels_that_pause_for_long_say_no_speed(apart_s: int, is_known: bool) -> None:
    """Meanwhile a counter may have begun anew."""
    speaker = Speaker()
    vehicle = unaided(speaker)
    for now_s in (5, 5 + apart_s):
        message = mavlink.MAVLink_wheel_distance_message(now_s * 1_000_000, 1, [9.0 * now_s] + [0.0] * 15)
        vehicle.handle(speaker.say(message), now_s * S)
    assert (vehicle.motion.speed_mps((5 + apart_s) * S) is not None) == is_known


def test_wheels_that_reported_before_the_link_was_lost_say_nothing_afterwards() -> None:
    """Another vehicle may be on the port."""
    speaker = Speaker()
    vehicle = unaided(speaker)
    run_away(vehicle, speaker, wheels_mps=9.0)
    vehicle.reset_link()
    for tenth in range(81, 110):
        if tenth in (82, 92):
            vehicle.handle(speaker.heartbeat(), tenth * S // 10)
        vehicle.velocity.aid = Aid(is_any=False)
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=12.0, ve_mps=0.0), tenth * S // 10)
    assert vehicle.session.number == 2
    assert vehicle.motion.displacement(tenth * S // 10) is None


def test_so_does_the_camera_where_there_are_no_wheels_until_it_is_silent() -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    for tenth in range(41, 81):
        vehicle.velocity.use_speed(tenth * S // 10 - S // 20, 9.0)
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=12.0, ve_mps=-float(tenth)), tenth * S // 10)
    assert moved_m(vehicle, 5 * S, 8 * S) == pytest.approx((0.0, 27.0), abs=0.1)
    assert driven_m(vehicle, 6 * S, 8 * S) == pytest.approx(18.0, abs=0.1)
    for tenth in range(81, 111):
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=12.0, ve_mps=-float(tenth)), tenth * S // 10)
    assert vehicle.motion.distance_m(11 * S) is None and vehicle.motion.displacement(11 * S) is None


def test_a_hole_in_the_cameras_speed_is_bridged_by_how_the_autopilots_own_changes() -> None:
    """For 10 s; by then it may be off by 25 m, and nothing began anew."""
    speaker = Speaker()
    vehicle = unaided(speaker)
    vehicle.velocity.aid = Aid(is_drifting_camera=True)
    for tenth in range(41, 191):
        now_ns = tenth * S // 10
        if tenth <= 80:
            vehicle.velocity.use_speed(now_ns, 9.0)
        north_mps = 12.0 if tenth <= 100 else 10.0  # the filter is 3 m/s off, and brakes by 2
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=north_mps, ve_mps=0.0), now_ns)
        known = vehicle.motion.displacement(now_ns) is not None, vehicle.motion.speed_mps(now_ns) is not None
        assert known == (True, True) or tenth > 180
    assert moved_m(vehicle, 8 * S, 10 * S) == pytest.approx((0.0, 18.0), abs=0.1)
    assert moved_m(vehicle, 11 * S, 18 * S) == pytest.approx((0.0, 49.0), abs=0.1)
    assert driven_m(vehicle, 11 * S, 18 * S) == pytest.approx(49.0, abs=0.1)
    unknown_m = [one.unknown_m for at_s in (8, 13, 18) if (one := vehicle.motion.displacement(at_s * S))]
    assert np.diff(unknown_m) == pytest.approx([0.25 * 5**2, 0.25 * (10**2 - 5**2)], abs=0.5)
    for tenth in range(191, 221):
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=10.0, ve_mps=0.0), tenth * S // 10)
    assert vehicle.motion.displacement(22 * S) is None and vehicle.motion.speed_mps(22 * S) is None


@pytest.mark.parametrize(("wheels", "doubtful"), [(True, True), (False, False)])
def test_wheels_may_slip_but_a_camera_that_saw_nothing_has_missed_a_braking(wheels: bool, doubtful: bool) -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    turned_m = 0.0
    for tenth in range(41, 81):
        mps, now_ns = (9.0 if tenth < 60 else 5.0), tenth * S // 10
        turned_m += mps / 10
        if wheels:
            message = mavlink.MAVLink_wheel_distance_message(tenth * 100_000, 1, [turned_m] + [0.0] * 15)
            vehicle.handle(speaker.say(message), now_ns)
        else:
            vehicle.velocity.use_speed(now_ns - S // 20, mps)
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=12.0, ve_mps=0.0), now_ns)
    moved = vehicle.motion.displacement(8 * S)
    assert moved is not None and (moved.doubtful_north_m != 0) == doubtful


def test_wheels_count_before_the_camera() -> None:
    """They slip less often than a road is misread."""
    speaker = Speaker()
    vehicle = unaided(speaker)
    run_away(vehicle, speaker, wheels_mps=5.0)
    vehicle.velocity.use_speed(8 * S + 1, 9.0)
    assert vehicle.motion.speed_mps(8 * S + 1) == pytest.approx(5.0)


def test_the_camera_counts_not_where_the_autopilot_measures_its_speed() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    for tenth in range(20, 41):
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=10.0, ve_mps=0.0), tenth * S // 10)
        vehicle.velocity.use_speed(tenth * S // 10 + 1, 3.0)
    assert vehicle.motion.speed_mps(4 * S) == pytest.approx(10.0)


def test_how_far_the_body_turned_between_two_pictures_but_not_over_a_silence() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)

    def turn(first: int, end: int, up_radps: float = 0.2, right_radps: float = -0.5) -> None:
        for ms in range(first, end, 20):
            message = mavlink.MAVLink_attitude_message(ms, 0.0, 0.0, 3.1, 0.0, up_radps, right_radps)
            vehicle.handle(speaker.say(message), ms * S // 1000)

    turn(1000, 1400)
    assert vehicle.velocity.turned_rad(11 * S // 10, 12 * S // 10) == pytest.approx((0.02, -0.05))
    turn(1800, 2000)
    assert vehicle.velocity.turned_rad(19 * S // 10, 2 * S + S // 20) == pytest.approx((0.03, -0.075)), (
        "as it turned last"
    )
    assert vehicle.velocity.turned_rad(13 * S // 10, 19 * S // 10) is None
    assert vehicle.velocity.turned_rad(19 * S // 10, 22 * S // 10) is None
    turn(2000, 2020, math.nan, 1e9)
    assert vehicle.velocity.turned_rad(19 * S // 10, 2 * S + S // 20) == pytest.approx((0.03, -0.075))
