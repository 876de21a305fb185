"""A MAVLink stack that is not ours (MAVSDK's, in C++) acts as the autopilot and decodes all that we send."""

from __future__ import annotations

import json
import queue
import select
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import tomli_w

pytest.importorskip("mavsdk")

import mavsdk
from mavsdk.plugins.mavlink_direct.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.mission_raw_server.mission_raw_server import MissionRawServer
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import Config, GatesConfig, TelemetryConfig
from edge.localization import PlaceFix
from edge.telemetry import open_link
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.encoders import UNBOUNDED_M
from edge.telemetry.link import Link
from edge.telemetry.link_protocol import STREAMS_HZ
from edge_plugins.home.mission_transfer import MissionTransfer
from edge_plugins.home.route import MissionItem
from sim.vehicle.pty_link import open_pty
from tests.common import PATIENCE_S
from tests.telemetry.rig import ToldEstimator
from tests.udp_port import free_port

ORIGIN = (-27.478, 153.028, 20.0)
LONG_TEXT = "Lookback has a text that needs three messages of at most 50 bytes each, of words that stay whole, always"


class Foreigner:
    """MAVSDK as system 1, component 1 on `url`; `read` says what arrived, by message name."""

    def __init__(self, url: str) -> None:
        self._mavsdk = mavsdk.Mavsdk(mavsdk.Configuration.create_manual(1, 1, True))
        assert self._mavsdk.add_any_connection(url) == mavsdk.ConnectionResult.SUCCESS
        self._direct: MavlinkDirect | None = None
        self._arrived: queue.SimpleQueue[MavlinkMessage] = queue.SimpleQueue()
        self._read: dict[str, list[dict[str, Any]]] = defaultdict(list)

    def subscribed(self) -> bool:
        """MAVSDK hands out messages of a system only once it has seen it."""
        systems = self._mavsdk.get_systems() if self._direct is None else []
        if systems:
            self._direct = MavlinkDirect(systems[0])
            self._direct.subscribe_message("", lambda message, _: self._arrived.put(message))
        return self._direct is not None

    def read(self, name: str) -> list[dict[str, Any]]:
        while not self._arrived.empty():
            message = self._arrived.get()
            sender = {"system": message.system_id, "component": message.component_id}
            self._read[message.message_name].append({**json.loads(message.fields_json), **sender})
        return self._read[name]

    def say(self, name: str, **fields: Any) -> None:
        assert self._direct is not None
        self._direct.send_message(MavlinkMessage(name, 1, 1, 0, 0, json.dumps(fields)))

    def close(self) -> None:
        """MAVSDK aborts the whole process where something it handed out is left."""
        self._direct = None
        self._mavsdk.destroy()


"""At 5 m/s one position in a meter: 60 of them within 60 m carry the information of one."""


class Setting:
    """Our connection, the foreigner, and, for serial, the cable between their two pseudo-terminals."""

    def __init__(self, foreigner: Foreigner, connection: str, emit: Any, cable: tuple[Link, ...] = ()) -> None:
        self.foreigner = foreigner
        self.connection = connection
        gates = GatesConfig(risk=1.0, with_gps=True, min_move_m=0.0)  # GPS alone measures this velocity, see below
        self.drive = ToldEstimator(Config(gates=gates))
        self.ours = AutopilotConnection(
            TelemetryConfig(connection=connection, emit=emit, origin=ORIGIN, journal=""),
            gates=gates,
            drive=self.drive,
        )
        self.cable = cable

    def send_position(self, fix: PlaceFix) -> bool:
        """Of a place that is recognized now; whether it was sent."""
        now_ns = time.monotonic_ns()
        self.ours.report_own()
        self.drive.offer(now_ns, fix, self.ours.vehicle.motion.displacement(fix.stamp_ns))
        limits = self.ours.position_due()
        return limits is not None and self.ours.send_position(self.drive.fix(now_ns, limits))

    def until(self, condition: Callable[[], Any], seconds: float = PATIENCE_S) -> None:
        self.pump_until(condition, seconds, self.ours.poll)

    def pump_until(
        self, condition: Callable[[], Any], seconds: float, turn: Callable[[], object] = lambda: None
    ) -> None:
        end_s = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end_s, "it never happened"
            turn()
            select.select(self.cable, [], [], 0.01)
            for end, other in zip(self.cable, reversed(self.cable), strict=True):
                data = end.receive()
                if data:
                    other.send(data)

    def close(self) -> None:
        self.ours.close()
        self.foreigner.close()
        for end in self.cable:
            end.close()


