"""Own motion by gyros: the heading is theirs, how it lies and how it drifts comes from where places and GPS agreed."""

from __future__ import annotations

import math

import pytest

from edge.localization.dead_reckoning import REPORTS_APART_NS
from edge.localization.gyro_odometer import GyroOdometer
from tests.common import S

SPEED_MPS = 4.0


def drive(
    own: GyroOdometer,
    seconds: float,
    rate_radps: float,
    bias_radps: float = 0.0,
    compass_rad: float = 0.0,
    hz: int = 20,
) -> tuple[float, float]:
    """A circle from the north on; east and north of its end."""
    for step in range(round(seconds * hz) + 1):
        stamp_ns = S + step * S // hz
        heading_rad = rate_radps * step / hz + compass_rad
        own.turn(stamp_ns, rate_radps + bias_radps, heading_rad, (SPEED_MPS, 0.0))
    radius_m, turned = SPEED_MPS / rate_radps, seconds * rate_radps
    return radius_m * (1 - math.cos(turned)), radius_m * math.sin(turned)


def test_the_autopilots_heading_only_begins_it() -> None:
    """The autopilot turns its heading afterwards, as one that follows a GPS that is dragged: that turns nothing."""
    own = GyroOdometer()
    for step in range(200):
        follows_rad = -0.15 * min(1.0, step / 100)
        own.turn(S + step * S // 10, 0.0, follows_rad, (SPEED_MPS, 0.0))
    now = own.displacement(S + 199 * S // 10)
    assert now is not None and now.gyros is not None
    assert (now.east_m, now.north_m) == pytest.approx((0.0, SPEED_MPS * 19.9))
    assert now.gyros.compass_rad == pytest.approx(-0.15)


def test_without_rates_nothing_is_known_and_afterwards_it_is_another_leg() -> None:
    own = GyroOdometer()
    drive(own, 5.0, 0.05)
    before = own.displacement(6 * S)
    assert own.displacement(6 * S + REPORTS_APART_NS + S // 10) is None
    for step in range(10):
        own.turn(10 * S + step * S // 10, 0.0, 0.0, (SPEED_MPS, 0.0))
    after = own.displacement(11 * S)
    assert before is not None and after is not None and after.odometry_epoch != before.odometry_epoch


def test_the_heading_is_the_less_certain_the_fewer_rates_come() -> None:
    """A wheel that is turned left and right: at one rate a second, what it did in between is not known."""
    often, seldom = GyroOdometer(), GyroOdometer()
    for own, hz in ((often, 20), (seldom, 1)):
        for step in range(40 * hz):
            own.turn(S + step * S // hz, 0.1 * math.sin(step / hz * 1.3), 0.0, (SPEED_MPS, 0.0))
    turned = [one.displacement(40 * S) for one in (often, seldom)]
    assert turned[0] is not None and turned[0].gyros is not None
    assert turned[1] is not None and turned[1].gyros is not None
    assert math.sqrt(turned[0].gyros.turned_rad2) < math.radians(0.2)
    assert math.radians(5.0) < math.sqrt(turned[1].gyros.turned_rad2) < math.radians(20.0)
