from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from edge.camera import open_camera
from edge.config import CameraConfig
from edge.errors import CameraLost, ConfigError
from edge.extras import install_command
from edge_plugins.cameras.oak import OakCamera, OakSource

Build = Callable[..., OakSource]


def needs_depthai() -> None:
    """Skip without DepthAI; not importorskip, which would import it before its telemetry is off."""
    if importlib.util.find_spec("depthai") is None:
        pytest.skip("needs the extra oak")


def config(video_path: Path, **changes: object) -> CameraConfig:
    settings = {"kind": "oak", "device": str(video_path), "width": 64, "height": 48, "stall_timeout_s": 1.0} | changes
    return CameraConfig(**settings)  # type: ignore[arg-type]


def test_stamps_are_of_the_monotonic_clock_when_the_frame_was_made(video_path: Path, oak_on_host: Build) -> None:
    before_ns = time.monotonic_ns()
    camera = OakCamera(config(video_path), oak_on_host)
    frame = camera.read()
    assert frame is not None
    assert before_ns < frame.stamp_ns < time.monotonic_ns()
    camera.close()


def test_a_slow_reader_gets_the_newest_frame_and_not_a_queue_of_old_ones(video_path: Path, oak_on_host: Build) -> None:
    source = oak_on_host(config(video_path), fps=100.0, loop=True)
    every_frame: Any = source.output.createOutputQueue(maxSize=100, blocking=True)
    camera = OakCamera(config(video_path), lambda _: source)
    first = camera.read()
    assert first is not None
    while every_frame.get().getSequenceNum() < first.index + 6:  # the reader is busy for six frames
        pass
    frame = camera.read()
    assert frame is not None
    assert frame.index >= first.index + 5
    camera.close()


def test_a_frame_of_another_size_than_asked_for_is_said(video_path: Path, oak_on_host: Build) -> None:
    smaller = config(video_path)
    camera = OakCamera(config(video_path, width=80), lambda _: oak_on_host(smaller))
    assert camera.differences == ("width: asked for 80, device gives 64",)
    camera.close()


def test_a_device_that_gives_no_frame_in_time_is_lost(video_path: Path, oak_on_host: Build) -> None:
    camera = OakCamera(config(video_path, stall_timeout_s=0.1), partial(oak_on_host, fps=1.0))
    assert camera.read() is not None
    with pytest.raises(CameraLost, match=r"drive\.avi: no frame for 0\.1 s"):
        camera.read()
    camera.close()


def test_no_oak_is_one_line() -> None:
    needs_depthai()
    with pytest.raises(CameraLost, match="OAK camera: not found; is it plugged in"):
        open_camera(CameraConfig(kind="oak", device=""))
    with pytest.raises(CameraLost, match="OAK 19443010: not found"):
        open_camera(CameraConfig(kind="oak", device="19443010"))


def test_a_device_node_is_no_oak() -> None:
    needs_depthai()
    with pytest.raises(ConfigError, match=r"\[camera\] device: /dev/video0 is not an OAK device ID"):
        open_camera(CameraConfig(kind="oak"))


def run_python(code: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_without_depthai_the_error_names_the_extra() -> None:
    code = """
import sys
sys.modules["depthai"] = None  # what an import finds where it is not installed
from edge.camera import open_camera
from edge.config import CameraConfig
try:
    open_camera(CameraConfig(kind="oak", device=""))
except Exception as error:
    print(type(error).__name__, error)
"""
    assert run_python(code).stdout == f"ConfigError [camera] kind: oak needs DepthAI: {install_command('oak')}\n"


def test_depthai_leaves_the_signals_alone() -> None:
    needs_depthai()
    code = """
from pathlib import Path
from edge_plugins.cameras.oak import import_depthai
def signals():
    lines = Path("/proc/self/status").read_text().splitlines()
    caught = next(line for line in lines if line.startswith("SigCgt:"))
    return int(caught.split()[1], 16) & 0x7FFF_FFFF  # 32 and 33 are the C library's own
before = signals()
import_depthai()
assert signals() == before, (before, signals())
"""
    result = run_python(code)
    assert result.returncode == 0, result.stderr


def test_depthai_keeps_no_telemetry_files_and_opens_no_socket_to_the_network(video_path: Path, tmp_path: Path) -> None:
    needs_depthai()
    code = """
import os, sys
from pathlib import Path
from edge_plugins.cameras.oak import OakCamera, OakSource, import_depthai
from edge.config import CameraConfig
dai = import_depthai()
def build(config):
    pipeline = dai.Pipeline(False)
    replay = pipeline.create(dai.node.ReplayVideo)
    replay.setReplayVideoFile(Path(config.device))
    replay.setOutFrameType(dai.ImgFrame.Type.BGR888i)
    replay.setLoop(False)
    return OakSource(pipeline, replay.out, "replay")
camera = OakCamera(CameraConfig(device=sys.argv[1]), build)
while camera.read() is not None:
    pass
descriptors = [file for file in Path("/proc/self/fd").iterdir() if file.is_symlink()]
print(*[os.readlink(file) for file in descriptors], flush=True)
camera.close()
"""
    result = run_python(code, video_path, HOME=str(tmp_path / "home"), XDG_CACHE_HOME=str(tmp_path / "home/.cache"))
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip()
    assert "socket:" not in result.stdout
    assert [path for path in (tmp_path / "home").rglob("*") if path.is_file()] == []