def over_udp(emit: Any = "external_position") -> Setting:
    port = free_port()
    return Setting(Foreigner(f"udpin://127.0.0.1:{port}"), f"udp:127.0.0.1:{port}", emit)


def over_pty(emit: Any = "external_position") -> Setting:
    ours, theirs = open_pty(), open_pty()
    return Setting(Foreigner(f"serial://{theirs.device}:921600"), f"serial:{ours.device}:921600", emit, (ours, theirs))


@pytest.fixture
def emit() -> str:
    """What the tests below choose otherwise."""
    return "external_position"


@pytest.fixture(params=[over_udp])
def setting(request: pytest.FixtureRequest, emit: str) -> Iterator[Setting]:
    with closing(request.param(emit)) as setting:
        yield setting


def tell_time_and_speed(setting: Setting) -> None:
    """The foreigner has been on for 4000 s, and drove at 5 m/s 0.6 s ago, measured by GPS: positions need all of it."""
    vehicle, gps = setting.ours.vehicle, {"fix_type": 3, "lat": -274772000, "lon": 1530283000, "h_acc": 1000}
    setting.foreigner.say("SYSTEM_TIME", time_boot_ms=4_000_000, time_unix_usec=0)
    setting.foreigner.say("GPS_RAW_INT", time_usec=3_999_400_000, **gps)
    setting.until(lambda: vehicle.boot_time_s(0) is not None and vehicle.velocity.aid.is_any)
    setting.foreigner.say("LOCAL_POSITION_NED", time_boot_ms=3_999_400, x=0, y=0, z=0, vx=3.0, vy=4.0, vz=0)
    setting.until(lambda: vehicle.motion.speed_mps(time.monotonic_ns()) is not None)


def place_fix(stamp_ns: int) -> PlaceFix:
    return PlaceFix(
        stamp_ns, 812, -27.4772, 153.0283, 90.0, 6.3, 1.6, "reverse", "same", 1.25, matches=20, confidence=0.87
    )


