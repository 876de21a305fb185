"""Lost messages, silent links, crashes and reboots: what was sent is acknowledged, sent again, or given up safely."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import GatesConfig
from edge.journal.records import FixSent, FixWithheld, SourceSetAnswered
from edge.telemetry.encoders import SENSOR_ENABLE
from edge.telemetry.firmware import GPS_SET
from sim.vehicle.estimator import OdometryErrors
from tests.telemetry.positions import AGREES, WRONG, spoofed
from tests.telemetry.rig import OpenRig, Rig

ODOMETRY = ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "VFR_HUD", "WHEEL_DISTANCE")
SET_EKF_SOURCE_SET = mavlink.MAV_CMD_SET_EKF_SOURCE_SET
SELDOM = GatesConfig(min_interval_s=30.0, risk=1.0, min_move_m=0.0)


def loses(*names: str) -> Callable[[Any], bool]:
    return lambda message: message.get_type() in names


def loses_answers(command: int) -> Callable[[Any], bool]:
    return lambda message: message.get_type() == "COMMAND_ACK" and message.command == command


def selections(rig: Rig) -> list[int]:
    return [int(one.param1) for one in rig.received("COMMAND_LONG") if one.command == SET_EKF_SOURCE_SET]


@pytest.fixture
def lost_gps(open_rig: OpenRig) -> Rig:
    """A vehicle that has had GPS, and has none now."""
    rig = open_rig(emit="external_position", gates=SELDOM)
    rig.run(8.0)
    rig.autopilot.gps = False
    rig.run(5.0)
    return rig


@pytest.fixture
def doubted(open_rig: OpenRig) -> Rig:
    """A vehicle whose GPS is wrong, and may be called so, on which the second set of sources is selected."""
    return spoofed(open_rig, "switch")


def test_a_lost_selection_is_sent_again_until_it_is_acknowledged(doubted: Rig) -> None:
    doubted.wire.loses = lambda message: message.get_type() == "COMMAND_LONG" and message.command == SET_EKF_SOURCE_SET
    doubted.judge_gps(WRONG)
    doubted.run(4.0)
    assert doubted.autopilot.inputs.source_set == 1
    doubted.wire.loses = None
    doubted.run(8.0)
    assert doubted.autopilot.inputs.source_set == 2
    assert [(one.number, one.result) for one in doubted.journalled(SourceSetAnswered)] == [
        (2, "NO_ANSWER"),
        (2, "ACCEPTED"),
    ]
    texts = [message.text for message in doubted.received("STATUSTEXT")]
    assert "Lookback: source set 2 NO_ANSWER" in texts


def test_the_set_that_the_pilot_has_selected_stays(doubted: Rig) -> None:
    """Only a set that was selected here is taken back."""
    doubted.autopilot.inputs.source_set = 2
    for _ in range(5):
        doubted.judge_gps(AGREES)
        doubted.run(2.0)
    assert doubted.connection.vehicle.session.gps.receiver_state(doubted.now_ns) == "healthy"
    doubted.connection.close()
    assert not selections(doubted)
    assert doubted.autopilot.inputs.source_set == 2


def test_a_selection_whose_answer_is_lost_is_repeated_with_growing_pauses(doubted: Rig) -> None:
    doubted.wire.loses = loses_answers(SET_EKF_SOURCE_SET)
    doubted.judge_gps(WRONG)
    doubted.run(30.0)
    assert 6 <= selections(doubted).count(2) <= 8
    doubted.wire.loses = None
    doubted.run(20.0)
    before = len(selections(doubted))
    doubted.run(20.0)
    assert len(selections(doubted)) == before, "acknowledged"


def test_sources_are_selected_again_after_a_reboot_of_the_autopilot(doubted: Rig) -> None:
    doubted.judge_gps(WRONG)
    doubted.run(4.0)
    doubted.autopilot.reboot()
    assert doubted.autopilot.inputs.source_set == 1
    doubted.run(8.0)
    assert doubted.autopilot.inputs.source_set == 2


def test_the_first_set_is_restored_at_the_end_if_gps_agrees(doubted: Rig) -> None:
    doubted.judge_gps(WRONG)
    doubted.run(4.0)
    assert doubted.autopilot.inputs.source_set == 2
    doubted.wire.loses = lambda message: message.get_type() == "COMMAND_LONG"
    doubted.judge_gps(AGREES)
    doubted.run(1.0)
    doubted.wire.loses = None
    assert doubted.autopilot.inputs.source_set == 2
    doubted.connection.close()
    doubted.autopilot.step()
    assert doubted.autopilot.inputs.source_set == 1


@pytest.fixture
def doubted_px4(open_rig: OpenRig) -> Rig:
    """The same of a PX4, which keeps what was selected when it reboots, and reports it."""
    return spoofed(open_rig, "switch", firmware="px4", emit="auto", errors=OdometryErrors("velocity sensor"))


def test_what_px4_does_not_report_is_not_selected(doubted_px4: Rig) -> None:
    doubted_px4.wire.loses = loses("ESTIMATOR_SENSOR_FUSION_STATUS")
    doubted_px4.run(5.0)
    doubted_px4.autopilot.received.clear()
    doubted_px4.connection.vehicle.session.gps.is_fusion_on = None
    doubted_px4.judge_gps(WRONG)
    doubted_px4.run(30.0)
    commands = [one for one in doubted_px4.received("COMMAND_LONG") if one.command == SENSOR_ENABLE]
    assert 6 <= len(commands) <= 9
    doubted_px4.wire.loses = None
    doubted_px4.run(5.0)
    assert [one.result for one in doubted_px4.journalled(SourceSetAnswered)] == ["NOT_READ_BACK", "ACCEPTED"]
    texts = [message.text for message in doubted_px4.received("STATUSTEXT")]
    assert "Lookback: PX4 uses GPS, may ignore positions" in texts


def test_gps_is_given_back_to_px4_after_a_crash_and_a_reboot_once_it_agrees(doubted_px4: Rig) -> None:
    doubted_px4.judge_gps(WRONG)
    doubted_px4.run(4.0)
    doubted_px4.crash()
    doubted_px4.autopilot.reboot()
    doubted_px4.connect()
    doubted_px4.run(10.0)
    assert doubted_px4.autopilot.inputs.source_set == 2
    sources, gps = doubted_px4.connection.positions.sources, doubted_px4.connection.vehicle.session.gps
    assert not gps.may_be_fused(is_selected=sources.in_use == GPS_SET)
    doubted_px4.off_m = 0.0
    doubted_px4.judge_gps(AGREES)
    doubted_px4.run(3.0)
    assert doubted_px4.autopilot.inputs.source_set == 1
    assert not doubted_px4.port.with_name("events.sources").exists()


def test_gps_that_the_pilot_took_from_px4_stays_off(doubted_px4: Rig) -> None:
    doubted_px4.autopilot.inputs.source_set = 2
    doubted_px4.run(2.0)
    for verdict in (WRONG, AGREES):
        doubted_px4.judge_gps(verdict)
        doubted_px4.run(5.0)
    assert not [one for one in doubted_px4.received("COMMAND_LONG") if one.command == SENSOR_ENABLE]
    assert not doubted_px4.journalled(SourceSetAnswered)


def test_after_a_crash_the_first_set_is_restored_when_gps_agrees_and_not_before(doubted: Rig) -> None:
    """The next run does not know what GPS is; until a place says so, the vehicle must not follow it."""
    doubted.judge_gps(WRONG)
    doubted.run(4.0)
    doubted.crash()
    doubted.connect()
    doubted.run(10.0)
    assert doubted.connection.vehicle.session.gps.receiver_state(doubted.now_ns) == "healthy"
    assert doubted.autopilot.inputs.source_set == 2
    doubted.connection.restore_sources()
    doubted.run(1.0)
    assert doubted.autopilot.inputs.source_set == 2, "nor at the end"
    doubted.judge_gps(AGREES)
    doubted.run(5.0)
    assert doubted.autopilot.inputs.source_set == 1


def uncertainty_after(rig: Rig, seconds: float) -> float | None:
    rig.run(seconds)
    return rig.bounded_m


@pytest.mark.parametrize("silent_s", [6.0, 60.0])
def test_after_a_silent_link_the_vehicle_is_still_known_and_not_how_well_its_autopilot_is(
    lost_gps: Rig, silent_s: float
) -> None:
    """It may have rebooted, or be another one: it is reset, to where the vehicle can have gone."""
    assert lost_gps.bounded_m is not None
    lost_gps.wire.loses = lambda message: True
    lost_gps.run(silent_s)
    assert lost_gps.connection.state == "waiting"
    lost_gps.wire.loses = None
    assert uncertainty_after(lost_gps, 6.0) is None
    assert lost_gps.send_position(lost_gps.fix())
    assert lost_gps.bounded_m is not None


def test_what_aided_an_autopilot_that_rebooted_in_silence_bounds_nothing(lost_gps: Rig) -> None:
    lost_gps.wire.loses = lambda message: True
    lost_gps.run(3.0)
    lost_gps.autopilot.reboot()
    lost_gps.run(5.0)
    lost_gps.wire.loses = None
    assert uncertainty_after(lost_gps, 8.0) is None


def test_heartbeats_that_alone_are_missing_end_nothing_but_the_mode(lost_gps: Rig) -> None:
    """All else that is known of the vehicle is by messages that still come."""
    vehicle = lost_gps.connection.vehicle
    before = vehicle.motion.displacement(lost_gps.now_ns)
    assert before is not None
    lost_gps.wire.loses = loses("HEARTBEAT")
    lost_gps.run(10.0)
    now = vehicle.motion.displacement(lost_gps.now_ns)
    assert now is not None and (now.odometry_epoch, now.unknown_m) == (before.odometry_epoch, before.unknown_m)
    assert (lost_gps.connection.state, vehicle.drives_itself) == ("up", None)
    assert lost_gps.send_position(lost_gps.fix())
    lost_gps.wire.loses = None
    lost_gps.run(4.0)
    assert vehicle.drives_itself is False and vehicle.session.number == 1


@pytest.mark.parametrize("silent_s", [6.0, 60.0])
def test_heartbeats_alone_are_no_permission(lost_gps: Rig, silent_s: float) -> None:
    """Without speed and GPS nothing is known, so nothing is sent; both are requested until they come."""
    sent = len(lost_gps.journalled(FixSent))
    lost_gps.wire.loses = loses(*ODOMETRY, "GPS_RAW_INT", "GPS2_RAW")
    lost_gps.run(4.0)
    assert not lost_gps.send_position(lost_gps.fix())
    lost_gps.run(silent_s)
    assert lost_gps.connection.state == "up"
    assert not lost_gps.send_position(lost_gps.fix())
    assert len(lost_gps.journalled(FixSent)) == sent
    assert lost_gps.journalled(FixWithheld)[-1].reason == "GPS is unknown: no GPS_RAW_INT"
    lost_gps.wire.loses = None
    lost_gps.run(3.0)
    assert lost_gps.send_position(lost_gps.fix())
