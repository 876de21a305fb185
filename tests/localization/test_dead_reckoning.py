"""Meters driven from speeds that come late, twice, or not at all; meters east and north by velocity."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.localization import DeadReckoning
from edge.localization.dead_reckoning import DOUBTED_M, TURN_FRAMES, Odometry, TurnAround
from tests.common import S

GOOD, POOR = 0, 2


def test_a_poorer_source_counts_only_when_the_better_one_is_silent() -> None:
    motion = DeadReckoning()
    for tenth in range(51):
        motion.add_speed(tenth * S // 10, 10.0, GOOD)
        motion.add_speed(tenth * S // 10 + S // 20, 30.0, POOR)
    assert motion.distance_m(5 * S) == pytest.approx(50.0)
    for tenth in range(51, 100):
        motion.add_speed(tenth * S // 10, 30.0, POOR)
    assert motion.speed_mps(10 * S) == 30.0


def test_a_long_silence_adds_no_distance_of_its_own() -> None:
    motion = DeadReckoning()
    motion.add_speed(0, 10.0, GOOD)
    motion.add_speed(1 * S, 10.0, GOOD)
    motion.add_speed(31 * S, 10.0, GOOD)
    motion.add_speed(32 * S, 10.0, GOOD)
    assert motion.distance_m(32 * S) == pytest.approx(20.0)
    assert motion.speed_mps(34 * S) is None


def test_a_day_of_reports_is_counted_and_not_kept() -> None:
    motion = DeadReckoning()
    for tenth in range(20_000):
        motion.add_speed(tenth * S // 10, 5.0, GOOD)
    assert motion.distance_m(1999 * S) == pytest.approx(5.0 * 1999)
    assert motion.distance_m(10 * S) is None, "forgotten"


@pytest.mark.parametrize("speed_mps", [math.nan, math.inf, -1e30, 1e30])
def test_a_speed_that_is_none_is_ignored(speed_mps: float) -> None:
    motion = DeadReckoning()
    motion.add_speed(1_000_000_000, 10.0, source=0)
    motion.add_speed(1_500_000_000, speed_mps, source=0)
    motion.add_speed(2_000_000_000, 10.0, source=0)
    assert motion.distance_m(2_000_000_000) == pytest.approx(10.0)
    assert motion.speed_mps(2_000_000_000) == 10.0


def driven(*velocities: tuple[float, float, float]) -> DeadReckoning:
    motion = DeadReckoning()
    for time_s, east_mps, north_mps in velocities:
        motion.add_velocity(round(time_s * S), east_mps, north_mps)
    return motion


def moved(motion: DeadReckoning, time_s: float) -> tuple[float, float] | None:
    found = motion.displacement(round(time_s * S))
    return (found.east_m, found.north_m) if found else None


def test_a_silence_begins_a_new_leg() -> None:
    motion = driven((10, 1, 0), (11, 1, 0))
    before = motion.displacement(11 * S)
    motion.add_velocity(14 * S, 1, 0)
    after = motion.displacement(14 * S)
    assert before is not None and after is not None
    assert before.odometry_epoch != after.odometry_epoch
    assert (after.east_m, after.unknown_since(before)) == pytest.approx((before.east_m + 3, 6)), "or 2 m/s, unheard"
    assert motion.displacement(11 * S) is None


def test_damage_and_what_is_older_are_ignored() -> None:
    motion = driven((10, 1, 0), (11, math.nan, 0), (11, 9999, 0), (10, 5, 0), (12, 1, 0))
    assert moved(motion, 12) == pytest.approx((2, 0))


def test_a_silence_in_which_the_vehicle_may_have_moved_is_counted() -> None:
    motion = DeadReckoning()
    for second in (0, 1, 2, 10, 11, 40):
        motion.add_speed(second * 10**9, 5.0, source=0)
    assert motion.gaps == 2
    assert motion.distance_m(40 * 10**9) == pytest.approx(15.0)  # of the three seconds that are known


def test_a_vehicle_goes_on_while_its_autopilot_reboots() -> None:
    """It is silent for 2.7 s, in which a line of frames must not lose what was driven."""
    motion = DeadReckoning()
    for second in (0.0, 1.0, 3.7, 4.7):
        motion.add_speed(round(second * 1e9), 5.0, source=0)
    assert motion.gaps == 0
    assert motion.distance_m(round(4.7e9)) == pytest.approx(5.0 * 4.7)


def test_going_back_is_no_distance() -> None:
    """Places are not sampled again on the way back and forth, but after more than 100 m nobody waits for them.

    The same where somebody asks for later moments in between, as a map that grows and a second camera do.
    """
    motion, apart_ns = DeadReckoning(), 100_000_000
    at_m: list[float] = []
    speeds_mps = [[10.0] * 5, [-2.0] * 5, [10.0] * 5, [-10.0] * 20, [10.0] * 12]
    for report, speed_mps in enumerate(np.repeat(np.concatenate(speeds_mps), 10).tolist()):
        motion.add_speed(report * apart_ns, speed_mps, source=0)
        now_m, before_m = (motion.distance_m(at_ns) for at_ns in (report * apart_ns, (2 * report - 1) * apart_ns // 2))
        assert now_m is not None
        assert before_m is None or before_m <= now_m + 0.01
        assert before_m is None or before_m >= max(at_m, default=0.0) - 0.01
        at_m.append(now_m)
    assert at_m[50:110] == pytest.approx(np.full(60, 50.0), abs=1.0), "10 m back, and forward again"
    assert at_m[150:350] == pytest.approx(np.full(200, at_m[150]), abs=1.0)
    assert at_m[149] == pytest.approx(90.0, abs=1.0)
    assert motion.gaps == 1, "the places of the 200 m are not those of the way before"
    assert at_m[-1] == pytest.approx(90.0 + 120.0 - 100.0, abs=1.0), "200 m back, and forward again"
    assert motion.total_m == pytest.approx(50 + 10 + 50 + 200 + 120, abs=2.0)


@pytest.mark.parametrize(("turn_deg", "around"), [(0, 0), (90, 0), (180, 1), (-180, 1)])
def test_turning_around_is_noticed_once(turn_deg: float, around: int) -> None:
    """2 m a frame, straight, a turn of eight frames, and straight on."""
    turning, noticed, east_m, north_m = TurnAround(), 0, 0.0, 0.0
    for frame in range(4 * TURN_FRAMES):
        share = min(max((frame - 2 * TURN_FRAMES) / 8, 0.0), 1.0)
        heading_rad = math.radians(turn_deg * share)
        east_m, north_m = east_m + 2 * math.sin(heading_rad), north_m + 2 * math.cos(heading_rad)
        noticed += turning.add(Odometry(1, east_m, north_m))
    assert noticed == around


def test_the_course_is_that_of_the_newest_frames() -> None:
    """North, then east; none where the displacement is unknown, begins again, or hardly grows."""
    turning, third = TurnAround(), TURN_FRAMES // 3
    for frame in range(2 * third):
        assert (turning.course_rad is None) == (frame < third)
        turning.add(Odometry(1, max(0.0, frame - third) * 2.0, min(frame, third) * 2.0))
    assert turning.course_rad == pytest.approx(math.pi / 2)
    turning.add(Odometry(2, 0.0, 0.0))
    assert turning.course_rad is None
    for _ in range(third):
        turning.add(Odometry(2, 0.0, 0.0))
    assert turning.course_rad is None


def test_another_leg_is_no_turn() -> None:
    turning = TurnAround()
    for leg, sign in ((1, 1), (2, -1)):
        assert not any(turning.add(Odometry(leg, 0.0, sign * 2.0 * frame)) for frame in range(TURN_FRAMES - 1))
    assert not turning.add(None)


@pytest.mark.parametrize(
    ("faster_mps", "within_s", "doubtful_m"),
    [(4.0, 0.1, 12.0), (4.0, 0.2, 12.0), (4.0, 1.0, 0.0), (-4.0, 0.1, -12.0)],
    ids=["wheels that spin", "seen in two reports", "a vehicle that accelerates", "wheels that lock"],
)
def test_a_change_of_the_velocity_that_no_vehicle_makes_is_doubtful_until_it_is_taken_back(
    faster_mps: float, within_s: float, doubtful_m: float
) -> None:
    motion = DeadReckoning()
    for tenth in range(100):
        faster = min(max(0.0, (tenth / 10 - 2.0) / within_s), 1.0, max(0.0, (5.0 + within_s - tenth / 10) / within_s))
        motion.add_velocity(tenth * S // 10, 0.0, 8.0 + faster * faster_mps)
    moved = motion.displacement(99 * S // 10)
    assert moved is not None
    assert moved.north_m == pytest.approx(8.0 * 9.9 + 3.0 * faster_mps, abs=0.1)
    assert moved.doubtful_north_m == pytest.approx(doubtful_m, abs=0.5)


def test_wheels_that_spin_in_a_bend_are_doubtful_in_the_directions_that_were_driven() -> None:
    """They lose their hold slowly heading north, and find it fast heading east: no doubt remains that points back."""
    motion = DeadReckoning()
    spun_m = [0.0, 0.0]
    for tenth in range(150):
        turned = min(max(0.0, tenth / 10 - 2.0) / 3.0, 1.0)
        speed_mps, heading_rad, spins = 3.0 + 5.0 * turned, math.radians(90) * turned, 20 <= tenth < 50
        mps = (1.5 if spins else 1.0) * speed_mps
        motion.add_velocity(tenth * S // 10, mps * math.sin(heading_rad), mps * math.cos(heading_rad))
        spun_m[0] += (mps - speed_mps) * math.sin(heading_rad) / 10
        spun_m[1] += (mps - speed_mps) * math.cos(heading_rad) / 10
    moved = motion.displacement(149 * S // 10)
    assert moved is not None
    assert (moved.doubtful_east_m, moved.doubtful_north_m) == pytest.approx(spun_m, abs=0.5)


def test_a_velocity_that_stays_changed_is_doubtful_for_60_m() -> None:
    motion = DeadReckoning()
    for tenth in range(300):
        motion.add_velocity(tenth * S // 10, 0.0, 8.0 if tenth < 20 else 12.0)
    moved = motion.displacement(299 * S // 10)
    assert moved is not None
    assert moved.doubtful_north_m == pytest.approx(DOUBTED_M / 3, abs=1.0), "4 of 12 m/s"


def test_a_velocity_by_rounded_positions_is_not_in_doubt() -> None:
    """Positions of a real autopilot, 16 ms apart and rounded to a centimeter; the velocity that it reports is even."""
    doubtful_m = []
    for reported in (True, False):
        motion = DeadReckoning()
        for number in range(50):
            motion.add_velocity(number * 16_000_000, 8.0 + 0.7 * (number % 2), 0.0, (8.0, 0.0) if reported else None)
        found = motion.displacement(49 * 16_000_000)
        assert found is not None
        doubtful_m.append(found.doubtful_east_m)
    assert doubtful_m[0] == 0 and doubtful_m[1] != 0
