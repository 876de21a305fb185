"""Several links: the autopilot's, others that only get reports, and a router that joins them with a ground station."""

from __future__ import annotations

import math
import re
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import GatesConfig, LinkConfig
from edge.errors import ConfigError
from edge.geodesy import east_north_of
from edge.journal.records import FixAnswered, LinkChanged
from edge.telemetry.codec import MavlinkCodec
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from tests.common import ROOT

OpenRig: TypeAlias = Callable[..., Any]


@dataclass
class GroundStation:
    """Listens on a UDP port of its own, and says heartbeats."""

    codec: MavlinkCodec = field(default_factory=lambda: MavlinkCodec(255, 190))
    heard: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]

    def listen(self) -> bool:
        try:
            while True:
                data, sender = self.socket.recvfrom(2048)
                self.heard += self.codec.decode(data)
                beat = mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3
                )
                self.socket.sendto(self.codec.encode(beat), sender)
        except BlockingIOError:
            return False

    def kinds(self) -> set[str]:
        return {message.get_type() for message in self.heard}


@pytest.fixture
def station() -> Iterator[GroundStation]:
    station = GroundStation()
    yield station
    station.socket.close()


def test_a_further_link_gets_events_and_never_a_position(open_rig: OpenRig, station: GroundStation) -> None:
    links = (LinkConfig(f"udp:127.0.0.1:{station.port}"),)
    rig = open_rig(emit="external_position", gps=False, system_id=7, config={"links": links})
    rig.run(4.0, station.listen)
    rig.connection.publish_place(rig.fix())
    assert rig.send_position(rig.fix())
    rig.connection.status_text("for everybody")
    rig.run(2.0, station.listen)
    assert station.kinds() == {"HEARTBEAT", "STATUSTEXT", "NAMED_VALUE_FLOAT", "NAMED_VALUE_INT"}
    assert {message.get_srcSystem() for message in station.heard[-5:]} == {7}
    assert {message.get_srcComponent() for message in station.heard} == {191}
    texts = [message.text for message in station.heard if message.get_type() == "STATUSTEXT"]
    assert texts == ["Place 42 backwards, confidence 0.90", "for everybody"]
    states = {(record.link, record.state) for record in rig.journalled(LinkChanged)}
    assert (f"udp:127.0.0.1:{station.port}", "up") in states


def test_a_status_for_the_heartbeat_reaches_every_link(open_rig: OpenRig, station: GroundStation) -> None:
    rig = open_rig(config={"links": (LinkConfig(f"udp:127.0.0.1:{station.port}"),)})
    rig.connection.set_system_status(mavlink.MAV_STATE_CRITICAL)
    rig.run(3.0, station.listen)
    assert {message.system_status for message in station.heard} == {mavlink.MAV_STATE_CRITICAL}
    assert rig.received("HEARTBEAT")[-1].system_status == mavlink.MAV_STATE_CRITICAL


def test_a_further_link_that_cannot_be_opened_costs_the_autopilots_nothing(open_rig: OpenRig) -> None:
    rig = open_rig(config={"links": (LinkConfig("serial:/dev/no-such-port:57600"),)})
    assert rig.run(4.0, lambda: rig.connection.state == "up")
    (closed,) = [record for record in rig.journalled(LinkChanged) if record.link != "autopilot"]
    assert closed.state == "closed"
    assert "no such port" in closed.why


