"""A small feed and a small video, written with the parts that the program itself writes with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.camera.oak import OakSource, import_depthai
from edge.config import CameraConfig
from edge.errors import ConfigError
from edge.feed import FeedHeader, FeedWriter

COUNT = 12
WIDTH, HEIGHT = 64, 48
PERIOD_NS = 50_000_000


def picture(index: int) -> NDArray[np.uint8]:
    """A picture whose mean level tells its index, whatever a lossy codec makes of it."""
    return np.full((HEIGHT, WIDTH, 3), 20 + 16 * index, np.uint8)


def index_of(image: NDArray[np.uint8]) -> int:
    return round((float(image.mean()) - 20) / 16)


@pytest.fixture
def feed_path(tmp_path: Path) -> Path:
    path = tmp_path / "feed"
    with FeedWriter(path, FeedHeader("test", "front", WIDTH, HEIGHT)) as writer:
        for index in range(COUNT):
            writer.write(picture(index), 1_000_000_000 + index * PERIOD_NS, distance_m=float(index))
    return path


@pytest.fixture
def video_path(tmp_path: Path) -> Path:
    """MJPG in AVI at 20 frames a second: what every OpenCV build writes."""
    path = tmp_path / "drive.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (WIDTH, HEIGHT))
    for index in range(COUNT):
        video.write(picture(index))
    video.release()
    return path


@pytest.fixture
def oak_on_host() -> Callable[..., OakSource]:
    """Builds DepthAI pipelines that replay a video on the host: all of OakCamera but the device."""
    try:
        dai = import_depthai()  # not importorskip, which would import it before its telemetry is off
    except ConfigError as error:
        pytest.skip(str(error))

    def build(config: CameraConfig, fps: float = 50.0, loop: bool = False) -> OakSource:
        pipeline = dai.Pipeline(False)
        replay = pipeline.create(dai.node.ReplayVideo)
        replay.setReplayVideoFile(Path(config.device))
        replay.setOutFrameType(dai.ImgFrame.Type.BGR888i)
        replay.setSize(config.width, config.height)
        replay.setFps(fps)
        replay.setLoop(loop)
        return OakSource(pipeline, replay.out, f"replay of {config.device}")

    return build
