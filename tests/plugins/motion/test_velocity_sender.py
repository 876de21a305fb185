"""The camera's velocity for the autopilot's filter: by which message, whether it follows, and when it is silent."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.firmware import NO_AID, VISION
from edge_plugins.motion.camera_motion import CameraSpeed
from edge_plugins.motion.velocity_sender import VelocityChanged, VelocitySender, odometry, position_delta
from sim.journal import records_of
from sim.vehicle.estimator import OdometryErrors
from tests.common import S
from tests.telemetry.rig import LENIENT, SPEED_MPS, START_NS, Rig

RUNS_AWAY = OdometryErrors("camera", acceleration_mps2=0.2)


def speed(
    now_ns: int, mps: float = SPEED_MPS, sigma_mps: float = 0.2, scale_share: float = 0.02, right_mps: float = 0.0
) -> CameraSpeed:
    return CameraSpeed(now_ns - S // 10, mps, sigma_mps, 0.1, 0.01, right_mps, 0.24, scale_share)


def flying(
    folder: Path, firmware: str, *, is_on: bool = True, emit: str = "auto", errors: OdometryErrors = RUNS_AWAY
) -> Rig:
    """At 8 m/s; GPS is lost after 6 s."""
    fails_s = START_NS / 1e9 + 6
    motion = "send" if is_on else "odometer"
    return Rig(folder, emit, LENIENT, motion=motion, firmware=firmware, errors=errors, gps_fails_s=fails_s)


def see(
    rig: Rig,
    seconds: float,
    mps: float = SPEED_MPS,
    followed_mps: float | None = None,
    found: tuple[float, float] | None = None,
) -> None:
    """The camera measures ten times a second. followed_mps: what the positions are made with, if that differs.

    found: error of the heading by poses.
    """
    sender = VelocitySender(rig.connection, lambda: found)
    for _ in range(round(10 * seconds)):
        rig.run(0.1)
        measured = speed(rig.now_ns, mps)
        rig.connection.vehicle.velocity.use_speed(measured.stamp_ns, followed_mps or measured.speed_mps)
        sender.send(measured)


@pytest.mark.parametrize(("firmware", "kind"), [("px4", "ODOMETRY"), ("ardupilot", "VISION_POSITION_DELTA")])
def test_a_filter_that_nothing_else_aids_follows_the_camera(firmware: str, kind: str, tmp_path: Path) -> None:
    rig = flying(tmp_path, firmware)
    see(rig, 20.0)
    assert rig.autopilot.estimate.error_m < 3.0
    assert kind in {one.message.get_type() for one in rig.autopilot.received}
    assert all(rig.autopilot.inputs.velocities_fused[-100:])
    assert rig.connection.vehicle.velocity.aid.is_any
    assert [one.is_sent for one in records_of(tmp_path / "events.jsonl", VelocityChanged)][-1:] == [True]


@pytest.mark.parametrize(("found_deg", "sideways_m"), [(None, (8.0, 12.0)), (-5.0, (0.0, 3.0))])
def test_a_heading_that_poses_have_found_wrong_leads_px4_nowhere(
    found_deg: float | None, sideways_m: tuple[float, float], tmp_path: Path
) -> None:
    """Its heading is 5 degrees off to the right for 110 m: by that it goes 10 m aside."""
    errors = replace(RUNS_AWAY, heading_deg=5.0)
    rig = flying(tmp_path, "px4", errors=errors)
    see(rig, 20.0, found=None if found_deg is None else (math.radians(found_deg), 0.01))
    assert all(rig.autopilot.inputs.velocities_fused[-100:])
    assert sideways_m[0] <= rig.autopilot.estimate.error_m <= sideways_m[1]


@pytest.mark.parametrize(("firmware", "moved_m"), [("px4", 18.0), ("ardupilot", 24.0)])
def test_px4_moves_as_the_camera_measures_and_not_as_its_filter_makes_of_it(
    firmware: str, moved_m: float, tmp_path: Path
) -> None:
    """The vehicle drives at 8 m/s, and so PX4's filter has it; the camera is made to measure 6."""
    rig = flying(tmp_path, firmware)
    see(rig, 12.0)
    found = []
    for _ in range(2):
        see(rig, 3.0, followed_mps=6.0)
        found.append(rig.connection.vehicle.motion.displacement(rig.now_ns))
    before, after = found
    assert before is not None and after is not None
    assert math.hypot(after.east_m - before.east_m, after.north_m - before.north_m) == pytest.approx(moved_m, abs=1.0)


@pytest.mark.parametrize("motion", ["report", "off"])
def test_the_attitude_is_requested_for_the_camera_and_for_the_witness_of_gps(motion: str, tmp_path: Path) -> None:
    rig = Rig(tmp_path, "report", LENIENT, motion=motion, firmware="ardupilot", errors=RUNS_AWAY)
    rig.run(8.0)
    now_ns = rig.now_ns
    assert rig.connection.vehicle.velocity.turned_rad(now_ns - S, now_ns) is not None


def test_without_it_the_same_filter_runs_away(tmp_path: Path) -> None:
    rig = flying(tmp_path, "px4", is_on=False)
    see(rig, 20.0)
    assert rig.autopilot.estimate.error_m > 15.0
    assert not rig.autopilot.inputs.velocities_fused