def test_behind_a_router_that_joins_us_with_a_ground_station(open_rig: OpenRig) -> None:
    """The router passes on all that the others say: another's heartbeats, requests, acknowledgements and fixes."""
    rig = open_rig(emit="external_position", gps=False)
    station, companion = MavlinkCodec(255, 190), MavlinkCodec(1, 197)
    chatter = [
        (station, mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)),
        (companion, mavlink.MAVLink_heartbeat_message(18, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)),
        (station, mavlink.MAVLink_command_ack_message(43003, mavlink.MAV_RESULT_DENIED, 0, 0, 255, 190)),
        (companion, mavlink.MAVLink_global_position_int_message(1, 1, 1, 0, 0, 0, 0, 0, 0)),
        (station, mavlink.MAVLink_timesync_message(0, 5)),
    ]
    turns = 0

    def talk() -> bool:
        nonlocal turns
        turns += 1
        if turns % 50 == 0:
            for codec, message in chatter:
                rig.pty.send(codec.encode(message))
        return False

    rig.run(5.0, talk)
    assert rig.connection.state == "up"
    assert rig.connection.vehicle.system_id == 1
    position = rig.connection.vehicle.position(rig.now_ns)
    assert position is not None
    assert position.lat_deg == pytest.approx(-27.477, abs=0.01)
    assert rig.send_position(rig.fix())
    rig.run(2.0, talk)
    assert rig.connection.positions.enabled
    assert [record.result for record in rig.journalled(FixAnswered)] == ["ACCEPTED"]
    assert not [message for message in rig.received("TIMESYNC") if message.ts1 == 5], "asked by another, not for us"


def test_the_first_autopilot_that_is_heard_is_named(rig: Any, caplog: pytest.LogCaptureFixture) -> None:
    """It may be somebody else's: simulators and ground stations talk on UDP port 14550, where no example listens."""
    caplog.set_level("INFO")
    rig.run(4.0)
    assert "link up: system 1, ArduPilot" in caplog.text
    pages = (ROOT / "README.md", ROOT / "edge/start.toml", ROOT / "edge/default.toml", *ROOT.glob("docs/*.md"))
    assert not [page.name for page in pages if re.search(r"udpin:[^ ]*:14550", page.read_text())]


def test_a_wrong_link_is_named(open_rig: OpenRig) -> None:
    with pytest.raises(ConfigError, match=r"^\[\[telemetry\.links\]\] connection: 'smoke:here:1' is not"):
        open_rig(config={"links": (LinkConfig("udp:127.0.0.1:1"), LinkConfig("smoke:here:1"))})


class Overheard:
    """What arrives for one vehicle, heard by another that speaks on the same radio."""

    def __init__(self, rig: Any) -> None:
        self._rig, self._heard, self._receive = rig, b"", rig.wire.receive
        rig.wire.receive = self._overhear
        self.send, self.fileno, self.close = rig.wire.send, rig.wire.fileno, rig.wire.close

    def _overhear(self) -> bytes:
        data = self._receive()
        self._heard += data
        return bytes(data)

    def receive(self) -> bytes:
        data, self._heard = self._heard, b""
        return data


def test_two_autopilots_with_the_same_ids_get_no_position(open_rig: OpenRig) -> None:
    """Another vehicle 22 m ahead on the same radio, which was switched on earlier: where it is does not count."""
    rig = open_rig(emit="external_position", gates=GatesConfig(risk=1.0, min_move_m=0.0), gps=False)
    pose_at = straight_line(8.0, 60.0, rig.now_ns / 1e9 - 22 / 8)
    ahead = SimulatedAutopilot(Overheard(rig), pose_at, lambda: rig.now_ns, gps=False, booted_before_s=30.0)

    def step() -> bool:
        ahead.step()
        return False

    rig.run(6.0, step)
    own = rig.connection.vehicle.position(rig.now_ns)
    assert own is not None
    apart_m = east_north_of(own.lat_deg, own.lon_deg, pose_at(rig.now_ns / 1e9).geodetic())
    assert math.hypot(*apart_m) == pytest.approx(22.0, abs=3.0)
    assert not rig.send_position(rig.fix())
    assert rig.connection.why_no_position == "two autopilots have the same ids"
    assert [one.text for one in rig.received("STATUSTEXT")].count("Lookback: two autopilots have the same ids") == 1
    assert rig.journalled(LinkChanged)[-1] == LinkChanged("up", "two autopilots have the same ids")
    rig.run(12.0)
    assert rig.connection.vehicle.position(rig.now_ns) is not None
    assert rig.send_position(rig.fix())
    assert rig.journalled(LinkChanged)[-1] == LinkChanged("up", "")
