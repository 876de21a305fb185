"""What every camera promises, held against each that can run here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.camera import Camera, Frame, open_camera
from edge.camera.feed import read_feed
from edge.camera.oak import OakCamera, OakSource
from edge.camera.recorded import RecordedCamera
from edge.config import CameraConfig

WIDTH, HEIGHT = 64, 48


@pytest.fixture(params=["folder", "folder in real time", "video", "oak"])
def camera(request: pytest.FixtureRequest, feed_path: Path, video_path: Path) -> Camera:
    if request.param == "folder":
        return RecordedCamera(read_feed(feed_path))
    if request.param == "folder in real time":
        return open_camera(CameraConfig(kind="feed", device=str(feed_path)))
    if request.param == "video":
        return RecordedCamera(read_feed(video_path))
    build: Callable[[CameraConfig], OakSource] = request.getfixturevalue("oak_on_host")
    return OakCamera(CameraConfig(kind="oak", device=str(video_path), width=WIDTH, height=HEIGHT), build)


def test_the_contract_of_a_camera(camera: Camera) -> None:
    frames: list[Frame] = []
    while (frame := camera.read()) is not None:
        frames.append(frame)
        assert frame.image.shape == (HEIGHT, WIDTH, 3)
        assert frame.image.dtype == np.uint8
        assert frame.image.flags.c_contiguous
    assert len(frames) > 1
    stamps_ns, indices = [frame.stamp_ns for frame in frames], [frame.index for frame in frames]
    assert all(isinstance(value, int) for value in stamps_ns + indices)
    assert all(np.diff(stamps_ns) > 0)
    assert all(np.diff(indices) > 0)
    # The picture is that of the index, and still is after later reads: nobody writes into a frame that was handed on.
    assert [round((float(frame.image.mean()) - 20) / 16) for frame in frames] == indices
    assert camera.read() is None
    assert isinstance(camera.differences, tuple)
    camera.close()
    camera.close()
