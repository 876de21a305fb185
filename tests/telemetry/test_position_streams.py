"""Streams of positions, the sources that they need, and whether the autopilot uses them."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import GatesConfig
from edge.geodesy import east_north_of, moved
from edge.journal.records import FixAnswered, FixChecked, FixSent, FixWithheld
from edge.telemetry.firmware import CONTROL, ID
from tests.telemetry.positions import offer_for
from tests.telemetry.rig import LENIENT, OpenRig


def test_px4_gets_five_positions_a_second_and_follows(open_rig: OpenRig) -> None:
    rig = open_rig(emit="auto", gates=GatesConfig(min_move_m=0.0), firmware="px4", drift_percent=5.0)
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
    rig = open_rig(emit="global_position_sensor", gates=LENIENT, firmware="px4-1.17" if ignored else "px4")
    rig.run(5.0)
    rig.autopilot.gps = False
    rig.run(40.0)  # its own position is uncertain by now

    def offer() -> bool:
        if rig.connection.position_due() is not None:
            rig.send_position(rig.fix(age_s=0.0, lat_deg=rig.true_position(0.0)[0] + 25 / 111_000))
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
    rig = open_rig(emit="auto", gates=LENIENT, firmware="px4")
    values = {"EKF2_EV_CTRL": 4.0, CONTROL: float(control), ID: float(sensor_id)}
    rig.autopilot.parameters = {name: (value, mavlink.MAV_PARAM_TYPE_REAL32) for name, value in values.items()}
    rig.run(8.0)
    rig.autopilot.gps = False
    rig.run(8.0)
    offer_for(rig, 3.0)
    said = [message.text for message in rig.received("STATUSTEXT") if "unused" in message.text]
    assert said == ([f"Lookback: positions unused: {why}"] if why else [])


@pytest.mark.parametrize(("firmware", "emit"), [("ardupilot", "external_position"), ("px4", "global_position_sensor")])
def test_a_reset_is_none_that_may_be_for_the_worse(open_rig: OpenRig, firmware: str, emit: str) -> None:
    """GPS has just gone, and a place says 60 m elsewhere, +- 28 m; a filter that weighs it may have it."""
    rig = open_rig(emit=emit, gates=GatesConfig(risk=1.0), firmware=firmware)
    rig.run(6.0)
    rig.autopilot.gps = False
    rig.run(10.0)
    uncertain = {"age_s": 0.0, "sigma_along_m": 28.3, "sigma_cross_track_m": 28.3}
    there = dict(zip(("lat_deg", "lon_deg"), moved(*rig.true_position(0.0), 0.0, 60.0), strict=True))
    assert rig.send_position(rig.fix(**uncertain, **there)) == (firmware == "px4")
    reasons = [record.reason for record in rig.journalled(FixWithheld)]
    assert reasons == ["no reset is needed"] * (firmware == "ardupilot")


def test_px4_gets_each_keypoint_pose_once_by_its_own_sigma(open_rig: OpenRig) -> None:
    """Two a second, though five positions are asked for; none is moved on from the same pose."""
    rig = open_rig(emit="auto", gates=GatesConfig(risk=1.0, min_move_m=0.0), firmware="px4")
    rig.run(6.0)
    rig.autopilot.gps = False
    rig.run(6.0)
    rig.drive.pose_sigma_m, before = 0.4, len(rig.received("GLOBAL_POSITION_SENSOR"))
    for _ in range(20):
        rig.send_position(rig.fix(age_s=0.1, sigma_along_m=1.0, sigma_cross_track_m=1.0))
        for _ in range(5):
            rig.run(0.1)
            rig.publish_position()
    messages = rig.received("GLOBAL_POSITION_SENSOR")[before:]
    assert len(messages) == 20
    assert [one.eph for one in messages] == pytest.approx([0.4] * 20, rel=1e-5), "without the error of the map"


def test_a_stream_has_its_own_standard_deviation_which_an_aided_filter_follows(open_rig: OpenRig) -> None:
    """At 8 m/s 37.5 messages share an error; a filter that is told so of each would not follow them."""
    rig = open_rig(emit="global_position_sensor", gates=GatesConfig(risk=1.0, min_move_m=0.0), firmware="px4")
    rig.run(6.0)
    rig.autopilot.gps = False
    rig.run(6.0)
    assert offer_for(rig, 2.0)
    sigmas_m = [one.eph for one in rig.received("GLOBAL_POSITION_SENSOR")]
    assert sigmas_m == pytest.approx([rig.fix().sigma_m] * len(sigmas_m), rel=0.02)


def test_without_an_origin_ours_is_set_once_and_fixes_are_then_taken(open_rig: OpenRig) -> None:
    origin = (-27.4772, 153.0283, 20.0)
    rig = open_rig(emit="external_position", gps=False, has_origin=False, config={"origin": origin})
    rig.run(4.0)
    assert rig.connection.vehicle.position(rig.now_ns) is None, "zeros are nowhere"
    assert rig.connection.vehicle.session.origin is None
    rig.run(8.0)
    (message,) = rig.received("SET_GPS_GLOBAL_ORIGIN")
    assert (message.latitude, message.longitude, message.altitude) == (-274772000, 1530283000, 20000)
    assert rig.connection.vehicle.session.origin is not None
    assert rig.send_position(rig.fix())
    rig.run(1.0)
    assert rig.journalled(FixAnswered)[-1].result == "ACCEPTED"
    assert rig.autopilot.resets[-1].error_after_m < 1.0


def test_px4_gets_no_origin_before_a_place_is_believed_and_then_the_one_by_which_it_is_there(open_rig: OpenRig) -> None:
    """It takes an origin for where it stands, and could be armed 744 m from there."""
    config = {"origin": (-27.4839, 153.0283, 20.0)}
    rig = open_rig(emit="global_position_sensor", gps=False, firmware="px4", config=config)
    rig.wire.loses = lambda one: one.get_type() in ("GPS_GLOBAL_ORIGIN", "GLOBAL_POSITION_INT")
    rig.run(12.0)
    assert not rig.received("SET_GPS_GLOBAL_ORIGIN")
    assert [one for one in rig.received("STATUSTEXT") if "position not known, no origin set yet" in one.text]
    rig.connection.publish_place(rig.fix())
    rig.run(6.0)
    message = rig.received("SET_GPS_GLOBAL_ORIGIN")[-1]
    assert message.altitude == 20_000
    there = message.latitude / 1e7, message.longitude / 1e7
    assert math.hypot(*east_north_of(*there, (-27.4772, 153.0283))) < 10.0, "that of the simulation"


def test_an_origin_that_is_there_is_left_alone(open_rig: OpenRig) -> None:
    rig = open_rig(config={"origin": (1.0, 2.0, 3.0)})
    rig.run(12.0)
    assert rig.connection.vehicle.session.origin is not None
    assert rig.connection.vehicle.session.origin.lat_deg == pytest.approx(-27.4772)
    assert not rig.received("SET_GPS_GLOBAL_ORIGIN")
