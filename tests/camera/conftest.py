"""DepthAI without a device, and streams on a busy machine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import CameraConfig
from edge.errors import ConfigError
from edge_plugins.cameras import stream
from edge_plugins.cameras.oak import OakSource, import_depthai


def index_of(image: NDArray[np.uint8]) -> int:
    return round((float(image.mean()) - 20) / 16)


BUSY_S = 60.0


@pytest.fixture
def busy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets a stream be late: beside other work, its images come faster than they are decoded for seconds."""
    pytest.importorskip("av")
    monkeypatch.setattr(stream, "BEHIND_NS", round(BUSY_S * 1e9))
    monkeypatch.setattr(stream, "FIRST_FRAME_S", BUSY_S)


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
