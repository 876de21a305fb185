"""Real cameras: `pytest -m hardware tests/hardware`; LOOKBACK_V4L2, LOOKBACK_OAK and LOOKBACK_STREAM name devices."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import numpy as np
import pytest

from edge.camera import Camera, open_camera
from edge.config import CameraConfig

pytestmark = pytest.mark.hardware


@pytest.fixture(params=["v4l2", "oak", "stream"])
def camera(request: pytest.FixtureRequest) -> Iterator[Camera]:
    variable = f"LOOKBACK_{request.param.upper()}"
    if variable not in os.environ:
        pytest.skip(f"set {variable} to the device to test")
    opened = open_camera(CameraConfig(kind=request.param, device=os.environ[variable], width=640, height=480, fps=15))
    yield opened
    opened.close()


def test_frames_come_in_the_size_and_at_the_rate_asked_for_with_stamps_of_the_monotonic_clock(camera: Camera) -> None:
    assert camera.differences == ()
    stamps_ns = []
    for _ in range(45):
        frame = camera.read()
        assert frame is not None
        assert frame.image.shape == (480, 640, 3)
        assert 0 < time.monotonic_ns() - frame.stamp_ns < 500_000_000
        stamps_ns.append(frame.stamp_ns)
    periods_s = np.diff(stamps_ns[15:]) / 1e9  # once exposure has settled
    assert np.all(periods_s > 0)
    assert np.median(periods_s) == pytest.approx(1 / 15, rel=0.1)


def test_a_camera_opens_again_after_it_was_closed(camera: Camera) -> None:
    assert camera.read() is not None
    camera.close()
    camera.close()
