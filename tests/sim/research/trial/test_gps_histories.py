"""Histories of GPS."""

from __future__ import annotations

import numpy as np
import pytest

from sim.research.trial import gps_histories

TIME_S = np.arange(0.0, 200.0, 0.1)
NORTH_M = np.column_stack([np.zeros(2000), 8.0 * TIME_S])
"""At 8 m/s to the north."""


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.mark.parametrize(
    ("way", "east", "north"), [("along", 0, 1), ("behind", 0, -1), ("left", -1, 0), ("right", 1, 0)]
)
def test_a_drag_off_grows_from_its_start_in_its_direction(way: str, east: int, north: int) -> None:
    offsets = gps_histories.drag(2.0, way, 100.0)(TIME_S, NORTH_M, rng())
    assert np.hypot(*offsets[TIME_S < 100.0].T).max() < 6.0
    assert offsets[-1] == pytest.approx((200.0 * east, 200.0 * north), abs=6.0)


def test_an_honest_gps_has_bursts_of_10_m_and_short_outages() -> None:
    errors_m = np.hypot(*gps_histories.multipath(np.arange(0.0, 3000.0, 0.1), NORTH_M, rng()).T)
    assert 10.0 < np.nanpercentile(errors_m, 99) < 15.0
    assert np.nanmedian(errors_m) < 3.0
    assert 0.01 < np.isnan(errors_m).mean() < 0.1
    assert np.hypot(*gps_histories.rtk(TIME_S, NORTH_M, rng()).T).max() < 0.15


def test_a_replay_is_where_the_vehicle_was() -> None:
    offsets = gps_histories.replay(30.0, 100.0)(TIME_S, NORTH_M, rng())
    assert offsets[-1] == pytest.approx((0.0, -240.0), abs=6.0)


def test_jamming_comes_before_the_spoofed_position() -> None:
    offsets = gps_histories.jammed(10.0, gps_histories.jump(60.0, 100.0), 100.0)(TIME_S, NORTH_M, rng())
    assert np.array_equal(np.isnan(offsets[:, 0]), (TIME_S >= 100.0) & (TIME_S < 110.0))
    assert offsets[-1] == pytest.approx((-60.0, 0.0), abs=6.0)
