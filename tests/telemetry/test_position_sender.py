"""Positions against the firmware that the table in sim/firmware.py knows: ways, answers, refusals, streams."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import pytest
from pymavlink.dialects.v20 import common as mavlink

from edge.config import GatesConfig
from edge.journal.records import FixAnswered, FixChecked, FixSent, FixWithheld, PositionMessageChosen
from edge.telemetry import stream_check
from edge.telemetry.encoders import UNBOUNDED_M
from edge.telemetry.velocity_aid import UNAIDED_M
from sim.vehicle.autopilot import SILENT

Rig: TypeAlias = Any  # of conftest.py, which is not a module for type checkers
OpenRig: TypeAlias = Callable[..., Any]
OFTEN = GatesConfig(with_gps=True, min_interval_s=0.1, risk=1.0)


def fixes_received(rig: Rig) -> list[Any]:
    return [message for message in rig.received("COMMAND_INT") if message.command == 43003]


def offer_for(rig: Rig, seconds: float, **changes: Any) -> int:
    """Offer a fix of half a second ago, or of now, whenever one is wanted; how many went."""
    sent = 0

    def offer() -> bool:
        nonlocal sent
        moment = rig.connection.position_due()
        if moment is not None:
            sent += rig.connection.send_position(rig.fix(age_s=0.0 if moment == "now" else 0.5, **changes))
        return False

    rig.run(seconds, offer)
    return sent


@pytest.mark.parametrize(
    ("firmware", "way", "why"),
    [
        ("ardupilot", "external_position", "ArduPilot 4.6 takes external_position"),
        ("px4", "global_position_sensor", "PX4 1.18 takes global_position_sensor"),
        ("px4-1.17", "external_position", "PX4 1.17 takes external_position"),
        ("px4-1.15", "external_position", "PX4 1.15 takes external_position"),
    ],
)
def test_auto_picks_what_the_firmware_takes_and_says_so(open_rig: OpenRig, firmware: str, way: str, why: str) -> None:
    rig = open_rig(emit="auto", firmware=firmware)
    rig.run(5.0)
    assert rig.journalled(PositionMessageChosen)[-1] == PositionMessageChosen(way, why)
    assert f"Lookback: {why}" in [message.text for message in rig.received("STATUSTEXT")]


@pytest.mark.parametrize(("firmware", "answer"), [("ardupilot", "FAILED"), ("px4-1.16", "TEMPORARILY_REJECTED")])
def test_not_now_is_tried_less_and_less_often_and_quietly(open_rig: OpenRig, firmware: str, answer: str) -> None:
    rig = open_rig(emit="external_position", gates=OFTEN, firmware=firmware, gps=True)
    rig.run(4.0)
    offer_for(rig, 30.0)
    assert len(fixes_received(rig)) == 5, "pauses of 1, 2, 4, 8 and 16 s"
    assert {record.result for record in rig.journalled(FixAnswered)} == {answer}
    assert not rig.received("STATUSTEXT")
    rig.autopilot.gps = False
    offer_for(rig, 20.0)
    assert rig.journalled(FixAnswered)[-1].result == "ACCEPTED"
    assert rig.autopilot.resets


def test_a_fix_without_an_answer_is_tried_once_more_with_its_true_age(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=GatesConfig(min_interval_s=30.0, risk=1.0), gps=False)
    rig.run(4.0)
    rig.autopilot.reject_fixes_with = SILENT
    assert rig.connection.send_position(rig.fix(age_s=0.5))
    rig.run(5.0)
    first, second = fixes_received(rig)
    assert (second.x, second.y) == (first.x, first.y)
    assert second.param1 - second.param2 == pytest.approx(first.param1 - first.param2, abs=0.02), "the same exposure"
    assert second.param2 == pytest.approx(1.5, abs=0.05)
    assert [record.again for record in rig.journalled(FixSent)] == [False, True]
    assert [record.result for record in rig.journalled(FixAnswered)] == ["NO_ANSWER"]


def test_px4_1_15_never_answers_and_is_told_nevertheless(open_rig: OpenRig) -> None:
    rig = open_rig(emit="auto", gates=OFTEN, firmware="px4-1.15", gps=False, drift_percent=3.0)
    rig.run(10.0)
    offer_for(rig, 10.0)
    assert len(rig.autopilot.resets) >= 6
    assert rig.autopilot.resets[-1].error_after_m < 1.0


def test_accepted_and_moved(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gps=False, drift_percent=8.0)
    rig.run(30.0)
    assert rig.connection.send_position(rig.fix())
    rig.run(3.0)
    (checked,) = rig.journalled(FixChecked)
    assert checked.moved
    assert checked.remaining_m < 2.0


def test_accepted_by_a_filter_that_is_not_in_use_is_noticed(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=OFTEN, firmware="ardupilot-plain", drift_percent=20.0)
    rig.run(4.0)
    rig.autopilot.gps = False
    rig.run(12.0)  # the filter still aids, but the vehicle flies on DCM
    assert rig.connection.send_position(rig.fix())
    rig.run(3.0)
    (answered,) = rig.journalled(FixAnswered)
    (checked,) = rig.journalled(FixChecked)
    assert answered.result == "ACCEPTED"
    assert not checked.moved
    assert any("fix accepted, position" in message.text for message in rig.received("STATUSTEXT"))
    rig.run(10.0)
    offer_for(rig, 6.0)
    assert {record.result for record in rig.journalled(FixAnswered)[1:]} == {"FAILED"}, "it has stopped aiding"


def test_a_fix_beyond_reason_is_held_back_and_told_once(open_rig: OpenRig) -> None:
    gates = GatesConfig(min_interval_s=0.5)
    rig = open_rig(emit="external_position", gates=gates)
    rig.run(4.0)
    rig.autopilot.gps = False
    rig.run(5.0)
    offer_for(rig, 5.0, lat_deg=-27.48, matches=500)
    assert not fixes_received(rig)
    (withheld,) = rig.journalled(FixWithheld)
    assert withheld.reason == "impossibly far"
    assert withheld.distance_m > 200
    texts = [message.text for message in rig.received("STATUSTEXT")]
    assert len([text for text in texts if "not sent" in text]) == 1
    assert offer_for(rig, 2.0) >= 2, "a good one goes at once"


def test_nothing_goes_while_gps_is_healthy_and_fixes_go_when_it_is_lost(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=GatesConfig())
    rig.run(4.0)
    assert offer_for(rig, 5.0) == 0
    rig.autopilot.gps = False
    assert offer_for(rig, 8.0) >= 4
    assert [record.reason for record in rig.journalled(FixWithheld)] == ["GPS is healthy"]


def protection_sent(rig: Rig) -> dict[str, float]:
    """The newest of each direction."""
    values = {message.name: message.value for message in rig.received("NAMED_VALUE_FLOAT")}
    return {name: value for name, value in values.items() if name.startswith("pl_")}


def test_the_protection_level_of_one_stretch_grows_with_the_distance_from_gps(open_rig: OpenRig) -> None:
    """It stays the same stretch of the map: only GPS and the velocity since bound it if that is wrong."""
    rig = open_rig(emit="auto", gates=GatesConfig(min_interval_s=0.5, risk_per_hour=0.01), gps=True)
    rig.run(9.0)
    rig.autopilot.gps = False
    offer_for(rig, 3.0)
    first = rig.journalled(FixSent)[-1]
    assert first.level_along_m is not None and first.level_across_m is not None
    assert first.sigma_m < first.level_along_m < 60.0
    status = rig.connection.status()
    assert (status.level_along_m, status.sent_sigma_m) == (first.level_along_m, pytest.approx(first.sigma_m, abs=0.01))
    assert protection_sent(rig)["pl_along"] == pytest.approx(first.level_along_m, abs=0.01)
    offer_for(rig, 60.0)
    last = rig.journalled(FixSent)[-1]
    assert last.level_along_m is not None and last.level_along_m > first.level_along_m + 10.0


def test_a_position_that_nothing_bounds_at_the_risk_has_no_protection_level(open_rig: OpenRig) -> None:
    """One stretch alone, at a thousandth an hour."""
    rig = open_rig(emit="auto", gates=GatesConfig(min_interval_s=0.5, risk_per_hour=1e-3), gps=True)
    rig.run(9.0)
    rig.autopilot.gps = False
    assert offer_for(rig, 3.0)
    assert rig.journalled(FixSent)[-1].level_along_m is None
    assert rig.connection.status().level_along_m is None
    assert protection_sent(rig) == {"pl_along": UNBOUNDED_M, "pl_across": UNBOUNDED_M}


@pytest.mark.parametrize(("vision", "certain"), [(4.0, True), (0.0, False)])
def test_a_position_is_less_certain_where_nothing_measures_the_velocity(
    open_rig: OpenRig, vision: float, certain: bool
) -> None:
    rig = open_rig(emit="external_position", gates=OFTEN, firmware="px4", gps=False)
    rig.autopilot.parameters = {"EKF2_EV_CTRL": (vision, mavlink.MAV_PARAM_TYPE_REAL32)}
    rig.run(8.0)
    offer_for(rig, 2.0)
    sigma_m, stated_m = fixes_received(rig)[0].param3, rig.fix().sigma_m
    assert (sigma_m == pytest.approx(stated_m, rel=1e-3)) is certain
    assert sigma_m == pytest.approx(math.hypot(stated_m, 0.0 if certain else math.sqrt(2) * UNAIDED_M), rel=1e-3)


def test_above_the_alert_limit_nothing_is_sent(open_rig: OpenRig) -> None:
    rig = open_rig(emit="auto", gates=GatesConfig(min_interval_s=0.5, alert_limit_m=5.0), gps=True)
    rig.run(9.0)
    rig.autopilot.gps = False
    assert offer_for(rig, 6.0) == 0
    assert rig.journalled(FixWithheld)[-1].reason == "its protection level is above the alert limit"
    assert not fixes_received(rig)


def test_every_line_about_a_fix_says_which_of_several_maps(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=GatesConfig(min_interval_s=0.5))
    rig.run(4.0)
    offer_for(rig, 2.0, map="tile-3")
    rig.autopilot.gps = False
    offer_for(rig, 8.0, map="tile-3")
    for kind in (FixWithheld, FixSent, FixAnswered):
        assert {record.map for record in rig.journalled(kind)} == {"tile-3"}, kind


def test_px4_is_told_five_times_a_second_and_follows(open_rig: OpenRig) -> None:
    rig = open_rig(emit="auto", gates=GatesConfig(), firmware="px4", drift_percent=5.0)
    rig.run(5.0)
    rig.autopilot.gps = False
    rig.run(30.0)
    assert rig.autopilot.estimate.error_m > 7
    before = len(rig.received("GLOBAL_POSITION_SENSOR"))
    offer_for(rig, 10.0)
    messages = rig.received("GLOBAL_POSITION_SENSOR")[before:]
    assert len(messages) == pytest.approx(50, abs=3)
    assert len(rig.autopilot.inputs.fused) >= 45
    assert not rig.received("COMMAND_INT")
    assert len(rig.journalled(FixSent)) <= 11, "one a second is recorded"


@pytest.mark.parametrize("ignored", [False, True])
def test_a_stream_that_nobody_uses_is_noticed(open_rig: OpenRig, ignored: bool) -> None:
    """An autopilot without the parameters for it reads the message and does nothing."""
    rig = open_rig(emit="global_position_sensor", gates=OFTEN, firmware="px4-1.17" if ignored else "px4")
    rig.run(5.0)
    rig.autopilot.gps = False
    rig.run(40.0)  # its own position is uncertain by now

    def offer() -> bool:
        if rig.connection.position_due() is not None:
            rig.connection.send_position(rig.fix(age_s=0.0, lat_deg=rig.fix(age_s=0.0).lat_deg + 25 / 111_000))
        return False

    rig.run(15.0, offer)
    texts = [message.text for message in rig.received("STATUSTEXT") if "fixes sent, position" in message.text]
    assert len(texts) == ignored
    (checked,) = rig.journalled(FixChecked)
    assert checked.moved is not ignored


@pytest.mark.parametrize(
    ("control", "sensor_id", "why"), [(0, 0, "EKF2_AGP0_CTRL is 0"), (1, 2, "EKF2_AGP0_ID is 2"), (1, 1, "")]
)
def test_parameters_that_ignore_positions_are_named_with_the_first_one(
    open_rig: OpenRig, control: int, sensor_id: int, why: str
) -> None:
    rig = open_rig(emit="auto", gates=OFTEN, firmware="px4")
    values = {"EKF2_EV_CTRL": 4.0, stream_check.CONTROL: float(control), stream_check.ID: float(sensor_id)}
    rig.autopilot.parameters = {name: (value, mavlink.MAV_PARAM_TYPE_REAL32) for name, value in values.items()}
    rig.run(8.0)
    rig.autopilot.gps = False
    rig.run(8.0)
    offer_for(rig, 3.0)
    said = [message.text for message in rig.received("STATUSTEXT") if "unused" in message.text]
    assert said == ([f"Lookback: positions unused: {why}"] if why else [])


@pytest.mark.parametrize(("firmware", "emit"), [("ardupilot", "external_position"), ("px4", "global_position_sensor")])
def test_a_reset_never_makes_a_position_less_accurate(open_rig: OpenRig, firmware: str, emit: str) -> None:
    """GPS has just gone, and the map is known to 28 m in each direction; a filter that weighs it may have it."""
    rig = open_rig(emit=emit, gates=GatesConfig(risk=1.0), firmware=firmware)
    rig.run(6.0)
    rig.autopilot.gps = False
    rig.run(10.0)
    uncertain = {"age_s": 0.0, "sigma_along_m": 28.3, "sigma_across_m": 28.3}
    assert rig.connection.send_position(rig.fix(**uncertain)) == (firmware == "px4")
    reasons = [record.reason for record in rig.journalled(FixWithheld)]
    assert reasons == ["less accurate than the autopilot"] * (firmware == "ardupilot")
    rig.run(120.0)  # by now it is uncertain by more than that
    own = rig.connection.position()
    assert rig.connection.send_position(rig.fix(**uncertain, lat_deg=own.lat_deg, lon_deg=own.lon_deg))


def test_vision_waits_for_an_origin_chooses_its_sources_and_leaves_them_to_gps(open_rig: OpenRig) -> None:
    rig = open_rig(emit="vision_position", gates=GatesConfig(), drift_percent=5.0)
    rig.run(6.0)
    rig.autopilot.gps = False
    rig.run(20.0)
    offer_for(rig, 6.0)
    assert rig.autopilot.inputs.source_set == 2
    assert len(rig.autopilot.inputs.fused) >= 25
    assert len(rig.received("VISION_POSITION_ESTIMATE")) == pytest.approx(30, abs=3)
    rig.autopilot.gps = True
    rig.run(8.0)
    assert rig.autopilot.inputs.source_set == 1


def test_a_vision_stream_that_begins_far_off_says_that_it_jumps(open_rig: OpenRig) -> None:
    gates = GatesConfig(max_move_m=10_000.0, risk=1.0)
    rig = open_rig(emit="vision_position", gates=gates)
    rig.run(6.0)
    rig.autopilot.gps = False
    offer_for(rig, 6.0)
    rig.run(5.0)
    offer_for(rig, 4.0, lat_deg=-27.47)
    counters = [message.reset_counter for message in rig.received("VISION_POSITION_ESTIMATE")]
    assert len(set(counters)) == 2
    assert counters == sorted(counters)
    assert rig.autopilot.resets


def test_without_an_origin_ours_is_set_once_and_fixes_are_then_taken(open_rig: OpenRig) -> None:
    origin = (-27.4772, 153.0283, 20.0)
    rig = open_rig(emit="external_position", gps=False, has_origin=False, config={"origin": origin})
    rig.run(4.0)
    assert rig.connection.vehicle.position(rig.now_ns) is None, "zeros are nowhere"
    assert rig.connection.vehicle.origin is None
    rig.run(8.0)
    (message,) = rig.received("SET_GPS_GLOBAL_ORIGIN")
    assert (message.latitude, message.longitude, message.altitude) == (-274772000, 1530283000, 20000)
    assert rig.connection.vehicle.origin is not None
    assert rig.connection.send_position(rig.fix())
    rig.run(1.0)
    assert rig.journalled(FixAnswered)[-1].result == "ACCEPTED"
    assert rig.autopilot.resets[-1].error_after_m < 1.0


def test_an_origin_that_is_there_is_left_alone(open_rig: OpenRig) -> None:
    rig = open_rig(config={"origin": (1.0, 2.0, 3.0)})
    rig.run(12.0)
    assert rig.connection.vehicle.origin is not None
    assert rig.connection.vehicle.origin.lat_deg == pytest.approx(-27.4772)
    assert not rig.received("SET_GPS_GLOBAL_ORIGIN")


def test_in_progress_is_no_answer_yet(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gps=False)
    rig.run(4.0)
    rig.autopilot.reject_fixes_with = mavlink.MAV_RESULT_IN_PROGRESS
    assert rig.connection.send_position(rig.fix())
    rig.run(0.5)
    assert not rig.journalled(FixAnswered)


def test_an_exposure_is_told_once(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=OFTEN, gps=False)
    rig.run(4.0)
    fix = rig.fix()
    assert rig.connection.send_position(fix)
    rig.run(0.5)
    assert rig.connection.position_due() == "exposure"
    assert not rig.connection.send_position(fix)
    rig.run(0.5)
    assert len(fixes_received(rig)) == 1


def test_sources_are_not_chosen_for_a_position_that_cannot_be_told(open_rig: OpenRig) -> None:
    rig = open_rig(emit="vision_position", gates=OFTEN, gps=False, has_origin=False)
    rig.run(4.0)
    assert not rig.connection.send_position(rig.fix(age_s=0.0))
    rig.run(0.5)
    assert rig.autopilot.inputs.source_set == 1
    assert not rig.received("VISION_POSITION_ESTIMATE")


@pytest.mark.parametrize("claimed_off_m", [0.0, 300.0])
def test_without_gps_from_boot_the_first_fix_waits_for_another_place(open_rig: OpenRig, claimed_off_m: float) -> None:
    """A drive of the map near the start, then none, then another 100 m on; the first may claim to be elsewhere."""
    rig = open_rig(emit="external_position", gates=GatesConfig(), gps=False, drift_percent=3.0)
    rig.run(4.0)
    off_deg = claimed_off_m / 111_000
    assert not offer_for(rig, 6.0, lat_deg=rig.fix().lat_deg + off_deg)
    reason = "impossibly far" if claimed_off_m else "not confirmed by another place yet"
    assert [record.reason for record in rig.journalled(FixWithheld)] == [reason]
    rig.run(10.0)
    sent = offer_for(rig, 6.0, segment=1)
    if claimed_off_m:
        assert not sent
        rig.run(10.0)
        sent = offer_for(rig, 6.0, segment=2)
    assert sent
    assert rig.autopilot.resets
    assert max(reset.error_after_m for reset in rig.autopilot.resets) < 5.0
