"""The autopilot's heading against that by gyros, and when it is known."""

from __future__ import annotations

import math

import pytest

from edge.localization.dead_reckoning import REPORTS_APART_NS
from edge.localization.gyro_heading import GyroHeading
from tests.common import S


def test_the_autopilots_heading_only_begins_it() -> None:
    """The autopilot turns its heading afterwards, as one that follows a GPS that is spoofed: that turns nothing."""
    own = GyroHeading()
    for step in range(200):
        follows_rad = 0.05 * step / 10 - 0.15 * min(1.0, step / 100)
        own.turn(S + step * S // 10, 0.05, follows_rad, has_speed=True)
    now = own.at(S + 199 * S // 10)
    assert now is not None and now.gyros is not None
    assert now.gyros.compass_rad == pytest.approx(-0.15)


def test_without_rates_nothing_is_known_and_afterwards_it_is_another_leg() -> None:
    own = GyroHeading()
    for step in range(100):
        own.turn(S + step * S // 20, 0.05, 0.0, has_speed=True)
    before = own.at(6 * S)
    assert own.at(6 * S + REPORTS_APART_NS + S // 10) is None
    for step in range(10):
        own.turn(10 * S + step * S // 10, 0.0, 0.0, has_speed=True)
    after = own.at(11 * S)
    assert before is not None and after is not None and after.odometry_epoch != before.odometry_epoch


def test_without_a_speed_nothing_is_known_and_the_heading_goes_on() -> None:
    own, found = GyroHeading(), []
    for step in range(300):
        own.turn(S + step * S // 20, 0.05, 0.0, has_speed=not 100 <= step < 200)
        found.append(own.at(S + step * S // 20))
    assert found[50] is not None and found[250] is not None and found[50].odometry_epoch == found[250].odometry_epoch
    assert found[150] is None and own.at(S + 150 * S // 20) is None, "also afterwards"


def test_the_heading_is_the_less_certain_the_fewer_rates_come() -> None:
    """A wheel that is turned left and right: at one rate a second, what it did in between is not known."""
    often, seldom = GyroHeading(), GyroHeading()
    for own, hz in ((often, 20), (seldom, 1)):
        for step in range(40 * hz):
            own.turn(S + step * S // hz, 0.1 * math.sin(step / hz * 1.3), 0.0, has_speed=True)
    found = [one.at(40 * S) for one in (often, seldom)]
    sigmas_deg = [math.degrees(math.sqrt(one.gyros.turned_rad2)) for one in found if one and one.gyros]
    assert sigmas_deg[0] < 0.2 and 5.0 < sigmas_deg[1] < 20.0
