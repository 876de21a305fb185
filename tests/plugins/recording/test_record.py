from __future__ import annotations

import logging
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from edge.camera.picture_age import UNDATED
from edge.config import CameraConfig, Config, SamplingConfig, TelemetryConfig
from edge.errors import CameraLost, ConfigError, FeedError
from edge.feed import FeedHeader, FeedImages, FeedRow, read_feed
from edge.feed.writer import FeedWriter
from edge_plugins.recording import RecordingConfig
from edge_plugins.recording.command import record
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import open_pty
from tests.common import PATIENCE_S
from tests.files_written import full_disk

COUNT = 40
PERIOD_NS = 10_000_000


def write_feed(path: Path, count: int, period_ns: int = PERIOD_NS) -> Path:
    with FeedWriter(path, FeedHeader("drive", "front", 32, 24)) as writer:
        for index in range(count):
            writer.write(np.full((24, 32, 3), 5 * index % 256, np.uint8), FeedRow("", index * period_ns))
    return path


@pytest.fixture
def config(tmp_path: Path) -> Config:
    """A feed in the camera's place, and no autopilot: a serial port that is not there."""
    return Config(
        camera=CameraConfig(kind="feed", view="rear", device=str(write_feed(tmp_path / "camera", COUNT))),
        sampling=SamplingConfig(by="time", interval_s=0.05),
        telemetry=TelemetryConfig(connection=f"serial:{tmp_path}/no-port:921600"),
    )


def test_without_an_autopilot_frames_are_taken_by_time_and_have_no_position(config: Config, tmp_path: Path) -> None:
    done = record(config, tmp_path / "new/out", threading.Event())
    feed = read_feed(tmp_path / "new/out")
    assert (done.frames, done.with_position, done.why) == (len(feed.rows), 0, "camera ended")
    assert (feed.header.name, feed.header.view, feed.header.width, feed.header.height) == ("out", "rear", 32, 24)
    gaps_s = np.diff([row.stamp_ns for row in feed.rows]) / 1e9
    assert 2 <= len(feed.rows) <= 8  # of 0.4 s, a frame each 0.05 s
    assert gaps_s.min() >= 0.05
    assert all(row.lat_deg is None and row.distance_m is None for row in feed.rows)
    assert FeedImages(feed).read(0).shape == (24, 32, 3)


@pytest.fixture
def drive_north() -> Iterator[tuple[str, float]]:
    """A simulated autopilot at the other end of a pty that drives north at 10 m/s; its device, and its speed."""
    link = open_pty()
    stop = threading.Event()

    def pose_at(time_s: float) -> Pose:
        return Pose(0.0, 10.0 * (time_s % 1e4), 0.0, 10.0, 10.0 * (time_s % 1e4))

    thread = threading.Thread(target=SimulatedAutopilot(link, pose_at).run, args=(stop,))
    thread.start()
    yield link.device, 10.0
    stop.set()
    thread.join()
    link.close()


class StopsWhere(threading.Event):
    """Stops a recording once something is so."""

    def __init__(self, is_so: Callable[[], bool]) -> None:
        super().__init__()
        self._is_so = is_so

    def is_set(self) -> bool:
        return self._is_so()


def placed_rows(folder: Path) -> list[FeedRow]:
    """Those of a recording so far that have distance and position."""
    if not (folder / "frames").exists() or not any((folder / "frames").iterdir()):
        return []
    return [row for row in read_feed(folder).rows if row.distance_m is not None and row.lat_deg is not None]


