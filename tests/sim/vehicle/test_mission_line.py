"""A simulated vehicle that steers itself along an uploaded way home."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.config import HomeConfig
from edge.mission import plan_way_home
from edge.reference_map import open_map_set
from sim.vehicle.driver import Driver, Leg
from sim.vehicle.mission_line import MissionLine
from tests.mission.test_way_home import arc, away_m, joined, straight


class Knowing:
    """Believes what is true."""

    steering_error_rad = 0.0

    def __init__(self, driver: Driver) -> None:
        self._driver = driver

    @property
    def east_m(self) -> float:
        return self._driver.pose.east_m

    @property
    def north_m(self) -> float:
        return self._driver.pose.north_m


def test_a_vehicle_that_follows_the_mission_comes_home(map_along: Callable[..., Path]) -> None:
    drive = joined(straight(120.0), arc(25.0, 90), straight(80.0, -90.0), arc(25.0, 90) @ np.array([[0, 1], [-1, 0]]))
    way = plan_way_home(open_map_set(map_along(drive)), None, HomeConfig())
    assert not way.refusals
    line = MissionLine(way.positions_deg)
    driver = Driver(line, [Leg(line.length_m, 4.0)], np.random.default_rng(1))
    driver.belief = Knowing(driver)
    track = []
    for _ in range(20_000):
        if driver.ended:
            break
        driver.step(0.05)
        track.append((driver.pose.east_m, driver.pose.north_m))
    assert driver.ended
    assert math.dist(track[-1], drive[0]) < 3.0
    assert away_m(np.array(track[::20]), drive).max() < 2.0


@pytest.mark.parametrize("left_m", [-3.0, 0.0, 2.0])
def test_a_position_beside_the_line_is_projected_on_it(left_m: float) -> None:
    line = MissionLine([(-27.4772, 153.0283), (-27.4762, 153.0283), (-27.4762, 153.0293)])
    for along_m in (10.0, 60.0, 150.0):
        east_m, north_m, _ = line.at(along_m, left_m)
        assert line.project(east_m, north_m, along_m + 4.0) == pytest.approx((along_m, left_m), abs=0.05)