def test_every_message_of_ours_is_decoded_with_the_right_fields(setting: Setting) -> None:
    ours, foreigner = setting.ours, setting.foreigner
    setting.until(lambda: foreigner.subscribed() and ours.state == "up")
    # What was asked before MAVSDK handed messages on is not seen here, and MAVSDK may have answered it: it reboots.
    session = ours.vehicle.session.number
    foreigner.say("SYSTEM_TIME", time_boot_ms=9_000_000, time_unix_usec=0)
    setting.until(lambda: ours.vehicle.boot_time_s(0) is not None)

    def has_rebooted() -> bool:
        foreigner.say("SYSTEM_TIME", time_boot_ms=4_000_000, time_unix_usec=0)
        return ours.vehicle.session.number > session

    setting.until(has_rebooted)
    tell_time_and_speed(setting)
    fix = place_fix(time.monotonic_ns() - 300_000_000)
    ours.publish_place(fix)
    assert setting.send_position(fix)
    ours.status_text(LONG_TEXT)

    def texts() -> list[dict[str, Any]]:
        """But for the warning of each session, of which the first may be before MAVSDK handed messages on."""
        return [text for text in foreigner.read("STATUSTEXT") if "velocity aid not known" not in text["text"]]

    setting.until(lambda: len(texts()) == 4 and len(foreigner.read("HEARTBEAT")) >= 2)

    heartbeat = foreigner.read("HEARTBEAT")[-1]
    assert {key: heartbeat[key] for key in ("system", "component", "type", "autopilot", "system_status")} == {
        "system": 1,
        "component": 191,
        "type": 18,
        "autopilot": 8,
        "system_status": 4,
    }
    first, *lines = texts()
    assert first["text"] == "Place 812 backwards, confidence 0.87"
    assert " ".join(line["text"] for line in lines) == LONG_TEXT

    command, *_ = foreigner.read("COMMAND_INT")  # tried again after a second, since MAVSDK does not answer
    expected = {"command": 43003, "frame": 0, "x": -274772000, "y": 1530283000, "z": None, "param3": 6.5}
    assert {key: command[key] for key in expected} == expected
    assert (command["target_system"], command["target_component"]) == (1, 1)
    assert command["param1"] == pytest.approx(4000.0, abs=0.5)
    assert command["param2"] == pytest.approx(0.3, abs=0.1)

    values = foreigner.read("NAMED_VALUE_FLOAT") + foreigner.read("NAMED_VALUE_INT")
    expected = {"uniqueness": 1.25, "fix_sigma": 6.5, "place": 812, "pl_along": UNBOUNDED_M, "pl_across": UNBOUNDED_M}
    assert {value["name"]: value["value"] for value in values} == expected
    wanted = {(511, stream) for stream in STREAMS_HZ} | {(512, 148), (512, 49)}

    def asked() -> set[tuple[int, float]]:
        return {(request["command"], request["param1"]) for request in foreigner.read("COMMAND_LONG")}

    setting.until(lambda: asked() >= wanted)  # one by one, and not answered
    assert asked() == wanted
    assert all(request["tc1"] == 0 for request in foreigner.read("TIMESYNC"))


def test_a_request_for_the_time_and_an_answer_to_a_fix_are_understood(setting: Setting) -> None:
    ours, foreigner = setting.ours, setting.foreigner
    setting.until(lambda: foreigner.subscribed() and ours.state == "up")
    foreigner.say("TIMESYNC", tc1=0, ts1=3_999_900_654_321)
    setting.until(lambda: any(message["ts1"] == 3_999_900_654_321 for message in foreigner.read("TIMESYNC")))
    tell_time_and_speed(setting)
    assert setting.send_position(place_fix(time.monotonic_ns()))
    foreigner.say(
        "COMMAND_ACK", command=43003, result=3, progress=0, result_param2=0, target_system=1, target_component=191
    )
    setting.until(lambda: not ours.positions.enabled)
    setting.until(lambda: any("UNSUPPORTED" in message["text"] for message in foreigner.read("STATUSTEXT")))


@pytest.mark.parametrize(
    "setting", [over_udp, pytest.param(over_pty, marks=pytest.mark.soak)], indirect=True
)  # MAVSDK polls a serial port all the time
def test_the_daemon_as_its_own_process_is_seen(
    setting: Setting, make_street: Callable[..., Path], play_on: Callable[[Path, Path], Path], tmp_path: Path
) -> None:
    """It drives until it is seen: a recording of six seconds was over before a busy machine's link was up."""
    street = make_street(range(60))
    setting.ours.close()  # the daemon takes its place
    config = {
        "camera": {"kind": "feed", "device": str(play_on(street / "feed", tmp_path / "feed"))},
        "sampling": {"by": "time", "interval_s": 0.2},
        "map": {"path": str(street / "map")},
        "sequence": {"length": 5},
        "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0},
        "telemetry": {"connection": setting.connection, "journal": ""},
    }
    (tmp_path / "lookback.toml").write_text(tomli_w.dumps(config))
    daemon = subprocess.Popen([sys.executable, "-m", "edge", "run", str(tmp_path / "lookback.toml")])
    try:
        foreigner = setting.foreigner
        setting.pump_until(foreigner.subscribed, PATIENCE_S)
        setting.pump_until(
            lambda: any(text["text"].startswith("Place ") for text in foreigner.read("STATUSTEXT")), PATIENCE_S
        )
        assert foreigner.read("HEARTBEAT")[-1]["component"] == 191
    finally:
        daemon.terminate()
        code = daemon.wait(120)
    assert code == 0


