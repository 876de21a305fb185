"""The connection against the simulated autopilot: link, streams, fixes, acknowledgements, unplugging."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import TelemetryConfig
from edge.journal.records import FixAnswered, LinkChanged
from edge.telemetry import open_link
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import MavlinkCodec
from sim.vehicle.autopilot import SILENT
from tests.telemetry.rig import SPEED_MPS, START_NS, Rig
from tests.udp_port import free_port

STREAMS = {33, 32, 74, 9000, 24, 124, 1, 2, 230, 193, 27, 30}

external = pytest.mark.parametrize("rig", [{"emit": "external_position", "gps": False}], indirect=True)


def test_heartbeats_go_out_and_the_link_comes_up_with_streams(rig: Rig) -> None:
    assert rig.run(3.0, lambda: rig.connection.state == "up")
    rig.run(5.0)
    heartbeats = rig.received("HEARTBEAT")
    assert len(heartbeats) == pytest.approx(7, abs=2)
    assert {(m.get_srcSystem(), m.get_srcComponent(), m.type, m.autopilot) for m in heartbeats} == {(1, 191, 18, 8)}
    assert {int(m.param1) for m in rig.received("COMMAND_LONG") if m.command == 511} == STREAMS
    assert {int(m.param1) for m in rig.received("COMMAND_LONG") if m.command == 512} == {148, 49}
    assert [record.state for record in rig.journalled(LinkChanged)] == ["waiting", "up"]


def test_distance_speed_position_and_boot_clock_come_from_the_autopilot(rig: Rig) -> None:
    rig.run(12.0)
    vehicle = rig.connection.vehicle
    before, after = (vehicle.motion.distance_m(rig.now_ns - round(back_s * 1e9)) for back_s in (5.0, 0.0))
    assert before is not None and after is not None
    assert after - before == pytest.approx(5.0 * SPEED_MPS, rel=0.01)
    assert vehicle.motion.speed_mps(rig.now_ns) == pytest.approx(SPEED_MPS, rel=0.01)
    boot_s = vehicle.boot_time_s(rig.now_ns)
    assert boot_s == pytest.approx(rig.autopilot.boot_s, abs=0.011)
    position = vehicle.position(rig.now_ns)
    assert position is not None
    assert position.heading_deg == pytest.approx(60.0)
    assert vehicle.session.gps.state(rig.now_ns) == "healthy"


def test_the_autopilots_own_system_id_is_taken(open_rig: Callable[..., Rig]) -> None:
    rig = open_rig(system_id=7)
    rig.run(4.0)
    assert rig.connection.vehicle.system_id == 7
    assert rig.received("HEARTBEAT")[-1].get_srcSystem() == 7


def test_only_the_configured_system_is_the_vehicle(open_rig: Callable[..., Rig]) -> None:
    rig = open_rig(system_id=7, config={"system_id": 3})
    rig.run(6.0)
    assert rig.connection.state == "waiting"
    assert rig.received("HEARTBEAT")[-1].get_srcSystem() == 3
    rig.connection.close()
    other = open_rig(system_id=3, config={"system_id": 3})
    other.run(4.0)
    assert other.connection.state == "up"


def test_a_stranger_on_the_network_does_not_become_the_peer(tmp_path: Path) -> None:
    """Its datagrams come between those of the autopilot, which alone makes the link."""
    now_ns = START_NS
    port = free_port()
    config = TelemetryConfig(connection=f"udpin:127.0.0.1:{port}", journal=str(tmp_path / "events.jsonl"))
    connection = AutopilotConnection(config, lambda: now_ns)
    connection.poll()
    vehicle, stranger = (open_link(f"udp:127.0.0.1:{port}") for _ in range(2))
    beat = MavlinkCodec(1, 1).encode(mavlink.MAVLink_heartbeat_message(10, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 4, 3))
    for _ in range(4):
        now_ns += 1_000_000_000
        vehicle.send(beat)
        stranger.send(b"hello")
        connection.poll()
    assert connection.state == "up"
    now_ns += 1_000_000_000
    while stranger.receive():
        pass
    connection.poll()
    assert vehicle.receive()
    assert not stranger.receive()
    for link in (connection, vehicle, stranger):
        link.close()


def test_report_sends_text_and_no_position(rig: Rig) -> None:
    rig.run(4.0)
    rig.connection.publish_place(rig.fix())
    assert rig.connection.position_due() is None
    assert not rig.send_position(rig.fix())
    rig.run(2.0)
    assert [message.text for message in rig.received("STATUSTEXT")] == ["Place 42 backwards, confidence 0.90"]
    values = {message.name: message.value for message in rig.received("NAMED_VALUE_FLOAT")}
    assert values == {"uniqueness": pytest.approx(1.31), "fix_sigma": pytest.approx(3.0)}
    assert [(message.name, message.value) for message in rig.received("NAMED_VALUE_INT")] == [("place", 42)]
    assert not rig.received("COMMAND_INT")


@external
def test_an_external_position_moves_the_autopilot_to_the_truth(rig: Rig) -> None:
    rig.run(4.0)
    assert rig.send_position(rig.fix(age_s=1.5))
    rig.run(1.0)
    command = rig.received("COMMAND_INT")[0]
    assert (command.command, command.frame, command.target_system, command.target_component) == (43003, 0, 1, 1)
    assert command.z != command.z, "z must be NaN"
    assert command.param2 == pytest.approx(1.5, abs=0.02)
    assert command.param3 == pytest.approx(3.0)
    assert [reset.error_after_m for reset in rig.autopilot.resets] == [pytest.approx(0.0, abs=0.3)]
    assert [(record.place, record.result) for record in rig.journalled(FixAnswered)] == [(42, "ACCEPTED")]


@external
@pytest.mark.parametrize(
    "fix",
    [
        {"lat_deg": None, "lon_deg": None},
        {"lon_deg": math.nan},
        {"sigma_cross_track_m": math.nan},
        {"age_s": 6.0},
        {"age_s": -0.2},
    ],
)
def test_no_position_goes_out_for_a_fix_without_one_or_of_a_wrong_age(rig: Rig, fix: dict[str, Any]) -> None:
    rig.run(4.0)
    assert not rig.send_position(rig.fix(**fix))
    rig.run(1.0)
    assert not rig.received("COMMAND_INT")


@external
def test_nothing_of_a_fix_goes_out_before_the_link_is_up_nor_later(rig: Rig) -> None:
    assert not rig.send_position(rig.fix())
    rig.connection.publish_place(rig.fix())
    rig.run(6.0)
    assert not rig.received("COMMAND_INT")
    assert not rig.received("STATUSTEXT")


@external
def test_an_answer_to_a_fix_of_another_companion_is_not_ours(rig: Rig) -> None:
    rig.run(4.0)
    rig.autopilot.reject_fixes_with = SILENT
    assert rig.send_position(rig.fix())
    denied = mavlink.MAVLink_command_ack_message(43003, mavlink.MAV_RESULT_DENIED, 0, 0, 1, 197)
    assert rig.pty is not None
    rig.pty.send(MavlinkCodec(1, 1).encode(denied))
    rig.run(0.5)
    assert rig.connection.positions.enabled
    assert not rig.journalled(FixAnswered)


@external
def test_a_denied_position_is_the_last_until_the_autopilot_reboots(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    rig.run(4.0)
    rig.autopilot.reject_fixes_with = 2  # MAV_RESULT_DENIED
    assert rig.send_position(rig.fix())
    rig.run(1.0)
    assert not rig.send_position(rig.fix())
    assert [record.getMessage() for record in caplog.records if record.levelname == "ERROR"] == [
        "the autopilot answered DENIED: positions are off until it reboots"
    ]
    rig.autopilot.reboot()
    rig.run(7.0)
    assert rig.send_position(rig.fix())


def test_a_reboot_is_noticed_and_the_streams_are_asked_for_again(rig: Rig) -> None:
    rig.run(8.0)
    rig.autopilot.reboot()
    asked = len(rig.received("COMMAND_LONG"))
    assert rig.run(7.0, lambda: len(rig.received("COMMAND_LONG")) > asked)
    rig.run(2.0)
    assert rig.connection.vehicle.boot_time_s(rig.now_ns) == pytest.approx(rig.autopilot.boot_s, abs=0.011)


def test_a_second_owner_is_refused_and_told_why(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    rig.run(1.0)
    second = AutopilotConnection(TelemetryConfig(connection=f"serial:{rig.port}:921600"), lambda: rig.now_ns)
    second.poll()
    assert second.state == "closed"
    assert "in use by another program" in caplog.text


def test_a_flood_of_texts_is_thinned(rig: Rig) -> None:
    rig.run(4.0)
    for number in range(100):
        rig.connection.status_text(f"line {number}")
    rig.run(0.9)
    assert len(rig.received("STATUSTEXT")) == 2, "two a second"
    rig.run(9.1)
    assert [message.text for message in rig.received("STATUSTEXT")] == [f"line {number}" for number in range(92, 100)]


@pytest.mark.parametrize("recording", ["ardurover-4.6.3-nogps", "px4-1.18-agp"])
def test_recorded_autopilots_played_into_the_port(
    rig: Rig, read_tlog: Callable[[str], Iterator[tuple[int, bytes]]], recording: str
) -> None:
    """Its first half minute at least: link up, streams asked for, time base right, TIMESYNC answered, no position."""
    sent, codec, theirs, next_fix_ns = [], MavlinkCodec(1, 1), MavlinkCodec(1, 191), 0
    errors_s: list[float] = []
    began_ns = None
    pty = rig.pty
    assert pty is not None
    for rig.now_ns, frame in read_tlog(recording):
        began_ns = began_ns or rig.now_ns
        if rig.now_ns - began_ns > 30_000_000_000 and len(errors_s) >= 7:
            break
        for message in theirs.decode(frame):
            boot_s = rig.connection.vehicle.boot_time_s(rig.now_ns)
            if message.get_type() == "TIMESYNC" and message.tc1 == 0 and boot_s is not None:
                errors_s.append(boot_s - message.ts1 / 1e9)  # known before it is read
        pty.send(frame)
        rig.connection.poll()
        sent += codec.decode(pty.receive())
        if rig.connection.state == "up" and rig.now_ns >= next_fix_ns:
            next_fix_ns = rig.now_ns + 1_000_000_000
            rig.connection.publish_place(rig.fix())
            assert rig.connection.position_due() is None
            assert not rig.send_position(rig.fix())
    assert rig.connection.state == "up"
    assert len(errors_s) >= 7
    assert max(map(abs, errors_s)) < 0.020
    # Which sensors PX4 fuses, and the radius of ArduPilot's wheels.
    fusion, radius = ({514}, set()) if recording.startswith("px4") else (set(), {"PARAM_REQUEST_READ"})
    values = {"NAMED_VALUE_FLOAT", "NAMED_VALUE_INT", "HEARTBEAT", "TIMESYNC", "COMMAND_LONG", "STATUSTEXT"}
    assert {message.get_type() for message in sent} == values | radius
    commands = [message for message in sent if message.get_type() == "COMMAND_LONG"]
    assert {message.param1 for message in commands if message.command == 511} == STREAMS | fusion
    assert {message.command for message in commands} == {511, 512}
    assert any(message.tc1 for message in sent if message.get_type() == "TIMESYNC")
