"""Motion over the ground between two pictures, against a camera that is computed ray by ray."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from edge_plugins.motion.ground import GroundMotion, GroundView, measure
from tests.plugins.motion.road import FOV_DEG, HEIGHT, WIDTH, picture


def step(before: NDArray[np.uint8], now: NDArray[np.uint8], pitch_rad: float = 0.0) -> GroundMotion | str:
    view = GroundView(FOV_DEG, WIDTH, HEIGHT, pitch_rad)
    return measure(view, view.contrast(before), view.contrast(now), 0.1, None, (pitch_rad, math.radians(0.5)))


@pytest.mark.parametrize("moved_m", [-0.5, 0.0, 0.05, 0.7, 1.5])
def test_the_motion_ahead_is_measured_in_heights(moved_m: float) -> None:
    found = step(picture(5.0), picture(5.0 + moved_m, seed=1))
    assert isinstance(found, GroundMotion)
    assert found.ahead == pytest.approx(moved_m / 1.4, abs=0.004 + 0.01 * abs(moved_m))
    assert abs(found.ahead - moved_m / 1.4) < 3 * found.ahead_sigma + 0.004
    assert found.turn_rad == pytest.approx(0.0, abs=3 * found.turn_sigma)


def test_a_turn_to_the_right_is_positive() -> None:
    found = step(picture(5.0), picture(5.7, east_m=0.01, heading_rad=0.03, seed=1))
    assert isinstance(found, GroundMotion)
    assert found.turn_rad == pytest.approx(0.03, abs=0.005)
    assert found.ahead == pytest.approx(0.5, abs=3 * found.ahead_sigma)


def test_a_nose_that_dives_between_the_pictures_is_no_motion() -> None:
    dive_rad = math.radians(0.3)
    found = step(picture(5.0), picture(5.7, pitch_rad=dive_rad, seed=1))
    assert isinstance(found, GroundMotion)
    assert found.ahead == pytest.approx(0.5, abs=0.01), "and not 0.57, as with a stiff camera"
    assert found.pitch_rad == pytest.approx(dive_rad, abs=3 * found.pitch_sigma)


def test_gyroscopes_tell_a_dive_from_motion() -> None:
    dive_rad = math.radians(1.5)
    view, before, now = GroundView(FOV_DEG, WIDTH, HEIGHT, 0.0), picture(5.0), picture(5.7, pitch_rad=dive_rad, seed=1)
    found = [
        measure(view, view.contrast(before), view.contrast(now), 0.1, None, (0.0, math.radians(0.5)), turned)
        for turned in (None, (0.0, dive_rad))
    ]
    off_rad = [abs(one.pitch_rad - dive_rad) for one in found if isinstance(one, GroundMotion)]
    assert off_rad[1] < math.radians(0.1) < off_rad[0]
    assert isinstance(found[1], GroundMotion) and found[1].ahead == pytest.approx(0.5, abs=0.007)


def test_a_camera_that_looks_straight_down() -> None:
    pitch_rad = math.radians(90)
    found = step(picture(5.0, pitch_rad=pitch_rad), picture(5.4, pitch_rad=pitch_rad), pitch_rad)
    assert isinstance(found, GroundMotion)
    assert found.ahead == pytest.approx(0.4 / 1.4, abs=0.01)