@pytest.mark.parametrize("emit", ["global_position_sensor"])
def test_a_sensor_position_is_understood(setting: Setting) -> None:
    (message,) = position_sent(setting, "GLOBAL_POSITION_SENSOR")
    assert (message["lat"], message["lon"]) == (-274772000, 1530283000)
    assert (message["id"], message["source"]) == (1, 2)
    assert message["eph"] == pytest.approx(6.5)
    assert (message["target_system"], message["target_component"]) == (1, 1)


def position_sent(setting: Setting, name: str) -> list[dict[str, Any]]:
    ours, foreigner = setting.ours, setting.foreigner
    setting.until(lambda: foreigner.subscribed() and ours.state == "up")
    foreigner.say("GPS_GLOBAL_ORIGIN", latitude=-274780000, longitude=1530280000, altitude=20000, time_usec=0)
    setting.until(lambda: ours.vehicle.session.origin is not None)
    tell_time_and_speed(setting)
    assert setting.send_position(place_fix(time.monotonic_ns()))
    setting.until(lambda: foreigner.read(name))
    return foreigner.read(name)


def test_an_origin_is_understood(setting: Setting) -> None:
    """It is set only after the autopilot has been asked for its own, and has reported none for five seconds."""
    ours, foreigner = setting.ours, setting.foreigner
    setting.until(lambda: foreigner.subscribed() and ours.state == "up")
    setting.until(lambda: foreigner.read("SET_GPS_GLOBAL_ORIGIN"))
    message = foreigner.read("SET_GPS_GLOBAL_ORIGIN")[0]
    assert (message["target_system"], message["latitude"], message["longitude"]) == (1, -274780000, 1530280000)
    assert message["altitude"] == 20_000


def test_a_mission_of_ours_arrives_at_mavsdks_autopilot() -> None:
    """MAVSDK receives it by the protocol; it offers no download, so that the transfer ends unverified."""
    port = free_port()
    foreigner = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.AUTOPILOT))
    assert foreigner.add_any_connection(f"udpin://127.0.0.1:{port}") == mavsdk.ConnectionResult.SUCCESS
    server, arrived = MissionRawServer(foreigner.server_component()), queue.SimpleQueue[Any]()
    server.subscribe_incoming_mission(lambda result, plan, _: arrived.put((result, plan)))
    items = [MissionItem(16, 3, (0.0, 0.0, 0.0, None), -27.4772 + row / 1e4, 153.0283, 0.0) for row in range(6)]
    transfer, codec = MissionTransfer(items, 1, first_is_home=False), MavlinkCodec(1, 191)
    link, end_s = open_link(f"udp:127.0.0.1:{port}"), time.monotonic() + PATIENCE_S
    heartbeat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    messages = [heartbeat, *transfer.start(time.monotonic_ns())]
    with closing(link):
        while arrived.empty():
            assert time.monotonic() < end_s, "it never arrived"
            for message in messages:
                link.send(codec.encode(message))
            select.select([link], [], [], 0.02)
            messages = transfer.due(time.monotonic_ns())
            for message in codec.decode(link.receive()):
                messages += transfer.read(message, time.monotonic_ns())
    result, plan = arrived.get()
    assert result.name == "SUCCESS"
    assert [(one.command, one.x, one.y) for one in plan.mission_items] == [
        (16, round(item.lat_deg * 1e7), 1530283000) for item in items
    ]
    server.destroy()
    foreigner.destroy()
