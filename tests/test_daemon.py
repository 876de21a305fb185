"""`lookback run` as its own process: a recorded feed for a camera, the simulated autopilot on a pty."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
import tomli_w

from edge.config import CameraConfig, Config, MapConfig, TelemetryConfig
from edge.journal.records import FixAnswered, FixSent, LinkChanged, PlaceFix, Stopped
from edge.opened_parts import OpenedParts
from edge_plugins.motion.camera_motion import MotionMeasured
from edge_plugins.page import PageConfig
from sim import Pose
from sim.journal import R, records_of
from sim.vehicle.autopilot import EXTERNAL_POSITION_ESTIMATE, SimulatedAutopilot
from sim.vehicle.command import VehicleStart, straight_line
from sim.vehicle.pty_link import PtyLink
from tests.common import PATIENCE_S

FRAMES, PERIOD_MS = 80, 150
OLDEST_S = 5.0
"""What ArduPilot takes; on a machine with time to spare it is a tenth of a second."""


@pytest.fixture(scope="module")
def street(make_street: Callable[..., Path]) -> Path:
    return make_street(range(FRAMES), period_ms=PERIOD_MS)


def start(street: Path, folder: Path, connection: str) -> subprocess.Popen[str]:
    config = {
        "camera": {"kind": "feed", "device": str(street / "feed"), "fov_deg": 80.0},
        "motion": {"use": "odometer"},
        "sampling": {"by": "time", "interval_s": PERIOD_MS / 1000},
        "map": {"path": str(street / "map")},
        "sequence": {"length": 10},
        "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0, "hold_off_s": 0.2},
        "gates": {"risk": 1.0, "max_move_m": 100_000.0},
        "telemetry": {"connection": connection, "emit": "external_position", "journal": "events.jsonl"},
    }
    (folder / "lookback.toml").write_text(tomli_w.dumps(config))
    command = [sys.executable, "-m", "edge", "run", str(folder / "lookback.toml")]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def journal(folder: Path, kind: type[R]) -> list[R]:
    path = folder / "events.jsonl"
    return list(records_of(path, kind)) if path.exists() else []


def wait_for(condition: Callable[[], object], what: str, timeout_s: float = PATIENCE_S) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"no {what} in {timeout_s} s"
        time.sleep(0.02)


def test_from_camera_to_autopilot(street: Path, tmp_path: Path, cable: PtyLink) -> None:
    driving = straight_line(2.0 / PERIOD_MS * 1000, 0.0, time.monotonic())
    autopilot = SimulatedAutopilot(cable, driving, gps=False)
    stop = threading.Event()
    flying = threading.Thread(target=autopilot.run, args=(stop,))
    flying.start()
    try:
        process = start(street, tmp_path, f"serial:{cable.device}:921600")
        assert process.wait(PATIENCE_S) == 0, process.communicate()[1]
    finally:
        stop.set()
        flying.join()
    process.communicate()
    places = journal(tmp_path, PlaceFix)
    assert len(places) >= 5
    assert [place.place for place in places] == sorted(place.place for place in places)
    fixes = [
        item.message
        for item in autopilot.received
        if item.message.get_type() == "COMMAND_INT" and item.message.command == EXTERNAL_POSITION_ESTIMATE
    ]
    assert fixes
    assert {one.why == "" for one in journal(tmp_path, MotionMeasured)} == {False}, "pictures of no road"
    # Between places, as the journal has them: one every 2 m, due north.
    sent = sorted({one.lat_deg * 1e7 for one in journal(tmp_path, FixSent)})
    assert sorted({fix.x for fix in fixes}) == pytest.approx(sent, abs=1.0), "the journal rounds as well"
    assert all(-270000000 <= fix.x <= -270000000 + FRAMES * 2 * 90.3 for fix in fixes)
    assert "ACCEPTED" in {answer.result for answer in journal(tmp_path, FixAnswered)}
    assert all(0 < fix.param2 < OLDEST_S for fix in fixes)
    texts = [item.message.text for item in autopilot.received if item.message.get_type() == "STATUSTEXT"]
    assert texts
    (stopped,) = journal(tmp_path, Stopped)
    assert stopped.frames_used >= FRAMES // 3, "a busy computer drops some"
    assert {"regions", "network", "matching", "search", "telemetry"} <= set(stopped.stages_ms)


def config_of(street: Path, folder: Path, cable: PtyLink) -> Config:
    return Config(
        camera=CameraConfig(kind="feed", device=str(street / "feed")),
        map=MapConfig(path=str(street / "map")),
        plugins={"page": PageConfig(port=0)},
        telemetry=TelemetryConfig(connection=f"serial:{cable.device}:921600", journal=str(folder / "events.jsonl")),
    )


def test_a_feed_begins_once_the_autopilot_has_reported_a_speed(street: Path, tmp_path: Path, cable: PtyLink) -> None:
    """Else its first frames would be places by time, though the map's are by distance."""
    autopilot = SimulatedAutopilot(cable, straight_line(5.0, 0.0, time.monotonic()))
    config = config_of(street, tmp_path, cable)
    stop = threading.Event()
    flying = threading.Thread(target=autopilot.run, args=(stop,))
    flying.start()
    try:
        with ExitStack() as parts:
            OpenedParts(config, parts)  # and no turn of a daemon
    finally:
        stop.set()
        flying.join()
    assert "up" in [one.state for one in journal(tmp_path, LinkChanged)]


def test_a_feed_begins_with_the_vehicle_that_follows_it(street: Path, tmp_path: Path, cable: PtyLink) -> None:
    """With its own first frame it was 0.8 s ahead on a busy machine, and GPS 7 to 12 m off."""
    start = VehicleStart()

    def pose_at(time_s: float) -> Pose:
        since_s = max(0.0, time_s - start.time_s)
        return Pose(0.0, 5.0 * since_s, 0.0, 5.0 if since_s > 0 else 0.0, 5.0 * since_s)

    autopilot, stop = SimulatedAutopilot(cable, pose_at), threading.Event()

    def fly() -> None:
        while not stop.wait(0.01):
            autopilot.step()
            for one in autopilot.received:
                start.hear(one.message, one.time_s)

    config = config_of(street, tmp_path, cable)
    flying = threading.Thread(target=fly)
    flying.start()
    try:
        with ExitStack() as parts:
            frame = OpenedParts(config, parts).camera.take(PATIENCE_S)
    finally:
        stop.set()
        flying.join()
    assert frame is not None
    begun_s = frame.stamp_ns / 1e9 - frame.index * PERIOD_MS / 1000
    assert begun_s == pytest.approx(start.time_s, abs=0.2)


def test_a_port_that_vanishes_costs_the_link_and_nothing_else(street: Path, tmp_path: Path, cable: PtyLink) -> None:
    process = start(street, tmp_path, f"serial:{cable.device}:921600")
    wait_for(lambda: journal(tmp_path, PlaceFix), "first event")
    before = len(journal(tmp_path, PlaceFix))
    cable.close()
    wait_for(lambda: journal(tmp_path, LinkChanged)[-1].state == "closed", "lost link")
    wait_for(lambda: len(journal(tmp_path, PlaceFix)) > before, "event after it")
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE_S) == 0
    told = process.communicate()[1]
    assert "Traceback" not in told
    assert [line for line in told.splitlines() if cable.device in line and "trying again" in line]
    assert journal(tmp_path, LinkChanged)[-1].state == "closed"
    assert len(journal(tmp_path, PlaceFix)) > before
