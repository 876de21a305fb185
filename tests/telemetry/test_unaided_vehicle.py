"""A vehicle whose velocity nothing measures: it moves by its wheels, or by that velocity less what it is wrong by."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import common as mavlink

from edge.telemetry.vehicle import Vehicle
from edge.telemetry.vehicle_motion import STAYS
from tests.telemetry.speaker import S, Speaker, connect


def unaided(speaker: Speaker) -> Vehicle:
    """Drives north at 10 m/s for 2 s; from then on nothing measures its velocity."""
    vehicle = connect(speaker)
    for tenth in range(20, 41):
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=10.0, ve_mps=0.0), tenth * S // 10)
    vehicle.is_aided = False
    return vehicle


def run_away(
    vehicle: Vehicle, speaker: Speaker, error_mps: tuple[float, float] | None, *, wheels_mps: float | None = None
) -> None:
    """From 4.1 s to 8 s its filter goes north and ever faster west; error_mps: what is found of it, east and north."""
    for tenth in range(41, 81):
        now_ns = tenth * S // 10
        if error_mps is not None:
            vehicle.use_velocity_error(error_mps, 1.6, now_ns)
        if wheels_mps is not None:
            message = mavlink.MAVLink_wheel_distance_message(tenth * 100_000, 1, [wheels_mps * tenth / 10] + [0.0] * 15)
            vehicle.handle(speaker.say(message), now_ns)
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=12.0, ve_mps=-float(tenth)), now_ns)


def moved_m(vehicle: Vehicle, first_ns: int, last_ns: int) -> tuple[float, float]:
    first, last = vehicle.displacement(first_ns), vehicle.displacement(last_ns)
    assert first is not None and last is not None and first.leg == last.leg
    return last.east_m - first.east_m, last.north_m - first.north_m


def test_a_velocity_that_nothing_measures_counts_ahead_and_without_the_error_that_was_found() -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    run_away(vehicle, speaker, (3.0, 4.0))
    assert vehicle.motion(8 * S, 8 * S).velocity_mps == (-80.0, 12.0)
    east_m, north_m = moved_m(vehicle, 5 * S, 8 * S)
    assert east_m == pytest.approx(0.0, abs=1e-9)
    assert north_m == pytest.approx(24.0, abs=0.1)
    assert vehicle.speed_mps(8 * S) == pytest.approx(8.0)
    assert vehicle.driven_m(8 * S) == pytest.approx(20.0 + 32.0, abs=0.5)
    assert not vehicle.motion(8 * S, 8 * S).is_measured
    moved = vehicle.displacement(8 * S)
    assert moved is not None and moved.drift == pytest.approx(STAYS * 1.6 / 8.0)


def test_wheels_come_before_a_velocity_that_nothing_measures() -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    run_away(vehicle, speaker, (3.0, 4.0), wheels_mps=9.0)
    east_m, north_m = moved_m(vehicle, 5 * S, 8 * S)
    assert east_m == pytest.approx(0.0, abs=1e-9)
    assert north_m == pytest.approx(27.0, abs=0.1)
    assert vehicle.motion(8 * S, 8 * S).is_measured
    first_m, last_m = vehicle.distance_m(6 * S), vehicle.distance_m(8 * S)
    assert first_m is not None and last_m is not None
    assert last_m - first_m == pytest.approx(18.0, abs=0.1)
    moved = vehicle.displacement(8 * S)
    assert moved is not None and moved.drift == 0.0


def test_so_does_the_camera_where_there_are_no_wheels_until_a_second_after_it_is_silent() -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    for tenth in range(41, 81):
        vehicle.use_speed(tenth * S // 10 - S // 20, 9.0)
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=12.0, ve_mps=-float(tenth)), tenth * S // 10)
    assert moved_m(vehicle, 5 * S, 8 * S) == pytest.approx((0.0, 27.0), abs=0.1)
    assert vehicle.motion(8 * S, 8 * S).is_measured
    first_m, last_m = vehicle.distance_m(6 * S), vehicle.distance_m(8 * S)
    assert first_m is not None and last_m is not None and last_m - first_m == pytest.approx(18.0, abs=0.1)
    assert not vehicle.motion(9 * S, 9 * S).is_measured
    run_away(vehicle, speaker, None, wheels_mps=5.0)
    vehicle.use_speed(8 * S + 1, 9.0)
    assert vehicle.speed_mps(8 * S + 1) == pytest.approx(5.0), "wheels slip less often than a road is misread"


def test_the_camera_counts_not_where_the_autopilot_measures_its_speed() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    for tenth in range(20, 41):
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=10.0, ve_mps=0.0), tenth * S // 10)
        vehicle.use_speed(tenth * S // 10 + 1, 3.0)
    assert vehicle.speed_mps(4 * S) == pytest.approx(10.0)


def test_how_far_positions_of_ours_were_counts_for_a_second() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    vehicle.expect_pull(20.0, 3 * S)
    vehicle.expect_pull(2.0, 3 * S + S // 2)
    assert [vehicle.motion(0, 3 * S + tenth * S // 10).pulled_m for tenth in (0, 6, 10, 11, 16)] == [20, 20, 20, 2, 0]


def test_where_nothing_was_found_of_such_a_velocity_the_motion_is_not_known() -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    run_away(vehicle, speaker, None)
    assert vehicle.displacement(8 * S) is None
    assert vehicle.speed_mps(8 * S) is None
    assert vehicle.distance_m(8 * S) is None


def test_nor_where_that_is_too_uncertain_or_too_old() -> None:
    speaker = Speaker()
    vehicle = unaided(speaker)
    run_away(vehicle, speaker, (3.0, 4.0))
    vehicle.use_velocity_error((3.0, 4.0), 4.1, 8 * S)
    assert vehicle.displacement(8 * S) is None
    vehicle.use_velocity_error((3.0, 4.0), 1.6, 8 * S)
    assert vehicle.displacement(8 * S) is not None
    for tenth in range(81, 181):
        vehicle.handle(speaker.fix(100 * tenth, float(tenth), vn_mps=0.0, ve_mps=-9.0), tenth * S // 10)
    assert vehicle.speed_mps(18 * S) is None
    assert vehicle.displacement(18 * S) is None