def test_with_an_autopilot_frames_are_taken_by_distance_and_have_its_position(
    config: Config,
    tmp_path: Path,
    drive_north: tuple[str, float],
    play_on: Callable[..., Path],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """What a daemon has kept beside its journal is not touched: a damaged file is not even read."""
    device, speed_mps = drive_north
    (kept := tmp_path / "events.wheels").write_text("damaged")
    config = replace(
        config,
        camera=replace(config.camera, device=str(play_on(Path(config.camera.device), tmp_path / "longer", PERIOD_NS))),
        sampling=SamplingConfig(by="distance", spacing_m=1.0, interval_s=0.05),
        telemetry=TelemetryConfig(connection=f"serial:{device}:921600", journal=str(tmp_path / "events.jsonl")),
    )
    done = record(config, tmp_path / "out", StopsWhere(lambda: len(placed_rows(tmp_path / "out")) >= 6))
    assert kept.name not in caplog.text and sorted(tmp_path.glob("events.*")) == [kept]
    rows = placed_rows(tmp_path / "out")
    assert done.with_position >= len(rows) >= 6
    stamps_s, meters = np.array([row.stamp_ns / 1e9 for row in rows]), np.array([row.distance_m for row in rows])
    assert np.median(np.diff(meters)) > 0.8  # by time each would be 0.5 m on; a busy machine uses fewer frames
    assert np.ptp(meters) / np.ptp(stamps_s) == pytest.approx(speed_mps, rel=0.2)
    for row in rows:
        assert row.speed_mps == pytest.approx(speed_mps, abs=0.1)
        assert row.heading_deg == pytest.approx(0.0, abs=0.1)
        assert row.lon_deg == pytest.approx(153.0283, abs=1e-4)
    assert {row.position_source for row in rows[-2:]} == {"gps"}


def test_it_stops_before_the_disk_is_full(config: Config, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def free_bytes(path: Path) -> int:
        return 1000 - len(list(out.glob("frames/*")))

    slow = str(write_feed(tmp_path / "slow", 10, 200_000_000))  # a busy machine uses three of these as well
    config = replace(config, camera=replace(config.camera, device=slow))
    done = record(config, out, threading.Event(), min_free_bytes=998, free_bytes=free_bytes)
    assert (done.frames, done.why) == (3, "disk nearly full")
    assert len(read_feed(out).rows) == 3


def test_a_disk_that_refuses_a_frame_is_one_line_and_the_feed_stays_whole(config: Config, tmp_path: Path) -> None:
    why = r"out: (stopped after 0 frames: File too large|cannot write a feed here)"
    with full_disk(150), pytest.raises(FeedError, match=why):  # room for feed.toml and no picture
        record(config, tmp_path / "out", threading.Event())


def test_where_no_picture_is_kept_nothing_is_recorded(config: Config, tmp_path: Path) -> None:
    private = replace(config, camera=replace(config.camera, keep_pictures=False))
    with pytest.raises(ConfigError, match=r"\[camera\] keep_pictures: is false.*set it to true to record"):
        record(private, tmp_path / "out", threading.Event())
    assert not (tmp_path / "out").exists()
    asked = RecordingConfig(folder=str(tmp_path))
    assert asked.asks(config) and not asked.asks(private)


def test_nothing_recorded_says_why(config: Config, tmp_path: Path) -> None:
    no_camera = replace(config, camera=CameraConfig(device="/dev/video-none"))
    with pytest.raises(CameraLost, match=r"out: nothing recorded \(duration reached\): /dev/video-none: No such file"):
        record(no_camera, tmp_path / "out", threading.Event(), duration_s=0.05)
    assert not (tmp_path / "out").exists()


class StopsAt(logging.Handler):
    """Stops a recording when the log says something."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.stop, self._text = threading.Event(), text

    def emit(self, record: logging.LogRecord) -> None:
        if self._text in record.getMessage():
            self.stop.set()


def test_a_stream_whose_age_is_not_known_is_not_recorded_with_positions(
    config: Config, tmp_path: Path, drive_north: tuple[str, float]
) -> None:
    """The vehicle never starts nor turns, so that nothing shows how old the pictures are."""
    pytest.importorskip("av")
    writer = Path(__file__).parents[2] / "camera/write_stream.py"
    config = replace(
        config,
        camera=CameraConfig(kind="stream", device=f"exec:{sys.executable} {writer} mpegts mpeg4 100000"),
        telemetry=TelemetryConfig(connection=f"serial:{drive_north[0]}:921600"),
    )
    stops = StopsAt(UNDATED)
    logging.getLogger("edge_plugins.recording.command").addHandler(stops)
    try:
        done = record(config, tmp_path / "out", stops.stop, duration_s=PATIENCE_S)
        assert (done.why, done.with_position) == ("stopped by a signal", 0)
    except CameraLost as nothing:  # a busy machine hears the autopilot before the first picture
        assert str(nothing).endswith(f"nothing recorded (stopped by a signal): {UNDATED}")
    finally:
        logging.getLogger("edge_plugins.recording.command").removeHandler(stops)


def test_a_feed_that_is_there_already_is_not_touched(config: Config, tmp_path: Path) -> None:
    with pytest.raises(FeedError, match="camera: a feed already exists here"):
        record(config, tmp_path / "camera", threading.Event())
    assert len(read_feed(tmp_path / "camera").rows) == COUNT


@pytest.fixture
def config_file(config: Config, tmp_path: Path) -> Path:
    write_feed(tmp_path / "long", 256, 100_000_000)
    file = tmp_path / "config.toml"
    file.write_text(
        '[camera]\nkind = "feed"\ndevice = "long"\n[sampling]\nby = "frames"\n'
        f'[telemetry]\nconnection = "{config.telemetry.connection}"\n'
    )
    return file


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_closes_the_feed_whole(config_file: Path, tmp_path: Path, number: signal.Signals) -> None:
    out = tmp_path / "out"
    with subprocess.Popen(
        [sys.executable, "-m", "edge", "record", str(config_file), "-o", str(out)], stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        while not (out / "frames/000001.jpg").exists():  # until it records
            with suppress(subprocess.TimeoutExpired):
                pytest.fail(f"it ended by itself: {process.wait(0.02)}, {process.stderr.read()}")
        process.send_signal(number)
        errors = process.stderr.read()
        assert process.wait(60) == 0, errors
    rows = read_feed(out).rows
    assert f"{out}: {len(rows)} frames, 0 with a position; stopped by a signal" in errors
    assert "Traceback" not in errors
    assert len(rows) == len(list((out / "frames").iterdir())) and len(rows) < 256