def test_a_report_sends_no_velocity(tmp_path: Path) -> None:
    rig = flying(tmp_path, "px4", emit="report")
    see(rig, 8.0)
    assert not rig.autopilot.inputs.velocities_fused


@pytest.mark.parametrize("silent_s", [1.3, 10.0])
def test_when_the_camera_is_silent_nothing_measures_the_velocity(silent_s: float, tmp_path: Path) -> None:
    """What was driven meanwhile is in the standard deviation from then on: PX4 is 1.6 and 16 m off."""
    rig = flying(tmp_path, "px4")
    see(rig, 12.0)
    assert rig.bounded_m is not None
    rig.run(silent_s)
    assert not rig.connection.vehicle.velocity.aid.is_any
    assert rig.bounded_m is None
    see(rig, 2.0)
    assert rig.connection.vehicle.velocity.aid.is_any
    assert rig.autopilot.estimate.error_m < rig.uncertainty_m < 3 * rig.autopilot.estimate.error_m + 3.0


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """Its autopilot is heard, and time stands still from now on."""
    rig = Rig(tmp_path_factory.mktemp("up"), "auto", LENIENT, motion="send", firmware="px4")
    rig.run(3.0)
    return rig


@pytest.mark.parametrize(
    ("late_s", "changes", "aid", "why"),
    [
        (0, {}, VISION, ""),
        (0, {}, NO_AID, "the autopilot's parameters do not use it"),
        (0, {}, None, "the autopilot's parameters do not use it"),
        (1, {}, VISION, "too old"),
        (-1, {}, VISION, "too old"),
        (0, {"sigma_mps": 1.7}, VISION, "too uncertain"),
        (0, {"mps": 0.1, "sigma_mps": 0.4}, VISION, ""),
        (0, {"scale_share": 0.06}, VISION, "the camera's height is not known well enough"),
    ],
)
def test_what_speaks_against_sending(up: Rig, late_s: int, changes: Any, aid: str | None, why: str) -> None:
    connection, aided = up.connection, up.connection.velocity_aid
    records: list[object] = []
    connection.record = records.append
    aided.without_gps, aided.sent_ns = aid, None
    VelocitySender(connection).send(speed(up.now_ns - late_s * S, **changes))
    assert records == [VelocityChanged(is_sent=not why, why=why)]
    assert aided.sent_ns == (None if why else up.now_ns)
    assert aided.is_known(up.now_ns) == (not why)


def test_where_gps_was_lost_before_the_height_was_known_no_velocity_is_sent(tmp_path: Path) -> None:
    """ArduPilot's failsafe came 8 s after the first."""
    rig = flying(tmp_path, "ardupilot")
    rig.run(10.0)
    see(rig, 5.0)
    assert [one.why for one in records_of(tmp_path / "events.jsonl", VelocityChanged)] == [
        "GPS was lost before the camera's height was known"
    ]
    assert not rig.autopilot.inputs.velocities_fused


def test_the_messages_as_others_read_them() -> None:
    ours, theirs = MavlinkCodec(5, 191), mavlink.MAVLink(None)
    (delta,) = theirs.parse_buffer(ours.encode(position_delta(speed(10 * S, sigma_mps=0.5))))
    assert delta.get_type() == "VISION_POSITION_DELTA" and delta.time_usec == 9_900_000
    assert [one / delta.time_delta_usec * 1e6 for one in delta.position_delta] == pytest.approx([SPEED_MPS, 0, 0])
    assert delta.angle_delta[2] / delta.time_delta_usec * 1e6 == pytest.approx(0.1)
    assert delta.confidence == pytest.approx(50.0), "0.5 m/s, halfway from 0.1 to 0.9"
    (sent,) = theirs.parse_buffer(ours.encode(odometry(speed(10 * S))))
    assert sent.child_frame_id == mavlink.MAV_FRAME_BODY_FRD
    assert (sent.vx, sent.vy, sent.vz) == (SPEED_MPS, 0.0, 0.0)
    assert math.isnan(sent.x) and math.isnan(sent.q[0]), "neither a position nor an attitude"
    assert sent.velocity_covariance[0] == pytest.approx(0.5**2), "0.2 by the pictures, which all are wrong alike"
    assert sent.velocity_covariance[6] == sent.velocity_covariance[11] == pytest.approx(0.24**2)
    (sent,) = theirs.parse_buffer(ours.encode(odometry(speed(10 * S), (math.radians(90.0), math.radians(1.0)))))
    assert sent.child_frame_id == mavlink.MAV_FRAME_LOCAL_NED
    assert (sent.vx, sent.vy, sent.vz) == pytest.approx((0.0, SPEED_MPS, 0.0), abs=1e-6), "to the east"
    assert sent.velocity_covariance[0] == pytest.approx(0.24**2 + (math.radians(1.0) * SPEED_MPS) ** 2)
    assert sent.velocity_covariance[6] == pytest.approx(0.5**2)
    slips = odometry(speed(10 * S, right_mps=0.4), (math.radians(90.0), math.radians(1.0)))
    assert (slips.vx, slips.vy) == pytest.approx((-0.4, SPEED_MPS)), "and to the south"
