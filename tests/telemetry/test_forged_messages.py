"""A forged message now and then, and a second autopilot with the same ids, change nothing that is known."""

from __future__ import annotations

import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import FixAnswered
from edge.telemetry.firmware import SET_WITHOUT_GPS
from edge.telemetry.people import Publisher
from edge.telemetry.source_selection import SourceSelection
from edge.telemetry.vehicle import Vehicle
from tests.common import S
from tests.telemetry.rig import Rig
from tests.telemetry.speaker import Speaker, connect


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


@pytest.mark.parametrize("batch", [1, 2])
@pytest.mark.parametrize("apart_ms", [-5_000, 3_600_000])
def test_of_two_autopilots_with_the_same_ids_the_second_is_ignored_and_said(
    apart_ms: int, batch: int, caplog: pytest.LogCaptureFixture
) -> None:
    """Their clocks differ, and come in turns, singly or in twos."""
    speaker = Speaker()
    vehicle = connect(speaker)
    for first in range(0, 100, batch):
        ticks = range(first, first + batch)
        now_ns = 2 * S + ticks[-1] * S // 10
        for off_m, off_ms in ((0.0, 0), (300.0, apart_ms)):
            for tick in ticks:
                vehicle.handle(speaker.fix(10_000 + 100 * tick + off_ms, off_m + 0.8 * tick, 8.0, 0.0), now_ns)
        position = vehicle.position(now_ns)
        assert position is not None and abs((position.lat_deg + 27.0) * 110_773 - 0.8 * ticks[-1]) < 3.0
        assert vehicle.is_doubled or first < 6
    assert vehicle.own(now_ns).is_doubled, "nothing is sent, which both would take"
    assert vehicle.motion.driven_m(now_ns) == pytest.approx(80.0, abs=3.0)
    for tick in range(100, 220):
        vehicle.handle(speaker.fix(10_000 + 100 * tick, 0.8 * tick, 8.0, 0.0), 2 * S + tick * S // 10)
    assert not vehicle.is_doubled and vehicle.session.number == 1
    said = [one.message for one in caplog.records if "autopilot" in one.message]
    assert said == ["system 1 is two autopilots", "system 1 is one autopilot again"]


def test_an_autopilot_that_is_reset_each_second_is_one(steps: int = 60) -> None:
    """By positions up to 10 m off to either side, and a reboot in the middle."""
    speaker, rng = Speaker(), random.Random(7)
    vehicle, off_m = connect(speaker), 0.0
    for tick in range(10 * steps):
        off_m = rng.uniform(-10.0, 10.0) if tick % 10 == 0 else off_m
        boot_ms = 100 * tick + (500_000 if tick < 5 * steps else 0)
        vehicle.handle(speaker.fix(boot_ms, 0.8 * tick + off_m, 8.0, 0.0), 2 * S + tick * S // 10)
        assert not vehicle.is_doubled


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
    sources.want(SET_WITHOUT_GPS, "faulty")
    assert len(sources.due(S)) == 1
    for second, answer in ((1.1, forged), (1.2, true)):
        sources.read_acknowledgement(getattr(mavlink, f"MAV_RESULT_{answer}"), round(second * S))
    assert len(sources.due(4 * S)) == 1
