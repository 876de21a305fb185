"""Own motion by gyros: the heading is theirs, how it lies and how it drifts comes from where places and GPS agreed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.localization.own_motion import BIAS_RADPS, RATES_APART_NS, OwnMotion, calibrated

S = 1_000_000_000
SPEED_MPS = 4.0


def drive(
    own: OwnMotion, seconds: float, rate_radps: float, bias_radps: float = 0.0, compass_rad: float = 0.0, hz: int = 20
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
    own = OwnMotion()
    for step in range(200):
        follows_rad = -0.15 * min(1.0, step / 100)
        own.turn(S + step * S // 10, 0.0, follows_rad, (SPEED_MPS, 0.0))
    now = own.displacement(S + 199 * S // 10)
    assert now is not None and now.gyros is not None
    assert (now.east_m, now.north_m) == pytest.approx((0.0, SPEED_MPS * 19.9))
    assert now.gyros.compass_rad == pytest.approx(-0.15)


def test_without_rates_nothing_is_known_and_afterwards_it_is_another_leg() -> None:
    own = OwnMotion()
    drive(own, 5.0, 0.05)
    before = own.displacement(6 * S)
    assert own.displacement(6 * S + RATES_APART_NS + S // 10) is None
    for step in range(10):
        own.turn(10 * S + step * S // 10, 0.0, 0.0, (SPEED_MPS, 0.0))
    after = own.displacement(11 * S)
    assert before is not None and after is not None and after.leg != before.leg
    at_m, sigma_m = np.zeros((1, 2, 2)), np.ones((1, 2))
    shown = calibrated([before], at_m, sigma_m, 0.05)
    assert shown is not None and shown.predicted(after) is None


def test_places_that_agreed_show_the_bias_of_the_gyros() -> None:
    """A straight drive by gyros that turn by 0.2 deg/s: far aside after 240 m more without places."""
    own, bias_radps, moments, at_m = OwnMotion(), math.radians(0.2), [], []
    for step in range(1200):
        own.turn(S + step * S // 10, bias_radps, 0.0, (SPEED_MPS, 0.0))
        if step in range(0, 601, 50):
            moments.append(own.displacement(S + step * S // 10))
            at_m.append(np.tile([[0.0], [SPEED_MPS * step / 10]], 2))
    now = own.displacement(S + 1199 * S // 10)
    known = [one for one in moments if one is not None]
    assert now is not None and len(known) == 13
    shown = [calibrated(known[-rows:], np.array(at_m[-rows:]), np.full((rows, 2), 3.0), 0.05) for rows in (13, 1)]
    assert shown[0] is not None and shown[1] is not None
    found, alone = shown[0].predicted(now), shown[1].predicted(now)
    assert found is not None and alone is not None
    assert abs(found[0][0, 0]) < 2.0 * math.sqrt(found[1][0, 0])
    assert math.sqrt(found[1][0, 0]) < 0.7 * math.sqrt(alone[1][0, 0])
    assert math.sqrt(alone[1][0, 0]) > BIAS_RADPS * 59**2 / 2 * SPEED_MPS, "a bias turns for 59 s"
    assert abs(found[0][0, 0]) < abs(alone[0][0, 0]) - 5.0


def test_the_heading_is_the_less_certain_the_fewer_rates_come() -> None:
    """A wheel that is turned left and right: at one rate a second, what it did in between is not known."""
    often, seldom = OwnMotion(), OwnMotion()
    for own, hz in ((often, 20), (seldom, 1)):
        for step in range(40 * hz):
            own.turn(S + step * S // hz, 0.1 * math.sin(step / hz * 1.3), 0.0, (SPEED_MPS, 0.0))
    turned = [one.displacement(40 * S) for one in (often, seldom)]
    assert turned[0] is not None and turned[0].gyros is not None
    assert turned[1] is not None and turned[1].gyros is not None
    assert math.sqrt(turned[0].gyros.turned_rad2) < math.radians(0.2)
    assert math.radians(5.0) < math.sqrt(turned[1].gyros.turned_rad2) < math.radians(20.0)
