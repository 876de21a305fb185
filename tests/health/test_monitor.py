"""What ends the daemon is told to all before it ends: journal, systemd, autopilot."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from edge.config import Config, MapConfig, TelemetryConfig
from edge.daemon import Daemon
from edge.errors import MapError
from edge.journal.records import StateChanged
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
            Daemon(config, parts)
        told = [manager.recv(4096).decode() for _ in range(2)]
        heard = MavlinkCodec(255, 190).decode(cable.receive())
    cable.close()
    failed = f"failed: {tmp_path}/no-map: no such map"
    assert told[0] == "STATUS=starting"
    assert told[1].startswith(f"STATUS={failed}")
    assert [record.state for record in records_of(tmp_path / "events.jsonl", StateChanged)] == ["starting", "failed"]
    assert heard[0].get_type() == "HEARTBEAT"
    assert heard[0].system_status == mavlink.MAV_STATE_EMERGENCY
    text = " ".join(message.text for message in heard if message.get_type() == "STATUSTEXT")
    assert "".join(text.split()).startswith("".join(f"Lookback {failed}".split())), "a long path is cut"
    assert {message.severity for message in heard if message.get_type() == "STATUSTEXT"} == {
        mavlink.MAV_SEVERITY_CRITICAL
    }
