"""What every camera promises, held against each that can run here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.camera import Camera, Frame
from edge.camera.recorded import RecordedCamera
from edge.config import CameraConfig
from edge.feed import read_feed
from edge_plugins.cameras.oak import OakCamera, OakSource
from sim.world.camera import SimCamera
from sim.world.scenario import Scenario
from tests.moved_clock import Clock

WIDTH, HEIGHT = 64, 48


@pytest.fixture(params=["folder", "video", "oak", "sim"])
def camera(request: pytest.FixtureRequest, feed_path: Path, video_path: Path) -> Camera:
    clock = Clock()
    if request.param == "folder":
        return RecordedCamera(read_feed(feed_path), clock, clock.sleep)
    if request.param == "video":
        return RecordedCamera(read_feed(video_path), clock, clock.sleep)
    if request.param == "oak":
        build: Callable[[CameraConfig], OakSource] = request.getfixturevalue("oak_on_host")
        return OakCamera(CameraConfig(kind="oak", device=str(video_path), width=WIDTH, height=HEIGHT), build)
    pytest.importorskip("panda3d")
    scenario = Scenario(length_m=200, speed_mps=40, width=WIDTH, height=HEIGHT)
    return SimCamera(scenario, CameraConfig(kind="sim", width=WIDTH, height=HEIGHT, fps=5.0), clock, clock.sleep)


def test_the_contract_of_a_camera(camera: Camera) -> None:
    frames: list[Frame] = []
    first_means: list[float] = []
    while (frame := camera.read()) is not None:
        frames.append(frame)
        first_means.append(float(frame.image.mean()))
        assert frame.image.shape == (HEIGHT, WIDTH, 3)
        assert frame.image.dtype == np.uint8
        assert frame.image.flags.c_contiguous
    assert len(frames) > 1
    stamps_ns, indices = [frame.stamp_ns for frame in frames], [frame.index for frame in frames]
    assert all(isinstance(value, int) for value in stamps_ns + indices)
    assert all(np.diff(stamps_ns) > 0)
    assert all(np.diff(indices) > 0)
    # Later reads do not write into a frame that was handed on, and no two pictures are the same.
    assert [float(frame.image.mean()) for frame in frames] == first_means
    assert len(set(first_means)) == len(frames)
    assert camera.read() is None
    assert isinstance(camera.differences, tuple)
    camera.close()
    camera.close()


def test_a_recordings_picture_is_that_of_its_index(feed_path: Path, video_path: Path) -> None:
    clock = Clock()
    for path in (feed_path, video_path):
        for frame in iter(RecordedCamera(read_feed(path), clock, clock.sleep).read, None):
            assert round((float(frame.image.mean()) - 20) / 16) == frame.index
