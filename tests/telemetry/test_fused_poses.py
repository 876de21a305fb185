"""Keypoint poses as measurements for ArduPilot: what is sent, when, and to which of its sets of sources."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import GatesConfig
from edge.geodesy import east_north_of
from edge.journal.records import FixSent, PositionMessageChosen, SourceSetAnswered
from edge.localization import HOLE_S, GpsVerdict
from sim.vehicle.command import straight_line
from tests.telemetry.rig import SPEED_MPS, START_NS, OpenRig, Rig

SIGMA_M = 0.4
M_PER_DEG = 0.011131884502145034e7
"""LOCATION_SCALING_FACTOR of ArduPilot."""


def fused(open_rig: OpenRig, **options: Any) -> Rig:
    """GPS has been healthy for 40 s, 320 m from the origin."""
    rig = open_rig(**{"emit": "auto", "gates": GatesConfig(risk=1.0), "firmware": "ardupilot-fused", **options})
    rig.run(40.0)
    return rig


def poses_for(rig: Rig, seconds: float, sigma_m: float | None = SIGMA_M, **changes: Any) -> int:
    """A pose each half second, whose exposure is as long ago; None: a sequence match. How many led to messages."""
    rig.drive.pose_sigma_m, sent = sigma_m, 0
    for _ in range(round(2 * seconds)):
        rig.run(0.5)
        sent += rig.send_position(rig.fix(sigma_along_m=1.0, sigma_cross_track_m=1.0, **changes))
    rig.run(0.1)
    return sent


def sets_selected(rig: Rig) -> list[int]:
    commands = rig.received("COMMAND_LONG")
    return [int(one.param1) for one in commands if one.command == mavlink.MAV_CMD_SET_EKF_SOURCE_SET]


def poses(rig: Rig) -> list[Any]:
    return rig.received("VISION_POSITION_ESTIMATE")


def texts(rig: Rig) -> list[str]:
    return [one.text for one in rig.received("STATUSTEXT")]


@pytest.mark.parametrize(
    ("changed", "chosen"),
    [
        ({}, "vision_position"),
        ({"VISO_TYPE": 0.0}, "external_position"),
        ({"EK3_SRC2_POSXY": 3.0}, "external_position"),
        ({"VISO_TYPE": None}, "external_position"),
    ],
)
def test_auto_has_poses_fused_where_the_parameters_say_so(
    open_rig: OpenRig, changed: dict[str, float | None], chosen: str
) -> None:
    """None: it does not answer, which is waited for."""
    rig = open_rig(emit="auto", firmware="ardupilot-fused")
    for name, value in changed.items():
        _, kind = rig.autopilot.parameters.pop(name)
        if value is not None:
            rig.autopilot.parameters[name] = value, kind
    rig.run(20.0)
    why = f"ArduPilot 4.6 takes {chosen}"
    choices = rig.journalled(PositionMessageChosen)
    assert choices[-1] == PositionMessageChosen(chosen, why)
    assert {one.way for one in choices[:-1]} <= {"report"}, "never the other one before it is known"
    assert f"Lookback: {why}" in texts(rig)
    assert bool(rig.received("ODOMETRY")) is (chosen == "vision_position")


def test_nothing_is_sent_while_gps_works_and_then_set_2_is_selected_first(open_rig: OpenRig) -> None:
    rig = fused(open_rig)
    assert poses_for(rig, 5.0) == 0
    assert not poses(rig) and not sets_selected(rig)
    rig.autopilot.gps = False
    assert poses_for(rig, 10.0) >= 14
    assert sets_selected(rig) == [2]
    assert rig.autopilot.inputs.source_set == 2
    assert len(rig.autopilot.inputs.fused) == len(poses(rig)), "none came before set 2 was selected"
    assert len(poses(rig)) >= 14
    assert not [one for one in rig.received("COMMAND_INT") if one.command == 43003]
    assert "Lookback: GPS lost: by places, source set 2" in texts(rig)
    assert rig.journalled(SourceSetAnswered) == [SourceSetAnswered(2, "ACCEPTED")]


def test_each_exposure_is_one_measurement(open_rig: OpenRig) -> None:
    rig = fused(open_rig)
    rig.autopilot.gps = False
    poses_for(rig, 6.0)
    before = len(poses(rig))
    for _ in range(100):
        rig.run(0.1)
        rig.publish_position()
    assert len(poses(rig)) == before and before > 0, "the newest is not predicted on"
    assert np.diff([one.usec / 1e6 for one in poses(rig)]) == pytest.approx(np.full(before - 1, 0.5), abs=0.05)


@pytest.mark.parametrize("off_m", [0.0, 60.0])
def test_a_sequence_match_is_no_measurement_but_a_reset_where_one_is_needed(open_rig: OpenRig, off_m: float) -> None:
    rig = fused(open_rig)
    rig.autopilot.gps = False
    rig.run(3.0)
    rig.autopilot.estimate.shift(off_m, 0.0)
    poses_for(rig, 10.0, sigma_m=None)
    assert not poses(rig) and not sets_selected(rig)
    resets = [one for one in rig.received("COMMAND_INT") if one.command == 43003]
    assert bool(resets) == bool(rig.autopilot.resets) == (off_m > 0.0)
    assert rig.autopilot.estimate.error_m < 6.0


def test_a_pose_is_where_the_vehicle_is_now_in_the_frame_of_the_origin(open_rig: OpenRig) -> None:
    """Of half a second ago, 4 m behind; 320 m from the origin the ellipsoid differs by a meter from ArduPilot's way."""
    rig = fused(open_rig, drift_percent=3.0)
    rig.autopilot.gps = False
    poses_for(rig, 10.0)
    origin, truth = rig.connection.vehicle.session.origin, straight_line(SPEED_MPS, 60.0, START_NS / 1e9)
    assert origin is not None and len(poses(rig)) > 10
    booted_s = rig.autopilot.booted_s
    for one in poses(rig):
        lat_deg = origin.lat_deg + one.x / M_PER_DEG
        lon_deg = origin.lon_deg + one.y / M_PER_DEG / math.cos(math.radians((lat_deg + origin.lat_deg) / 2))
        off_m = east_north_of(lat_deg, lon_deg, truth(booted_s + one.usec / 1e6).geodetic())
        assert math.hypot(*off_m) < 0.3
        assert one.z == pytest.approx(origin.alt_m - rig.position.alt_m, abs=1.0)
    assert rig.autopilot.estimate.error_m < 1.0


