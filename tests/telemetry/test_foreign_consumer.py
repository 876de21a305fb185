"""A MAVLink stack that is not ours (MAVSDK's, in C++) acts as the autopilot and decodes all that we send."""

from __future__ import annotations

import json
import queue
import select
import socket
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import mavsdk
import pytest
from mavsdk.plugins.mavlink_direct.mavlink_direct import MavlinkDirect, MavlinkMessage

from edge.config import TelemetryConfig
from edge.telemetry import PlaceFix
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.link import Link
from sim.pty_link import open_pty

LONG_TEXT = "Lookback has a text that needs three messages of fifty bytes each, since it fills two of them wholly"


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
        self._mavsdk.destroy()


class Setting:
    """Our connection, the foreigner, and, for serial, the cable between their two pseudo-terminals."""

    def __init__(self, foreigner: Foreigner, connection: str, cable: tuple[Link, ...] = ()) -> None:
        self.foreigner = foreigner
        self.ours = AutopilotConnection(TelemetryConfig(connection=connection, emit="external_position"))
        self.cable = cable

    def until(self, condition: Callable[[], Any], seconds: float = 15.0) -> None:
        end_s = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end_s, "it never happened"
            self.ours.poll()
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


def over_udp() -> Setting:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    return Setting(Foreigner(f"udpin://127.0.0.1:{port}"), f"udp:127.0.0.1:{port}")


def over_pty() -> Setting:
    ours, theirs = open_pty(), open_pty()
    return Setting(Foreigner(f"serial://{theirs.device}:921600"), f"serial:{ours.device}:921600", (ours, theirs))


@pytest.fixture(params=[over_udp, over_pty])
def setting(request: pytest.FixtureRequest) -> Iterator[Setting]:
    setting: Setting = request.param()
    yield setting
    setting.close()


def test_every_message_of_ours_is_decoded_with_the_right_fields(setting: Setting) -> None:
    ours, foreigner = setting.ours, setting.foreigner
    setting.until(lambda: foreigner.subscribed() and ours.state == "up")
    foreigner.say("SYSTEM_TIME", time_boot_ms=4_000_000, time_unix_usec=0)
    setting.until(lambda: ours.vehicle.boot_time_s(0) is not None)
    fix = PlaceFix(
        time.monotonic_ns() - 300_000_000, 812, -27.4772, 153.0283, 90.0, 6.5, "reverse", "same", 1.25, "street"
    )
    assert ours.send_fix(fix)
    ours.status_text(LONG_TEXT)
    setting.until(lambda: len(foreigner.read("STATUSTEXT")) == 4 and len(foreigner.read("HEARTBEAT")) >= 2)

    heartbeat = foreigner.read("HEARTBEAT")[-1]
    assert {key: heartbeat[key] for key in ("system", "component", "type", "autopilot", "system_status")} == {
        "system": 1,
        "component": 191,
        "type": 18,
        "autopilot": 8,
        "system_status": 4,
    }
    first, *chunks = foreigner.read("STATUSTEXT")
    assert first["text"] == "Place 812 backwards, street, 1.25"
    assert [chunk["chunk_seq"] for chunk in chunks] == [0, 1, 2]
    assert "".join(chunk["text"] for chunk in chunks) == LONG_TEXT

    (command,) = foreigner.read("COMMAND_INT")
    expected = {"command": 43003, "frame": 0, "x": -274772000, "y": 1530283000, "z": None, "param3": 6.5}
    assert {key: command[key] for key in expected} == expected
    assert (command["target_system"], command["target_component"]) == (1, 1)
    assert command["param1"] == pytest.approx(4000.0, abs=0.5)
    assert command["param2"] == pytest.approx(0.3, abs=0.1)

    (value,) = foreigner.read("NAMED_VALUE_FLOAT")
    assert (value["name"], value["value"]) == ("uniqueness", 1.25)
    assert {request["param1"] for request in foreigner.read("COMMAND_LONG")} == {33, 32, 74, 24, 2}
    assert {request["command"] for request in foreigner.read("COMMAND_LONG")} == {511}
    assert all(request["tc1"] == 0 for request in foreigner.read("TIMESYNC"))


def test_a_request_for_the_time_and_an_answer_to_a_fix_are_understood(setting: Setting) -> None:
    ours, foreigner = setting.ours, setting.foreigner
    setting.until(lambda: foreigner.subscribed() and ours.state == "up")
    foreigner.say("TIMESYNC", tc1=0, ts1=987654321000)
    setting.until(lambda: any(message["ts1"] == 987654321000 for message in foreigner.read("TIMESYNC")))
    fix = PlaceFix(time.monotonic_ns(), 1, -27.0, 153.0, None, 5.0, "forward", "same", 1.1, "field")
    assert ours.send_fix(fix)
    foreigner.say(
        "COMMAND_ACK", command=43003, result=3, progress=0, result_param2=0, target_system=1, target_component=191
    )
    setting.until(lambda: not ours.positions_enabled)
    setting.until(lambda: any("UNSUPPORTED" in message["text"] for message in foreigner.read("STATUSTEXT")))
