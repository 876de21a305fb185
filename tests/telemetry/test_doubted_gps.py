"""What is done when the places contradict GPS, against a simulated autopilot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import east_north_of
from edge.journal.records import FixSent, FixWithheld, GpsJudged, SourceSetAnswered
from edge.localization import GpsVerdict
from edge.telemetry.encoders import SENSOR_ENABLE
from edge.telemetry.firmware import GPS_SET
from sim.vehicle.estimator import OdometryErrors
from tests.telemetry.positions import AGREES, OFF_M, WRONG, fixes_received, offer_for, spoofed
from tests.telemetry.rig import OpenRig, Rig


def offer(rig: Rig, seconds: float) -> None:
    """Offer a fix of half a second ago whenever one is due; all of them are 60 m apart, as evidence of their own."""

    def once() -> bool:
        if rig.connection.position_due() is not None:
            rig.send_position(rig.fix())
        return False

    rig.run(seconds, once)


def values(rig: Rig, name: str) -> list[float]:
    return [message.value for message in rig.received("NAMED_VALUE_FLOAT") if message.name == name]


def texts(rig: Rig) -> list[str]:
    return [message.text for message in rig.received("STATUSTEXT")]


def test_a_call_is_published_once_and_its_values_each_second(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "report")
    for _ in range(10):
        rig.judge_gps(WRONG)
        rig.run(1.0)
    assert texts(rig).count("Lookback: GPS faulty: 60 m off to the E") == 1
    assert values(rig, "gps_doubt")[-5:] == [1.0] * 5
    assert values(rig, "gps_off")[-5:] == pytest.approx([60.0] * 5)
    assert rig.journalled(GpsJudged) == [GpsJudged("consistent", 0.5, 0.5, 0.0), GpsJudged("faulty", 60.0, 0.0, 1.0)]
    assert rig.connection.gps_fault == "GPS faulty", "without meters, which change with every frame"
    assert rig.connection.status().gps_verdict == "faulty"
    rig.judge_gps(AGREES)
    rig.run(1.0)
    assert texts(rig)[-1] == "Lookback: GPS consistent with the map again"
    assert rig.connection.gps_fault == ""


def test_not_recognized_is_a_warning_and_no_call(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "switch")
    for verdict in (GpsVerdict("not recognized"), GpsVerdict("not recognized"), AGREES):
        rig.judge_gps(verdict)
        rig.run(2.0)
        assert values(rig, "gps_doubt")[-1] <= 0.0
        assert rig.connection.gps_fault == ""
    assert [text for text in texts(rig) if "GPS" in text] == ["Lookback: not recognized where GPS says we are"]
    assert [one.state for one in rig.journalled(GpsJudged)] == ["consistent", "not recognized", "consistent"]


def test_what_cannot_be_said_is_minus_one_and_a_call_is_one(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "report")
    rig.judge_gps(GpsVerdict())
    rig.run(2.0)
    assert values(rig, "gps_doubt")[-1] == -1.0
    rig.judge_gps(WRONG)
    rig.run(2.0)
    assert values(rig, "gps_doubt")[-1] == 1.0


def test_by_default_nothing_else_happens(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "report")
    rig.judge_gps(WRONG)
    offer(rig, 10.0)
    assert rig.autopilot.inputs.source_set == 1
    assert not rig.journalled(FixSent)
    assert rig.journalled(FixWithheld)[-1].reason == "GPS is healthy"
    assert rig.connection.why_no_position == "the autopilot uses it", "the pilot reads that GPS is wrong beside it"


@pytest.mark.parametrize(("source", "sends"), [("velocity sensor", True), ("none", False)])
def test_without_a_velocity_aid_the_pilot_reads_that_nothing_is_sent(
    open_rig: OpenRig, source: Any, sends: bool
) -> None:
    rig = spoofed(open_rig, "send", firmware="px4", errors=OdometryErrors(source))
    rig.judge_gps(WRONG)
    offer(rig, 5.0)
    assert bool(rig.journalled(FixSent)) == sends
    assert ("Lookback: no velocity aid, sends no position" in texts(rig)) != sends
    assert ("Lookback: PX4 uses GPS, may ignore positions" in texts(rig)) == sends


def test_switch_selects_the_second_set_and_positions_move_the_autopilot_back(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "switch")
    assert rig.autopilot.estimate.error_m == pytest.approx(OFF_M, abs=1.0)
    rig.judge_gps(WRONG)
    offer(rig, 12.0)
    assert rig.autopilot.inputs.source_set == 2
    assert rig.autopilot.estimate.error_m < 6.0
    rig.off_m = 0.0
    rig.judge_gps(AGREES)
    rig.run(8.0)
    assert rig.autopilot.inputs.source_set == 1


def test_the_second_set_stays_when_this_program_ends_while_gps_is_wrong(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "switch")
    rig.judge_gps(WRONG)
    rig.run(3.0)
    rig.connection.restore_sources()
    rig.run(1.0)
    assert rig.autopilot.inputs.source_set == 2


def test_send_leaves_the_sources_to_the_script_of_the_autopilot(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "send")
    rig.judge_gps(WRONG)
    offer(rig, 6.0)
    assert rig.autopilot.inputs.source_set == 1
    assert not rig.autopilot.resets, "ArduPilot takes no position while it uses GPS"
    rig.autopilot.has_script = True
    offer(rig, 20.0)
    assert rig.autopilot.estimate.error_m < 6.0


def test_px4_fuses_no_gps_until_it_agrees_and_positions_move_it_back(open_rig: OpenRig) -> None:
    aid = OdometryErrors("velocity sensor")
    rig = spoofed(open_rig, "switch", firmware="px4", emit="auto", errors=aid, gates={"risk": 1.0})
    assert rig.autopilot.estimate.error_m == pytest.approx(OFF_M, abs=1.0)
    rig.judge_gps(WRONG)
    assert offer_for(rig, 12.0) > 40
    assert rig.autopilot.estimate.error_m < 6.0
    gps = rig.connection.vehicle.session.gps
    assert gps.state(rig.now_ns) == "not healthy"
    assert rig.connection.why_no_position == ""
    rig.off_m = 0.0
    rig.judge_gps(AGREES)
    rig.run(5.0)
    assert gps.state(rig.now_ns) == "healthy"
    assert [int(one.param3) for one in rig.received("COMMAND_LONG") if one.command == SENSOR_ENABLE] == [0, 1]
    assert rig.journalled(SourceSetAnswered) == [SourceSetAnswered(2, "ACCEPTED"), SourceSetAnswered(1, "ACCEPTED")]
    assert [text for text in texts(rig) if "fusion" in text or "ignore" in text] == [
        "Lookback: GPS faulty: by places, GPS fusion off",
        "Lookback: GPS works: by GPS, GPS fusion on",
    ]


@pytest.mark.parametrize(("result", "resets"), [(None, (1,)), (mavlink.MAV_RESULT_FAILED, range(6, 9))])
def test_px4_is_reset_beside_a_stream_that_it_ignores(
    open_rig: OpenRig, result: int | None, resets: Sequence[int]
) -> None:
    """The real one ignores it for 7 s and more; this one always. Again while it is far, and when GPS is wrong anew."""
    aid = OdometryErrors("velocity sensor")
    rig = spoofed(open_rig, "switch", firmware="px4", emit="auto", errors=aid, gates={"risk": 1.0})
    rig.autopilot.loses = lambda message, outgoing: message.get_type() == "GLOBAL_POSITION_SENSOR"
    rig.autopilot.reject_fixes_with = result
    rig.judge_gps(WRONG)
    assert offer_for(rig, 12.0) > 40
    assert len(fixes_received(rig)) in resets
    assert (rig.autopilot.estimate.error_m < 6.0) == (result is None)
    assert [one.way for one in rig.journalled(FixSent)].count("external_position") == len(fixes_received(rig))
    for verdict, off_m in ((AGREES, 0.0), (WRONG, OFF_M)):
        rig.off_m, count = off_m, len(fixes_received(rig))
        rig.judge_gps(verdict)
        offer_for(rig, 5.0)
    assert len(fixes_received(rig)) > count


def test_a_px4_that_cannot_leave_its_gps_is_asked_once_and_the_pilot_warned(open_rig: OpenRig) -> None:
    aid = OdometryErrors("velocity sensor")
    options = {"firmware": "px4-1.17", "emit": "global_position_sensor", "gates": {"risk": 1.0}}
    rig = spoofed(open_rig, "switch", errors=aid, **options)
    rig.judge_gps(WRONG)
    assert offer_for(rig, 8.0) > 30
    assert [one.command for one in rig.received("COMMAND_LONG") if one.command in (42007, SENSOR_ENABLE)] == [43006]
    assert [text for text in texts(rig) if "fusion" in text or "ignore" in text] == [
        "Lookback: GPS fusion off UNSUPPORTED",
        "Lookback: PX4 uses GPS, may ignore positions",
    ]
    sources, gps = rig.connection.positions.sources, rig.connection.vehicle.session.gps
    assert gps.may_be_fused(is_selected=sources.in_use == GPS_SET)


def test_nothing_is_switched_where_no_positions_are_sent(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "switch", emit="report")
    rig.judge_gps(WRONG)
    rig.run(5.0)
    assert rig.autopilot.inputs.source_set == 1


def test_gps_is_that_of_the_filter_or_else_of_the_receiver(open_rig: OpenRig) -> None:
    rig = spoofed(open_rig, "switch")
    for expected in (1, 2):
        assert rig.autopilot.inputs.source_set == expected
        gps = rig.gps_fix
        assert gps is not None
        at = rig.autopilot._pose.geodetic()
        east_m, north_m = east_north_of(gps.lat_deg, gps.lon_deg, at)
        assert (east_m, north_m) == pytest.approx((OFF_M, 0.0), abs=5.0)
        rig.judge_gps(WRONG)
        rig.run(5.0)
    rig.autopilot.gps = False
    rig.run(5.0)
    assert rig.gps_fix is None
