"""What ends the daemon is told to all before it ends: journal, systemd, autopilot."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.camera import CameraHealth
from edge.config import Config, MapConfig, TelemetryConfig
from edge.errors import MapError
from edge.health.health import HealthInputs
from edge.health.monitor import HealthMonitor, Links
from edge.journal.records import StateChanged
from edge.opened_parts import OpenedParts
from edge.telemetry.codec import MavlinkCodec
from sim.journal import records_of
from sim.vehicle.pty_link import open_pty


def test_a_failure_to_start_is_told_to_everybody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cable = open_pty()
    config = Config(
        map=MapConfig(path=str(tmp_path / "no-map")),
        telemetry=TelemetryConfig(connection=f"serial:{cable.device}:921600", journal=str(tmp_path / "events.jsonl")),
    )
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager, ExitStack() as parts:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        with pytest.raises(MapError, match="no such map"):
            OpenedParts(config, parts)
        told = [manager.recv(4096).decode() for _ in range(2)]
        heard = MavlinkCodec(255, 190).decode(cable.receive())
    cable.close()
    failed = f"failed: {tmp_path}/no-map: no such map"
    assert told[0] == "STATUS=starting: no picture has been used yet"
    assert told[1].startswith(f"STATUS={failed}")
    assert [record.state for record in records_of(tmp_path / "events.jsonl", StateChanged)] == ["starting", "failed"]
    assert heard[0].get_type() == "HEARTBEAT"
    assert heard[0].system_status == mavlink.MAV_STATE_EMERGENCY
    text = " ".join(message.text for message in heard if message.get_type() == "STATUSTEXT")
    assert "".join(text.split()).startswith("".join(f"Lookback {failed}".split())), "a long path is cut"
    assert {message.severity for message in heard if message.get_type() == "STATUSTEXT"} == {
        mavlink.MAV_SEVERITY_CRITICAL
    }


class Said:
    """What a monitor sends to the pilot, with the time that it is now."""

    def __init__(self) -> None:
        self.now_s, self.texts = 0.0, list[str]()
        links = Links(lambda state: None, lambda text, severity: self.texts.append(text), lambda text, severity: None)
        self._monitor = HealthMonitor(links, None, lambda: round(self.now_s * 1e9))

    def update(self, recognizer: str, driven_m: float | None, withheld: str = "") -> str:
        """A second later."""
        self.now_s += 1.0
        inputs = HealthInputs(recognizer=recognizer, frames_used=50, withheld=withheld, driven_m=driven_m)
        self._monitor.update(inputs, CameraHealth("running", "", 0))
        return str(self._monitor.health)


def test_the_pilot_reads_for_how_many_meters_no_place_was_recognized() -> None:
    said = Said()
    for meters in range(0, 400, 2):
        said.update("on the map" if meters == 80 else "off the map", float(meters))
    assert said.texts == [
        "Lookback starting: no picture has been used yet",
        "Lookback off the map: not recognized",
        "Lookback off the map: not recognized for 20 m",
        "Lookback off the map: not recognized for 50 m",
        "Lookback on the map",
        "Lookback off the map: not recognized",
        "Lookback off the map: not recognized for 20 m",
        "Lookback off the map: not recognized for 50 m",
        "Lookback off the map: not recognized for 100 m",
        "Lookback off the map: not recognized for 200 m",
    ]
    assert said.update("off the map", 3.0) == "off the map: not recognized", "the odometer began anew"
    assert said.update("off the map", None) == "off the map: not recognized"


def test_on_the_map_the_pilot_reads_why_no_position_is_sent_once_there_was_time_for_one() -> None:
    said = Said()
    states = [said.update("on the map", 8.0 * second, "GPS is healthy") for second in range(8)]
    assert states == ["on the map"] * 4 + ["on the map: no position: GPS is healthy"] * 4
    assert said.update("on the map", 72.0) == "on the map"
