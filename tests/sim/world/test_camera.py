"""What the simulator does beyond the contract that all cameras share (tests/camera/test_contract.py)."""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("panda3d")

from edge.camera import open_camera
from edge.config import CameraConfig
from edge.errors import ConfigError
from sim.world.camera import BANDS, SimCamera, open_renderer, picture
from sim.world.scenario import Scenario
from tests.moved_clock import Clock

EPOCH_NS = 5_000_000_000
SCENARIO = Scenario(length_m=200.0, speed_mps=20.0, width=64, height=48, epoch_ns=EPOCH_NS)
CONFIG = CameraConfig(kind="sim", width=64, height=48, fps=10.0)


def open_at(now_ns: int) -> tuple[SimCamera, Clock]:
    clock = Clock(now_ns)
    return SimCamera(SCENARIO, CONFIG, clock, clock.sleep), clock


def test_a_frame_is_the_view_from_where_the_drive_is_at_its_stamp() -> None:
    camera, clock = open_at(EPOCH_NS)
    clock.sleep(3.0)
    frame = camera.read()
    assert frame is not None
    assert frame.stamp_ns == EPOCH_NS + 3_000_000_000
    drive = SCENARIO.drive()
    renderer = open_renderer(SCENARIO, drive)
    assert np.array_equal(frame.image, renderer.render(drive.pose(3.0), 3.0))
    renderer.close()
    camera.close()


def test_a_sensor_that_reads_row_after_row_shows_the_lower_rows_later() -> None:
    rolling = msgspec.structs.replace(SCENARIO, readout_s=0.1)
    drive = rolling.drive()
    renderer = open_renderer(rolling, drive)
    seen = picture(renderer, rolling, drive, 6.0).astype(int)
    for band, late_s in ((0, -0.04375), (BANDS - 1, 0.04375)):
        rows = slice(band * rolling.height // BANDS, (band + 1) * rolling.height // BANDS)
        off = [
            np.abs(renderer.develop(renderer.render_scene(drive.pose(6.0 + at_s), 6.0), 6.0).astype(int) - seen)[rows]
            for at_s in (late_s, 0.0)
        ]
        assert off[0].mean() < 0.5 * off[1].mean()
    renderer.close()


def test_before_the_epoch_it_stands_at_the_start() -> None:
    camera, _ = open_at(EPOCH_NS - 300_000_000)
    images = []
    while (frame := camera.read()) is not None and frame.stamp_ns <= EPOCH_NS:
        images.append(frame.image.astype(int))
    assert len(images) == 4
    # Only noise differs between frames of one place.
    assert all(np.abs(image - images[0]).mean() < 8 for image in images)
    camera.close()


def test_a_late_reader_gets_the_newest_frame_and_sees_what_it_missed() -> None:
    camera, clock = open_at(EPOCH_NS)
    first = camera.read()
    clock.sleep(1.23)
    late = camera.read()
    assert first is not None
    assert late is not None
    assert late.index - first.index == 12
    assert late.stamp_ns == EPOCH_NS + 1_200_000_000
    camera.close()


def test_it_ends_when_the_drive_ends_and_after_close() -> None:
    camera, clock = open_at(EPOCH_NS)
    clock.sleep(SCENARIO.drive().duration_s - 0.15)
    assert camera.read() is not None
    while camera.read() is not None:
        pass
    assert camera.read() is None
    camera.close()
    camera.close()
    assert camera.read() is None


def test_the_config_opens_it_by_name_and_it_says_what_differs(tmp_path: Path) -> None:
    scenario = tmp_path / "drive.toml"
    scenario.write_text("length_m = 200.0\nwidth = 96\nheight = 48\n")
    camera = open_camera(CameraConfig(kind="sim", device=str(scenario), width=64, height=48))
    assert camera.differences == ("width: asked for 64, the scenario gives 96",)
    frame = camera.read()
    assert frame is not None
    assert frame.image.shape == (48, 96, 3)
    camera.close()
    scenario.write_text("color = 1\n")
    with pytest.raises(ConfigError, match=r"drive\.toml: unknown key `color`"):
        open_camera(CameraConfig(kind="sim", device=str(scenario)))


def test_a_computer_without_the_renderers_library_reads_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "drive.toml").write_text("length_m = 200.0\n")
    command = [sys.executable, "-m", "edge", "dev", "sim", "drive", "drive.toml", "-o", "feed"]
    with contextlib.suppress(OSError):
        ctypes.CDLL("libX11.so.6")
        mapped = re.findall(r"(?m) (/\S*/libX11\.so\.6\S*)$", Path("/proc/self/maps").read_text())
        if shutil.which("unshare") is None or os.geteuid() != 0:
            pytest.skip("needs unshare (util-linux) and root, to hide libX11")
        hide = f'mount --bind /dev/null {mapped[0]} && exec "$@"'
        command = ["unshare", "--mount", "sh", "-c", hide, "sh", *command]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    if "permission denied" in done.stderr:
        pytest.skip(f"may not mount here: {done.stderr.strip()}")
    assert re.fullmatch(r"lookback: .* needs .*libX11\.so\.6: .*apt-get install libx11-6\n", done.stderr), done.stderr
    assert done.returncode != 0