def test_a_pose_says_its_own_sigma_as_ardupilot_reads_it(open_rig: OpenRig) -> None:
    """Without the error of the map, which all of them share: the cube root of the sum of squared variances."""
    rig = fused(open_rig)
    rig.autopilot.gps = False
    poses_for(rig, 4.0)
    assert poses(rig)
    for one in poses(rig):
        assert math.cbrt(sum(one.covariance[at] ** 2 for at in (0, 6, 11))) == pytest.approx(SIGMA_M, rel=1e-5)
    sent = rig.journalled(FixSent)
    assert {one.pose_sigma_m for one in sent} == {SIGMA_M}
    assert [one.sigma_m for one in sent] == pytest.approx([math.sqrt(2)] * len(sent), abs=1e-3), "with that error"


def test_a_wide_pose_only_ends_a_hole(open_rig: OpenRig) -> None:
    """ArduPilot 4.6 counts all alike."""
    rig = fused(open_rig)
    rig.autopilot.gps = False
    poses_for(rig, 4.0)
    before = len(poses(rig))
    assert poses_for(rig, HOLE_S - 1.0, sigma_m=2.1) == 0
    assert poses_for(rig, 3.0, sigma_m=2.1) == 1
    assert len(poses(rig)) == before + 1 and before > 0


def test_the_first_pose_after_gps_is_not_wide(open_rig: OpenRig) -> None:
    """Its filter goes to that one, whatever it has: 2.0 m off was 1.7 m beside the lane in a flight."""
    rig = fused(open_rig)
    rig.autopilot.gps = False
    assert poses_for(rig, HOLE_S - 1.0, sigma_m=1.1) == 0
    assert sets_selected(rig) == [2]
    assert poses_for(rig, 1.0) == 2


def test_gps_that_is_ignored_is_not_called_lost(open_rig: OpenRig) -> None:
    """It counts again once it is consistent, and not because it works."""
    rig = fused(open_rig, gates=GatesConfig(risk=1.0, doubted_gps="switch"))
    rig.drive.judge(GpsVerdict("faulty", (6.0, 0.0)))
    poses_for(rig, 10.0)
    assert "Lookback: GPS faulty: by places, source set 2" in texts(rig)
    rig.drive.judge(GpsVerdict("cannot say"))
    poses_for(rig, 10.0)
    assert sets_selected(rig) == [2]


def test_once_gps_works_again_it_is_by_gps(open_rig: OpenRig) -> None:
    rig = fused(open_rig)
    rig.autopilot.gps = False
    poses_for(rig, 6.0)
    rig.autopilot.gps = True
    poses_for(rig, 8.0)
    assert sets_selected(rig) == [2, 1]
    assert rig.autopilot.inputs.source_set == 1
    before = len(poses(rig))
    assert poses_for(rig, 5.0) == 0
    assert len(poses(rig)) == before
    assert "Lookback: GPS works: by GPS, source set 1" in texts(rig)


def test_the_pilots_switch_has_the_last_word(open_rig: OpenRig) -> None:
    rig = fused(open_rig)
    rig.autopilot.gps = False
    poses_for(rig, 6.0)
    rig.autopilot.inputs.source_set = 1
    rig.autopilot.send(mavlink.MAVLink_statustext_message(6, b"Using EKF Source Set 1"))
    rig.run(0.2)
    before = len(poses(rig))
    poses_for(rig, 10.0)
    assert len(poses(rig)) == before and before > 0
    assert sets_selected(rig) == [2]
    assert rig.journalled(SourceSetAnswered)[-1] == SourceSetAnswered(1, "BY_THE_PILOT")
    assert "Lookback: source set 1 by the pilot, stays" in texts(rig)
    rig.autopilot.gps = True
    rig.run(10.0)
    rig.autopilot.gps = False
    poses_for(rig, 5.0)
    assert sets_selected(rig) == [2], "nor at the next loss"


def test_the_sensor_is_kept_healthy_by_odometry_that_is_not_used(open_rig: OpenRig) -> None:
    """From the start on, since it is checked at arming."""
    rig = open_rig(emit="auto", firmware="ardupilot-fused", gates=GatesConfig(risk=1.0))
    rig.run(10.0)
    before = len(rig.received("ODOMETRY"))
    rig.run(10.0)
    messages = rig.received("ODOMETRY")
    assert len(messages) - before == pytest.approx(50, abs=2)
    assert {one.quality for one in messages} == {-1}
    assert all(math.isnan(value) for one in messages for value in (one.vx, one.vy, one.vz))
