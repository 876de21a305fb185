"""Messages that a stranger forges, or a second autopilot with the same ids sends, change nothing that is known."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import moved
from edge.journal.records import FixAnswered
from edge.telemetry.firmware import SET_WITHOUT_GPS
from edge.telemetry.people import Publisher
from edge.telemetry.session import Origin
from edge.telemetry.source_selection import SourceSelection
from edge.telemetry.vehicle import Vehicle
from tests.telemetry.rig import Rig
from tests.telemetry.speaker import S, Speaker, connect


def drive(vehicle: Vehicle, forged: Any, ticks: int = 100) -> None:
    """Ten seconds of an autopilot that drives north from its origin, and a forged message once a second."""
    speaker = Speaker()
    for tick in range(ticks):
        now_ns, boot_ms = 2 * S + tick * S // 10, 500_000 + 100 * tick
        if tick % 10 == 5:
            vehicle.handle(speaker.say(forged), now_ns)
        vehicle.handle(speaker.fix(boot_ms, 0.8 * tick, 8.0, 0.0), now_ns)
        vehicle.handle(
            speaker.say(mavlink.MAVLink_local_position_ned_message(boot_ms, 0.8 * tick, 0, 0, 8, 0, 0)), now_ns
        )
        assert vehicle.position(now_ns) is not None


@pytest.mark.parametrize("boot_ms", [0, 3_000, 900_000, 2**32 - 1])
@pytest.mark.parametrize("kind", ["system_time", "timesync", "wheels", "position"])
def test_one_forged_time_a_second_is_no_reboot(boot_ms: int, kind: str) -> None:
    vehicle = connect(Speaker())
    forged = {
        "system_time": mavlink.MAVLink_system_time_message(0, boot_ms),
        "timesync": mavlink.MAVLink_timesync_message(0, boot_ms * 1_000_000),
        "wheels": mavlink.MAVLink_wheel_distance_message(boot_ms * 1000, 1, [1e6] + [0.0] * 15),
        "position": mavlink.MAVLink_local_position_ned_message(boot_ms, 1e6, 0, 0, 8, 0, 0),
    }[kind]
    drive(vehicle, forged)
    assert vehicle.session.number == 1
    assert vehicle.boot_time_s(12 * S) == pytest.approx(510.0, abs=0.2)
    assert vehicle.motion.driven_m(12 * S) == pytest.approx(80.0, abs=5.0)


def test_a_forged_origin_moves_nothing(caplog: pytest.LogCaptureFixture) -> None:
    vehicle, speaker = connect(Speaker()), Speaker()
    here, there = ((round((-27.0 + off) * 1e7), 1530000000, 30_000) for off in (0.0, 0.001))
    drive(vehicle, mavlink.MAVLink_gps_global_origin_message(*here), 20)
    assert vehicle.session.origins.known == Origin(-27.0, 153.0, 30.0)
    for now_ns in (4 * S, 5 * S):
        vehicle.handle(speaker.say(mavlink.MAVLink_gps_global_origin_message(*there)), now_ns)
    assert vehicle.session.origins.known == Origin(-27.0, 153.0, 30.0)
    assert "GPS_GLOBAL_ORIGIN ignored: the autopilot's own positions say that it is 111 m off" in caplog.text


def test_an_origin_that_nothing_can_be_compared_with_needs_two_messages_to_change() -> None:
    vehicle, speaker = connect(Speaker()), Speaker()
    messages = [
        speaker.say(mavlink.MAVLink_gps_global_origin_message(degrees, 1, 0)) for degrees in (10, 20, 10, 20, 20)
    ]
    known = []
    for seconds, message in zip((2, 3, 4, 5, 6), messages, strict=True):
        vehicle.handle(message, seconds * S)
        assert vehicle.session.origins.known is not None
        known.append(round(vehicle.session.origins.known.lat_deg * 1e7))
    assert known == [10, 10, 10, 10, 20]


def test_an_origin_is_believed_once_it_was_undisputed_for_half_a_second() -> None:
    vehicle, speaker = connect(Speaker()), Speaker()
    for tenths, degrees in ((20, 10), (30, 20), (34, 20)):
        vehicle.handle(speaker.say(mavlink.MAVLink_gps_global_origin_message(degrees, 1, 0)), tenths * S // 10)
    assert vehicle.session.origins.known is not None and round(vehicle.session.origins.known.lat_deg * 1e7) == 10
    vehicle.handle(speaker.say(mavlink.MAVLink_gps_global_origin_message(20, 1, 0)), 35 * S // 10)
    assert vehicle.session.origins.known is not None and round(vehicle.session.origins.known.lat_deg * 1e7) == 20


def test_a_mode_is_known_once_no_heartbeat_contradicts_it() -> None:
    """A stranger's heartbeats between those of an autopilot that drives itself do not permit a new mission."""
    vehicle, speaker = Vehicle(), Speaker()
    driving = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_AUTO_ENABLED

    def beat(mode: int, now_ns: int) -> bool | None:
        vehicle.handle(speaker.say(mavlink.MAVLink_heartbeat_message(10, 3, mode, 0, 4, 3)), now_ns)
        return vehicle.drives_itself

    assert [beat(0, tenths * S // 10) for tenths in (0, 10, 20, 30, 40)] == [None, None, None, None, False]
    assert beat(driving, 5 * S)
    assert all(beat(0, 5 * S + tenths * S // 10) for tenths in range(1, 10))
    assert beat(driving, 6 * S)
    assert [beat(0, tenths * S // 10) for tenths in (70, 80, 90)] == [True, True, False]


@pytest.mark.parametrize(
    ("apart_m", "apart_ms", "batch"), [(22.0, 0, 1), (22.0, 40, 1), (22.0, 0, 2), (0.0, 3_600_000, 1)]
)
def test_of_two_autopilots_with_the_same_ids_nothing_is_known(apart_m: float, apart_ms: int, batch: int) -> None:
    """Their positions come in turns, singly or in twos; in one place, their clocks do. A single one is known again."""
    speaker = Speaker()
    vehicle = connect(speaker)
    for first in range(0, 100, batch):
        ticks = range(first, first + batch)
        now_ns = 2 * S + ticks[-1] * S // 10
        for off_m, off_ms in ((0.0, 0), (apart_m, apart_ms)):
            for tick in ticks:
                vehicle.handle(speaker.fix(10_000 + 100 * tick + off_ms, off_m + 0.8 * tick, 8.0, 0.0), now_ns)
        assert vehicle.is_doubled or first < 6
    assert vehicle.position(now_ns) is None
    assert vehicle.motion.speed_mps(now_ns) is None
    assert vehicle.motion.displacement(now_ns) is None
    assert vehicle.connected
    for tick in range(100, 220):
        vehicle.handle(speaker.fix(10_000 + 100 * tick, 0.8 * tick, 8.0, 0.0), 2 * S + tick * S // 10)
    assert not vehicle.is_doubled
    assert vehicle.position(2 * S + tick * S // 10) is not None


def test_an_autopilot_that_is_reset_each_second_is_one(steps: int = 60) -> None:
    """By positions up to 10 m off to either side, and a reboot in the middle."""
    speaker, rng = Speaker(), random.Random(7)
    vehicle, off_m = connect(speaker), 0.0
    for tick in range(10 * steps):
        off_m = rng.uniform(-10.0, 10.0) if tick % 10 == 0 else off_m
        boot_ms = 100 * tick + (500_000 if tick < 5 * steps else 0)
        vehicle.handle(speaker.fix(boot_ms, 0.8 * tick + off_m, 8.0, 0.0), 2 * S + tick * S // 10)
        assert not vehicle.is_doubled


def gps_report(north_m: float, fix: int = 3) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(0, fix, degrees(north_m), 1530000000, 0, 80, 100, 800, 0, 12, h_acc=1500)


def filter_report(*, uses_gps: bool) -> Any:
    return mavlink.MAVLink_estimator_status_message(0, 831 if uses_gps else 167, *[0.0] * 8)


def degrees(north_m: float) -> int:
    return round((-27.0 + north_m / 110_773) * 1e7)


def stranger(kind: str, boot_ms: int, north_m: float) -> list[Any]:
    """What is forged when the vehicle is there."""
    if kind == "second receiver":
        far = mavlink.MAVLink_gps2_raw_message(0, 3, degrees(north_m + 300), 1530000000, 0, 80, 100, 800, 0, 12, 0, 0)
        return [far, filter_report(uses_gps=True)]
    at = degrees(north_m), 1530000000, 0, 0
    return {
        "fix": [gps_report(north_m + 300)],
        "no fix": [gps_report(north_m, fix=1)],
        "velocity": [mavlink.MAVLink_global_position_int_message(boot_ms, *at, 30_000, 0, 0, 0)],
        "local velocity": [mavlink.MAVLink_local_position_ned_message(boot_ms, north_m, 0, 0, 300, 0, 0)],
    }[kind]


@pytest.mark.parametrize("period_ms", [20, 1000])
@pytest.mark.parametrize("lost", [False, True], ids=["healthy", "lost"])
@pytest.mark.parametrize("kind", ["fix", "no fix", "second receiver", "velocity", "local velocity"])
def test_forged_gps_and_motion_beside_the_autopilots_stop_positions(kind: str, lost: bool, period_ms: int) -> None:
    """Three seconds after a stranger begins neither GPS nor the motion is known, and none of his is used."""
    speaker = Speaker()
    vehicle = connect(speaker)
    for ms in range(0, 8000, 10):
        now_ns, boot_ms, north_m = 2 * S + ms * 1_000_000, 500_000 + ms, 0.008 * ms
        has_fix = ms < 2000 or not lost
        said: list[Any] = []
        if ms % 1000 == 0:
            said.append(mavlink.MAVLink_heartbeat_message(10, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 4, 3))
        if ms % 100 == 0:
            vehicle.handle(speaker.fix(boot_ms, north_m, 8.0, 0.0), now_ns)
            said.append(mavlink.MAVLink_local_position_ned_message(boot_ms, north_m, 0, 0, 8, 0, 0))
        if ms % 250 == 0:
            said += [gps_report(north_m, 3 if has_fix else 1), filter_report(uses_gps=has_fix)]
        if ms > 2000 and ms % period_ms == 50 % period_ms:
            said += stranger(kind, boot_ms, north_m)
        for message in said:
            vehicle.handle(speaker.say(message), now_ns)
        if ms < 5500:
            continue
        fix, speed_mps = (
            vehicle.session.gps.fix(vehicle.position(now_ns), now_ns, now_ns),
            vehicle.motion.speed_mps(now_ns),
        )
        assert fix is None or abs((fix.lat_deg + 27.0) * 110_773 - north_m) < 3.0
        assert speed_mps is None or speed_mps == pytest.approx(8.0)
        if "velocity" in kind:
            assert vehicle.is_doubled
        elif lost or kind == "fix":
            assert vehicle.session.gps.receiver_state(now_ns) != "healthy"


@pytest.mark.parametrize("kind", ["fix", "local position"])
@pytest.mark.parametrize("heading_deg", [0, 45, 90, 135, 180, 225, 270, 315])
def test_two_senders_are_told_apart_whichever_way_a_fast_vehicle_goes(heading_deg: int, kind: str) -> None:
    """At 30 m/s. What the other one sends lies 300 m further north."""
    speaker, course_rad = Speaker(), math.radians(heading_deg)
    vehicle, east_mps, north_mps = connect(speaker), 30.0 * math.sin(course_rad), 30.0 * math.cos(course_rad)
    for eighth in range(16, 40):
        seconds, off_m = eighth / 8, 300.0 * (eighth % 2)
        east_m, north_m = east_mps * seconds, north_mps * seconds + off_m
        if kind == "fix":
            lat_deg, lon_deg = moved(-27.0, 153.0, east_m, north_m)
            at = round(lat_deg * 1e7), round(lon_deg * 1e7), 0, 80, 100, 3000, 100 * heading_deg, 12
            message = mavlink.MAVLink_gps_raw_int_message(0, 3, *at, h_acc=1500)
        else:
            velocity = north_mps, east_mps, 0.0
            message = mavlink.MAVLink_local_position_ned_message(125 * eighth, north_m, east_m, 0.0, *velocity)
        vehicle.handle(speaker.say(message), round(seconds * S))
    assert vehicle.session.gps.takes_turns(round(seconds * S)) == (kind == "fix")
    assert vehicle.is_doubled == (kind == "local position")


external = pytest.mark.parametrize("rig", [{"emit": "external_position", "gps": False}], indirect=True)


@external
def test_a_forged_refusal_before_the_autopilots_answer_stops_positions_for_a_moment(rig: Rig) -> None:
    rig.run(4.0)
    assert rig.send_position(rig.fix())
    rig.autopilot.send(mavlink.MAVLink_command_ack_message(43003, mavlink.MAV_RESULT_DENIED, 0, 0, 1, 191))
    rig.run(2.0)
    assert [record.result for record in rig.journalled(FixAnswered)] == ["DENIED"]
    assert rig.send_position(rig.fix())


@pytest.mark.parametrize(("forged", "true"), [("ACCEPTED", "FAILED"), ("DENIED", "ACCEPTED")])
def test_a_set_of_sources_is_asked_for_again_where_two_answers_differ(forged: str, true: str) -> None:
    sources = SourceSelection(connect(Speaker()), Publisher(lambda record: None, lambda text: None))
    sources.wanted = SET_WITHOUT_GPS
    assert len(sources.due(S)) == 1
    for second, answer in ((1.1, forged), (1.2, true)):
        sources.read_acknowledgement(getattr(mavlink, f"MAV_RESULT_{answer}"), round(second * S))
    assert len(sources.due(4 * S)) == 1
