"""The way home from `lookback run` as its own process, which has the map, the position and the serial line."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import tomli_w
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import east_north_of
from edge_plugins.home.home_requests import HomeAnswered
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG, Pose
from sim.journal import records_of
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import open_pty
from tests.common import PATIENCE_S

LAT_DEG, LON_DEG = -27.0, 153.0  # where the drive of the map begins
DRIVEN_M = 120.0


@pytest.fixture
def autopilot() -> Iterator[tuple[SimulatedAutopilot, str]]:
    """One that stands on the drive, points home and has GPS; and the connection to it."""
    lat_deg = LAT_DEG + DRIVEN_M / 110_800
    pose = Pose(*east_north_of(lat_deg, LON_DEG, (ORIGIN_LAT_DEG, ORIGIN_LON_DEG)), 180.0, 0.0, 0.0)
    link, stop = open_pty(), threading.Event()
    made = SimulatedAutopilot(link, lambda now_s: pose)
    thread = threading.Thread(target=made.run, args=(stop,))
    thread.start()
    yield made, f"serial:{link.device}:921600"
    stop.set()
    thread.join()
    link.close()


@pytest.fixture
def config(make_street: Callable[..., Path], tmp_path: Path, autopilot: tuple[SimulatedAutopilot, str]) -> Path:
    street = make_street(range(80), period_ms=1000)
    config = {
        "camera": {"kind": "feed", "device": str(street / "feed")},
        "map": {"path": str(street / "map")},
        "telemetry": {"connection": autopilot[1], "journal": "events.jsonl"},
        "page": {"port": 0},
        "home": {"enabled": True},
    }
    path = tmp_path / "lookback.toml"
    path.write_text(tomli_w.dumps(config))
    return path


@pytest.fixture
def daemon(config: Path) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-m", "edge", "run", str(config)])
    yield process
    process.terminate()
    assert process.wait(PATIENCE_S) == 0


def until(condition: Callable[[], object], what: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, what
        os.sched_yield()


def test_the_pilot_asks_the_daemon(
    config: Path, daemon: subprocess.Popen[bytes], autopilot: tuple[SimulatedAutopilot, str]
) -> None:
    vehicle, _ = autopilot
    journal = config.parent / "events.jsonl"
    asked_s: list[float] = []

    def verified() -> list[str]:
        """Ask again each second: a daemon that does not know its autopilot yet says so, or nothing."""
        if not asked_s or time.monotonic() - asked_s[-1] > 1.0:
            asked_s.append(time.monotonic())
            vehicle.send(mavlink.MAVLink_command_long_message(1, 191, 31014, 0, 1, 5665, 0, 0, 0, 0, 0))
        return [one.text for one in records_of(journal, HomeAnswered) if one.verified] if journal.exists() else []

    until(verified, "no way home")
    assert re.search(r"uploaded and verified: 1[12]\d m back along drive 1", verified()[0])
    *_, last = vehicle.mission.waypoints_deg
    assert last == pytest.approx((LAT_DEG, LON_DEG), abs=1e-6)
