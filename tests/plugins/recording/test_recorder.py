"""[recording]: a feed of the run, which never costs the run anything."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.camera import Frame
from edge.config import CameraConfig
from edge.feed import read_feed
from edge.files import named_by_time
from edge.geodesy import VehiclePosition
from edge.journal.records import Stopped
from edge_plugins.recording.recorder import QUEUE_FRAMES, Recorder, begun_feed
from sim.journal import records_of
from tests.common import PATIENCE_S

NOON_S = 1_700_000_000.0
NAME = "20231114T221320Z"
CAMERA = CameraConfig(kind="v4l2", view="rear")


def frame(index: int) -> Frame:
    return Frame(np.full((24, 32, 3), index, np.uint8), index * 1000, index)


def position(index: int) -> VehiclePosition:
    return VehiclePosition(index * 1000, 1.0, 2.0, 3.0, 90.0, 4.0, sigma_m=1.5, source="dgps")


def open_recorder(folder: Path, **options: Any) -> Recorder:
    return Recorder(lambda frame: begun_feed(named_by_time(folder, NOON_S), CAMERA, frame), 5e8, **options)


def record(folder: Path, count: int = 5, **options: Any) -> Recorder:
    """A whole run of some frames."""
    recording = open_recorder(folder, **options)
    for index in range(count):
        recording.record(frame(index), 2.0 * index, position(index) if index else None)
    recording.close()
    return recording


def test_a_run_becomes_a_feed(tmp_path: Path) -> None:
    assert record(tmp_path / "runs").written == 5
    feed = read_feed(tmp_path / "runs" / NAME)
    assert (feed.header.name, feed.header.view, feed.header.width) == (NAME, "rear", 32)
    assert not feed.header.odometer, "while GPS works, the autopilot's distance is GPS's own, and vouches for nothing"
    assert [row.distance_m for row in feed.rows] == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert (feed.rows[0].lat_deg, feed.rows[1].lat_deg, feed.rows[1].speed_mps) == (None, 1.0, 4.0)
    assert [(row.position_sigma_m, row.position_source) for row in feed.rows[:2]] == [(None, "unknown"), (1.5, "dgps")]


def test_every_run_has_a_folder_of_its_own(tmp_path: Path) -> None:
    record(tmp_path)
    record(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [NAME, f"{NAME}-2"]


def test_it_goes_on_when_there_is_room_again(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    free = iter([1e9, 1e9, 0.0, 0.0, 1e9])
    recording = record(tmp_path, free_bytes=lambda path: int(next(free)), retry_s=0.0)
    assert (recording.written, recording.stopped) == (3, "")
    assert [row.stamp_ns for row in read_feed(tmp_path / NAME).rows] == [0, 1000, 4000]
    assert [line.partition(": ")[2] for line in caplog.messages] == [
        f"{tmp_path / NAME}: waits after 2 frames: the disk is nearly full",
        f"{tmp_path / NAME}: goes on",
    ]


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").touch()
    recording = record(tmp_path / "file", count=3 * QUEUE_FRAMES)
    assert recording.written == 0
    assert len([line for line in caplog.messages if "recording" in line]) == 1


def test_a_disk_that_hangs_costs_frames_of_the_recording_only(tmp_path: Path) -> None:
    test_is_done, waited_for = threading.Event(), []

    def free_bytes(path: Path) -> int:
        if not test_is_done.wait(PATIENCE_S):
            waited_for.append(path)
        return 10**10

    recording = open_recorder(tmp_path, free_bytes=free_bytes)
    for index in range(100):
        recording.record(frame(index), None, None)
    recording.close(timeout_s=0.1)
    assert not waited_for
    assert recording.skipped >= 100 - QUEUE_FRAMES - 2
    test_is_done.set()


def test_the_daemon_records_what_it_uses(make_street: Callable[..., Path], tmp_path: Path) -> None:
    street = make_street(range(20), period_ms=200)
    (tmp_path / "lookback.toml").write_text(
        f'[camera]\nkind = "feed"\ndevice = "{street}/feed"\n[sampling]\nby = "frames"\n[map]\npath = "{street}/map"\n'
        '[sequence]\nlength = 10\n[telemetry]\nconnection = "serial:none:57600"\njournal = "events.jsonl"\n'
        '[page]\nport = 0\n[recording]\nfolder = "runs"\nmin_free_mb = 0\n'
    )
    command = [sys.executable, "-m", "edge", "run", str(tmp_path / "lookback.toml")]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (run,) = (tmp_path / "runs").iterdir()
    (stopped,) = records_of(tmp_path / "events.jsonl", Stopped)
    assert len(read_feed(run).rows) == stopped.frames_used and stopped.frames_used >= 10
