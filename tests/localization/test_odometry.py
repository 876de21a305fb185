"""Metres driven, from speeds that come late, twice, or not at all."""

from __future__ import annotations

import math

import pytest

from edge.localization.odometry import Odometer

S = 1_000_000_000
GOOD, POOR = 0, 2


def test_a_poorer_source_counts_only_when_the_better_one_is_silent() -> None:
    odometer = Odometer()
    for tenth in range(51):
        odometer.add(tenth * S // 10, 10.0, GOOD)
        odometer.add(tenth * S // 10 + S // 20, 30.0, POOR)
    assert odometer.distance_m(5 * S) == pytest.approx(50.0)
    for tenth in range(51, 100):
        odometer.add(tenth * S // 10, 30.0, POOR)
    assert odometer.speed_mps(10 * S) == 30.0


def test_a_long_silence_adds_no_distance_of_its_own() -> None:
    odometer = Odometer()
    odometer.add(0, 10.0, GOOD)
    odometer.add(1 * S, 10.0, GOOD)
    odometer.add(31 * S, 10.0, GOOD)
    odometer.add(32 * S, 10.0, GOOD)
    assert odometer.distance_m(32 * S) == pytest.approx(20.0)
    assert odometer.speed_mps(34 * S) is None


def test_reports_that_come_twice_or_in_the_wrong_order_are_ignored() -> None:
    odometer = Odometer()
    for stamp_s in (0, 1, 2, 2, 1, 3):
        odometer.add(stamp_s * S, 10.0, GOOD)
    odometer.add(1 * S, 500.0, GOOD)
    odometer.add(3 * S, 500.0, GOOD)
    assert odometer.distance_m(3 * S) == pytest.approx(30.0)
    assert odometer.distance_m(3 * S + S // 2) == pytest.approx(35.0)


def test_a_day_of_reports_is_counted_and_not_kept() -> None:
    odometer = Odometer()
    for tenth in range(20_000):
        odometer.add(tenth * S // 10, 5.0, GOOD)
    assert odometer.distance_m(1999 * S) == pytest.approx(5.0 * 1999)
    assert odometer.distance_m(10 * S) is None, "forgotten"


@pytest.mark.parametrize("speed_mps", [math.nan, math.inf, -1.0, 1e30])
def test_a_speed_that_is_none_is_left_out(speed_mps: float) -> None:
    odometer = Odometer()
    odometer.add(1_000_000_000, 10.0, source=0)
    odometer.add(1_500_000_000, speed_mps, source=0)
    odometer.add(2_000_000_000, 10.0, source=0)
    assert odometer.distance_m(2_000_000_000) == pytest.approx(10.0)
    assert odometer.speed_mps(2_000_000_000) == 10.0
