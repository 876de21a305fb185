"""Positions against the firmware that the table in sim/vehicle/firmware.py knows: ways, answers, refusals, streams."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import GatesConfig
from edge.journal.records import (
    FixAnswered,
    FixChecked,
    FixSent,
    FixWithheld,
    PositionMessageChosen,
)
from edge.localization import distance_from
from edge.telemetry.encoders import UNBOUNDED_M
from sim.vehicle.autopilot import SILENT
from sim.vehicle.estimator import OdometryErrors
from tests.telemetry.positions import fixes_received, offer_for
from tests.telemetry.rig import LENIENT, OpenRig, Rig


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
    rig = open_rig(emit="external_position", gates=LENIENT, firmware=firmware, gps=True)
    rig.run(4.0)
    offer_for(rig, 30.0)
    assert len(fixes_received(rig)) == 5, "pauses of 1, 2, 4, 8 and 16 s"
    assert {record.result for record in rig.journalled(FixAnswered)} == {answer}
    assert not rig.received("STATUSTEXT")
    rig.autopilot.gps = False
    offer_for(rig, 20.0)
    assert rig.journalled(FixAnswered)[-1].result == "ACCEPTED"
    assert rig.autopilot.resets


def test_a_fix_without_an_answer_is_over_after_a_second_and_the_next_one_goes(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=LENIENT, gps=False)
    rig.run(4.0)
    rig.autopilot.reject_fixes_with = SILENT
    assert rig.send_position(rig.fix())
    rig.run(0.9)
    assert not rig.journalled(FixAnswered) and not rig.send_position(rig.fix())
    rig.run(0.2)
    assert [record.result for record in rig.journalled(FixAnswered)] == ["NO_ANSWER"]
    assert rig.send_position(rig.fix())
    rig.run(0.1)
    assert len(fixes_received(rig)) == 2


def test_px4_1_15_never_answers_and_gets_positions_nevertheless(open_rig: OpenRig) -> None:
    rig = open_rig(emit="auto", gates=LENIENT, firmware="px4-1.15", gps=False, drift_percent=3.0)
    rig.run(10.0)
    offer_for(rig, 10.0)
    assert len(rig.autopilot.resets) >= 6
    assert rig.autopilot.resets[-1].error_after_m < 1.0


def test_accepted_and_moved(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gps=False, drift_percent=8.0)
    rig.run(30.0)
    offer_for(rig, 4.0)
    (checked,) = rig.journalled(FixChecked)
    assert checked.moved
    assert checked.remaining_m < 2.0


def test_accepted_by_a_filter_that_is_not_in_use_is_noticed(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=LENIENT, firmware="ardupilot-plain", drift_percent=20.0)
    rig.run(4.0)
    rig.autopilot.gps = False
    rig.run(9.0)  # the filter still aids, but the vehicle flies on DCM
    offer_for(rig, 4.0)
    answered = rig.journalled(FixAnswered)
    (checked,) = rig.journalled(FixChecked)
    assert {record.result for record in answered} == {"ACCEPTED"}
    assert not checked.moved
    assert any("fixes sent, position" in message.text for message in rig.received("STATUSTEXT"))
    rig.run(10.0)
    offer_for(rig, 6.0)
    later = rig.journalled(FixAnswered)[len(answered) :]
    assert {record.result for record in later} == {"FAILED"}, "it has stopped aiding"


def test_a_fix_beyond_reason_is_withheld_and_reported_once(open_rig: OpenRig) -> None:
    gates = GatesConfig(min_interval_s=0.5, min_move_m=0.0)
    rig = open_rig(emit="external_position", gates=gates)
    rig.run(4.0)
    rig.autopilot.gps = False
    rig.run(5.0)
    offer_for(rig, 5.0, lat_deg=-27.48, matches=500)
    assert not fixes_received(rig)
    (withheld,) = rig.journalled(FixWithheld)
    assert withheld.reason == "impossibly far"
    assert withheld.distance_m is not None and withheld.distance_m > 200
    why = [rig.connection.why_no_position]
    assert offer_for(rig, 2.0) >= 2, "a good one goes at once"
    why.append(rig.connection.why_no_position)
    rig.run(11.0)
    why.append(rig.connection.why_no_position)
    assert why == ["impossibly far", "", "the places do not agree yet"]


def test_nothing_goes_while_gps_is_healthy_and_fixes_go_when_it_is_lost(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=GatesConfig(min_move_m=0.0))
    rig.run(4.0)
    assert offer_for(rig, 5.0) == 0
    rig.autopilot.gps = False
    assert offer_for(rig, 8.0) >= 4
    assert [record.reason for record in rig.journalled(FixWithheld)] == ["GPS is healthy"]


@pytest.mark.parametrize(("drift_percent", "is_reset"), [(1.0, False), (20.0, True)])
def test_an_autopilot_is_reset_only_where_it_is_off(open_rig: OpenRig, drift_percent: float, is_reset: bool) -> None:
    rig = open_rig(emit="external_position", gates=GatesConfig(risk=1.0), drift_percent=drift_percent)
    rig.run(4.0)
    rig.autopilot.gps = False
    rig.run(2.0)
    assert (offer_for(rig, 30.0) > 0) is is_reset
    assert bool(fixes_received(rig)) is is_reset
    assert {one.reason for one in rig.journalled(FixWithheld)} == {"no reset is needed"}
    assert (rig.connection.why_no_position == "no reset is needed") is not is_reset
    least_m = min(rig.fix().sigma_along_m, rig.fix().sigma_cross_track_m) * 3
    assert all(one.distance_m is not None and one.distance_m > least_m for one in rig.journalled(FixSent))


def test_nothing_is_sent_to_an_autopilot_whose_clock_is_not_known(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position")
    rig.run(4.0)
    assert rig.send_position(rig.fix())
    rig.run(2.0)
    rig.wire.loses = lambda message: True
    rig.run(0.5)
    assert not rig.send_position(rig.fix())
    rig.wire.loses = None
    rig.run(0.2)
    assert rig.send_position(rig.fix())
    assert [record.reason for record in rig.journalled(FixWithheld)] == ["the autopilot's clock is not known"]


def protection_sent(rig: Rig) -> dict[str, float]:
    """The newest of each direction."""
    values = {message.name: message.value for message in rig.received("NAMED_VALUE_FLOAT")}
    return {name: value for name, value in values.items() if name.startswith("pl_")}


def test_the_protection_level_of_one_stretch_grows_with_the_distance_from_gps(open_rig: OpenRig) -> None:
    """It stays the same stretch of the map: only GPS and the velocity since bound it if that is wrong."""
    rig = open_rig(emit="auto", gates=GatesConfig(min_interval_s=0.5, risk_per_hour=0.01, min_move_m=0.0), gps=True)
    rig.run(9.0)
    rig.autopilot.gps = False
    offer_for(rig, 3.0)
    first = rig.journalled(FixSent)[-1]
    assert first.level_along_m is not None and first.level_cross_track_m is not None
    assert first.sigma_m < first.level_along_m < 60.0
    status = rig.connection.status()
    assert status.level_along_m == first.level_along_m
    assert status.sent_sigma_m == pytest.approx(first.sigma_m, abs=0.01)
    assert protection_sent(rig)["pl_along"] == pytest.approx(first.level_along_m, abs=0.01)
    offer_for(rig, 60.0)
    last = rig.journalled(FixSent)[-1]
    assert last.level_along_m is not None and last.level_along_m > first.level_along_m + 10.0


def test_a_position_that_nothing_bounds_at_the_risk_has_no_protection_level(open_rig: OpenRig) -> None:
    """One stretch alone, at a ten-thousandth an hour."""
    rig = open_rig(emit="auto", gates=GatesConfig(min_interval_s=0.5, risk_per_hour=1e-4, min_move_m=0.0), gps=True)
    rig.run(9.0)
    rig.autopilot.gps = False
    assert offer_for(rig, 3.0)
    assert rig.journalled(FixSent)[-1].level_along_m is None
    assert rig.connection.status().level_along_m is None
    assert protection_sent(rig) == {"pl_along": UNBOUNDED_M, "pl_across": UNBOUNDED_M}


@pytest.mark.parametrize("firmware", ["px4", "px4-1.17", "ardupilot"])
def test_a_position_that_px4_1_18_weighs_too_little_is_noticed_and_sent_as_it_is(
    open_rig: OpenRig, firmware: str
) -> None:
    """Though the next one comes each second. Its velocity is a tenth too large, which its filter does not know."""
    errors = OdometryErrors("wheels" if firmware == "ardupilot" else "velocity sensor", 1.1)
    gates = GatesConfig(with_gps=True, min_interval_s=1.0, risk=1.0, min_move_m=0.0)
    rig = open_rig(emit="external_position", gates=gates, firmware=firmware, errors=errors)
    rig.autopilot.parameters = {"EKF2_EV_CTRL": (4.0, mavlink.MAV_PARAM_TYPE_REAL32)}
    rig.run(9.0)
    rig.autopilot.gps = False
    rig.run(12.0)
    offer_for(rig, 20.0)
    was_ignored = [not checked.moved for checked in rig.journalled(FixChecked)]
    assert any(was_ignored) == (firmware == "px4")
    assert (rig.autopilot.estimate.error_m < 6.0) == (firmware != "px4")
    sigmas_m = [sent.sigma_m for sent in rig.journalled(FixSent)]
    assert set(sigmas_m) == {rig.fix().sigma_m}, "the position's own"
    assert [message.param3 for message in fixes_received(rig)] == pytest.approx(sigmas_m, rel=1e-6)


def see_road(rig: Rig) -> None:
    """The camera measures the speed of a vehicle that drives at 8 m/s, ten times a second."""
    rig.connection.vehicle.velocity.use_speed(rig.now_ns, 8.0)


def unaided(open_rig: OpenRig, vision: float | None = 0.0, emit: str = "external_position") -> Rig:
    """PX4 12 s after it has lost GPS, whose velocity runs away, with its EKF2_EV_CTRL; None: it answers no request."""
    errors = OdometryErrors("none", acceleration_mps2=3.0)
    rig = open_rig(emit=emit, gates=GatesConfig(min_interval_s=0.5, min_move_m=0.0), firmware="px4", errors=errors)
    answers = {} if vision is None else {"EKF2_EV_CTRL": (vision, mavlink.MAV_PARAM_TYPE_REAL32)}
    rig.autopilot.parameters = answers
    rig.run(9.0)
    rig.autopilot.gps = False
    for _ in range(120):
        rig.run(0.1)
        see_road(rig)
    assert distance_from(rig.position, rig.fix()) > 80.0
    return rig


def test_what_runs_away_does_not_speak_against_a_position(open_rig: OpenRig) -> None:
    """It is compared with where the vehicle is by GPS, and by what the camera measured since."""
    rig = unaided(open_rig)
    assert rig.bounded_m is None
    assert offer_for(rig, 1.0)
    rig.run(1.0)
    assert rig.journalled(FixAnswered)[-1].result == "ACCEPTED"
    assert rig.bounded_m is None, "our own position, which that velocity carries away, bounds nothing"


def test_each_of_a_stream_says_less_where_nothing_but_the_stream_aids_the_velocity(open_rig: OpenRig) -> None:
    """At 8 m/s and 5 Hz, 37.5 messages share one error: together they say what one does."""
    rig = unaided(open_rig, emit="global_position_sensor")
    assert offer_for(rig, 0.9)
    sigmas_m = [one.eph for one in rig.received("GLOBAL_POSITION_SENSOR")]
    assert sigmas_m == pytest.approx([math.sqrt(37.5) * rig.fix().sigma_m] * len(sigmas_m), rel=0.02)


def test_a_position_is_not_sent_that_is_far_from_where_the_vehicle_is_by_the_camera(open_rig: OpenRig) -> None:
    rig = unaided(open_rig)
    own = rig.position
    assert offer_for(rig, 0.9, lat_deg=own.lat_deg, lon_deg=own.lon_deg) == 0
    assert rig.journalled(FixWithheld)[-1].reason == "impossibly far"


@pytest.mark.parametrize(
    ("vision", "warning"),
    [
        (0.0, "Lookback: the autopilot has no velocity aid"),
        (None, "Lookback: velocity aid not known, assuming none"),
        (4.0, None),
    ],
)
def test_where_nothing_is_known_to_measure_the_velocity_no_position_is_sent(
    open_rig: OpenRig, vision: float | None, warning: str | None
) -> None:
    rig = unaided(open_rig, vision)
    said = [message.text for message in rig.received("STATUSTEXT") if "velocity" in message.text]
    assert said == ([warning] if warning else [])
    rig.run(8.0)
    assert (rig.connection.vehicle.motion.distance_m(rig.now_ns) is None) == (warning is not None)
    if warning:
        assert rig.bounded_m is None
        assert offer_for(rig, 3.0) == 0
        assert rig.journalled(FixWithheld)[-1].reason == "the speed is not known"


def test_with_a_velocity_aid_a_position_is_compared_with_the_autopilots_own(open_rig: OpenRig) -> None:
    rig = unaided(open_rig, vision=4.0)
    assert rig.bounded_m is not None
    assert offer_for(rig, 3.0) == 0
    assert rig.journalled(FixWithheld)[-1].reason == "impossibly far"


def test_above_the_alert_limit_nothing_is_sent(open_rig: OpenRig) -> None:
    rig = open_rig(emit="auto", gates=GatesConfig(min_interval_s=0.5, alert_limit_m=5.0, min_move_m=0.0), gps=True)
    rig.run(9.0)
    rig.autopilot.gps = False
    assert offer_for(rig, 6.0) == 0
    assert rig.journalled(FixWithheld)[-1].reason == "its protection level is above the alert limit"
    assert not fixes_received(rig)


def test_every_line_about_a_fix_says_which_of_several_maps(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=GatesConfig(min_interval_s=0.5, min_move_m=0.0))
    rig.run(4.0)
    offer_for(rig, 2.0, map="tile-3")
    rig.autopilot.gps = False
    offer_for(rig, 8.0, map="tile-3")
    kinds: tuple[type[FixWithheld | FixSent | FixAnswered], ...] = FixWithheld, FixSent, FixAnswered
    for kind in kinds:
        assert {record.map for record in rig.journalled(kind)} == {"tile-3"}, kind


def test_in_progress_is_no_answer_yet(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gps=False)
    rig.run(4.0)
    rig.autopilot.reject_fixes_with = mavlink.MAV_RESULT_IN_PROGRESS
    assert rig.send_position(rig.fix())
    rig.run(0.5)
    assert not rig.journalled(FixAnswered)


def test_an_exposure_is_published_once(open_rig: OpenRig) -> None:
    rig = open_rig(emit="external_position", gates=LENIENT, gps=False)
    rig.run(4.0)
    fix = rig.fix()
    assert rig.send_position(fix)
    rig.run(0.5)
    limits = rig.connection.position_due()
    assert limits is not None
    assert limits.at == "exposure"
    assert not rig.send_position(fix)
    rig.run(0.5)
    assert len(fixes_received(rig)) == 1


@pytest.mark.parametrize("age_s", [1.9, 2.1])
def test_a_reset_is_of_a_picture_of_the_last_two_seconds(open_rig: OpenRig, age_s: float) -> None:
    """The autopilot goes on by its present velocity over a position's age, also in a bend."""
    rig = open_rig(emit="external_position", gates=LENIENT, gps=False)
    rig.run(10.0)
    assert rig.send_position(rig.fix(age_s=age_s)) == (age_s < 2)
    assert [one.reason for one in rig.journalled(FixWithheld)] == (["too old"] if age_s > 2 else [])


@pytest.mark.parametrize("claimed_off_m", [0.0, 300.0])
def test_without_gps_from_boot_the_first_fix_waits_for_another_place(open_rig: OpenRig, claimed_off_m: float) -> None:
    """A recording near the start, then none, then another one 150 m on; the first may claim to be elsewhere."""
    rig = open_rig(emit="external_position", gates=GatesConfig(min_move_m=0.0), gps=False, drift_percent=3.0)
    rig.run(4.0)
    off_deg = claimed_off_m / 111_000
    assert not offer_for(rig, 6.0, lat_deg=rig.true_position()[0] + off_deg)
    assert [record.reason for record in rig.journalled(FixWithheld)] == ["not confirmed by another place yet"]
    rig.run(16.0)
    sent = offer_for(rig, 6.0, recording="second")
    if claimed_off_m:
        assert not sent
        rig.run(16.0)
        sent = offer_for(rig, 6.0, recording="third")
    assert sent
    assert rig.autopilot.resets
    assert max(reset.error_after_m for reset in rig.autopilot.resets) < 5.0
