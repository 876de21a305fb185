"""Histories of GPS, and a drive that they are held against, whose places are known without pictures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edge.geodesy import moved
from edge.reference_map import Route
from edge.sequence import PlaceMatch
from sim.research.trial import gps_command, gps_histories
from sim.research.trial.gps_drives import Outcome, PlacedDrive, PlacedFrame, judge
from sim.vehicle.position_inputs import east_north_m
from tests.localization.route_course import HOME, Stretch, build_maps, road_line

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


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> PlacedDrive:
    """Along a winding road at 8 m/s, with a match each 2 m that is a few meters wrong."""
    line, heading = road_line(1600.0, np.random.default_rng(7))
    maps, _ = build_maps(tmp_path_factory.mktemp("map") / "map", line, heading, (Stretch(0.0, 1600.0),))
    route = Route(maps)
    noise, error_m, frames = rng(), 0.0, []
    for number in range(790):
        error_m += -0.03 * error_m + noise.normal(0.0, 0.8)
        at = int(np.clip(number + 16 + round(error_m / 2.0), 0, 799))  # the places lie 32 m ahead
        match = PlaceMatch(at, at, "forward", "swapped", 1.0, 0.5, 1.3, confidence=0.999, accepted=40 < number < 780)
        frames.append(PlacedFrame(round(number * 2.5), match, 0))
    ground_m = np.array([east_north_m(*moved(*HOME, *point)) for point in line.tolist()])
    true_m = np.column_stack([np.interp(8.0 * TIME_S, np.arange(len(line)), axis) for axis in ground_m.T])
    return PlacedDrive("road", TIME_S, true_m, 0.97 * true_m, route, tuple(frames))


def test_an_honest_history_is_not_called(drive: PlacedDrive) -> None:
    for seed in range(3):
        offsets = gps_histories.multipath(drive.time_s, drive.true_m, np.random.default_rng(seed))
        outcome = judge(drive, offsets)
        assert math.isnan(outcome.called_m)
        assert not outcome.warned
        assert outcome.driven_m == pytest.approx(1600.0, abs=10.0)


@pytest.mark.parametrize("way", list(gps_histories.TURNS_DEG))
def test_the_pilot_is_told_of_a_drag_off_and_own_motion_calls_it(drive: PlacedDrive, way: str) -> None:
    outcome = judge(drive, gps_histories.drag(1.0, way, 60.0)(drive.time_s, drive.true_m, rng()))
    assert 10.0 < outcome.told_m < 50.0
    assert outcome.told_m <= outcome.called_m < 100.0
    assert outcome.seen


def test_without_own_motion_nobody_is_called_wrong(drive: PlacedDrive) -> None:
    unknown = replace(drive, by_wheels_m=np.full_like(drive.true_m, math.nan))
    outcome = judge(unknown, gps_histories.drag(1.0, "left", 60.0)(drive.time_s, drive.true_m, rng()))
    assert outcome.told_m < 50.0
    assert math.isnan(outcome.called_m)


def test_the_table_counts_what_was_called_in_time(capsys: pytest.CaptureFixture[str]) -> None:
    early = Outcome(30.0, 28.0, 80.0, True, 1.0, 1600.0, False, "night")
    late = Outcome(70.0, 65.0, 200.0, False, 1.0, 1600.0, False, "night")
    gps_command._print_drags([(1.0, "left", early), (1.0, "along", late)])
    rows = capsys.readouterr().out.splitlines()
    assert "| 1 m/s | 2 | 1 | 1 of 1 | 2 | 46 / 28 m |" in rows
    assert rows[-1].startswith("| all | 2 | 1 | 1 of 1 |")
