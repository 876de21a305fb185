"""How far beside the map's drive a vehicle drove, from positions alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge.feed import Feed, FeedHeader, FeedRow
from edge_plugins.mapping.builder import Place
from sim.calibration.offset import measure_offsets, rig_config
from sim.calibration.offset_samples import MapDrives, OffsetSample
from tests.map_of import map_of

METER_NORTH_DEG, METER_EAST_DEG = 1 / 110_773, 1 / 99_255  # at 27 degrees south


@pytest.fixture
def drives(tmp_path: Path) -> MapDrives:
    """A map due north, and a feed that drives beside it, 3.5 m to the east, 1 m to the west, and far off."""
    places = [Place(row, -27.0 + 2 * row * METER_NORTH_DEG, 153.0, route_m=2.0 * row) for row in range(20)]
    of_drive = map_of(tmp_path / "map", np.random.default_rng(0).random((20, 2, 8)), places, view="rear")
    rows = tuple(
        FeedRow("", index, lat_deg=-27.0 + 11 * METER_NORTH_DEG, lon_deg=153.0 + east_m * METER_EAST_DEG)
        for index, east_m in enumerate((3.5, -1.0, 200.0))
    )
    return MapDrives(of_drive, Feed(tmp_path, FeedHeader("beside", "front", 16, 16), rows))


def test_left_is_left_for_who_made_the_map(drives: MapDrives) -> None:
    assert drives.left_m(0, place=4) == pytest.approx(-3.5, abs=0.02)
    assert drives.left_m(1, place=4) == pytest.approx(1.0, abs=0.02)
    assert np.isnan(drives.left_m(2, place=4))


def test_the_rig_is_told_the_middle_of_it_for_each_direction() -> None:
    rng = np.random.default_rng(2)
    home = [OffsetSample("reverse", "same", 0.0, 1.2, True, left_m) for left_m in rng.normal(3.5, 3.0, 400)]
    again = [OffsetSample("forward", "swapped", 26.0, 1.2, True, 0.3) for _ in range(20)]
    lost = [OffsetSample("forward", "swapped", 26.0, 1.2, True) for _ in range(20)]
    rig = rig_config(measure_offsets([*home, *again, *lost]))
    assert rig.left_reverse_m == pytest.approx(3.5, abs=0.4)
    assert rig.left_forward_m == 0.3
    assert rig.sigma_cross_track_m == pytest.approx(3.0, abs=0.4)
    assert rig_config(measure_offsets(again)).sigma_cross_track_m == 2.5, "no lane is kept better"


def test_poses_measure_how_far_cameras_are_from_their_antennas() -> None:
    rng = np.random.default_rng(4)
    poses_m = [*rng.normal(6.0, 0.3, 200), *[float("nan")] * 50, *rng.normal(30.0, 1.0, 20)]
    home = [
        OffsetSample("reverse", "same", 7.9, 1.2, True, place_m=2.0 * at, pose_m=pose_m)
        for at, pose_m in enumerate(poses_m)
    ]
    rig = rig_config(measure_offsets(home))
    assert (rig.look_ahead_reverse_m, rig.look_ahead_forward_m, rig.look_sigma_m) == (6.0, 0.0, 0.5)
    assert rig_config(measure_offsets(home[200:])).look_sigma_m > 0.5, "few, and far apart"
    assert rig_config(measure_offsets(home[:9])).look_sigma_m == 0.0
