"""Metres east and north by velocity."""

from __future__ import annotations

import math

import pytest

from edge.localization.dead_reckoning import DeadReckoning

S = 1_000_000_000


def driven(*velocities: tuple[float, float, float]) -> DeadReckoning:
    displacement = DeadReckoning()
    for time_s, east_mps, north_mps in velocities:
        displacement.add(round(time_s * S), east_mps, north_mps)
    return displacement


def moved(displacement: DeadReckoning, time_s: float) -> tuple[float, float] | None:
    reckoned = displacement.at(round(time_s * S))
    return (reckoned.east_m, reckoned.north_m) if reckoned else None


def test_it_integrates_by_trapezoids_and_goes_on_with_the_last_velocity() -> None:
    displacement = driven((10, 0, 0), (11, 2, -4), (12, 2, -4))
    assert moved(displacement, 12) == pytest.approx((3, -6))
    assert moved(displacement, 11) == pytest.approx((1, -2))
    assert moved(displacement, 12.5) == pytest.approx((4, -8))


def test_it_knows_nothing_of_before_and_of_long_after() -> None:
    displacement = driven((10, 1, 0), (11, 1, 0))
    assert moved(displacement, 9.9) is None
    assert moved(displacement, 13.1) is None


def test_a_silence_begins_a_new_leg() -> None:
    displacement = driven((10, 1, 0), (11, 1, 0))
    before = displacement.at(11 * S)
    displacement.add(14 * S, 1, 0)
    after = displacement.at(14 * S)
    assert before is not None and after is not None
    assert before.leg != after.leg
    assert displacement.at(11 * S) is None


def test_damage_and_what_is_older_are_ignored() -> None:
    displacement = driven((10, 1, 0), (11, math.nan, 0), (11, 9999, 0), (10, 5, 0), (12, 1, 0))
    assert moved(displacement, 12) == pytest.approx((2, 0))
