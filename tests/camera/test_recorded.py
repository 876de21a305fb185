from __future__ import annotations

from pathlib import Path

import pytest

from edge.camera.recorded import RecordedCamera
from edge.errors import FrameError
from edge.feed import read_feed
from tests.moved_clock import Clock


def test_each_frame_comes_when_it_is_due(feed_path: Path) -> None:
    clock = Clock()
    camera = RecordedCamera(read_feed(feed_path), clock, clock.sleep)
    started_ns = clock()
    for index, frame in enumerate(iter(camera.read, None)):
        assert frame.stamp_ns == clock() == started_ns + index * 50_000_000
    assert clock.slept_s == pytest.approx([0.05] * 11)


def test_a_frame_that_is_read_late_comes_at_once_stamped_when_it_was_due(feed_path: Path) -> None:
    clock = Clock()
    camera = RecordedCamera(read_feed(feed_path), clock, clock.sleep)
    first = camera.read()
    clock.now_ns += 120_000_000
    second = camera.read()
    assert first and second
    assert second.stamp_ns == first.stamp_ns + 50_000_000
    assert clock.slept_s == []


def test_an_unreadable_picture_is_one_frame_error_and_the_next_goes_on(feed_path: Path) -> None:
    (feed_path / "frames/000001.jpg").write_bytes(b"not a picture")
    clock = Clock()
    camera = RecordedCamera(read_feed(feed_path), clock, clock.sleep)
    assert camera.read() is not None
    with pytest.raises(FrameError, match=r"000001\.jpg: not a"):
        camera.read()
    frame = camera.read()
    assert frame is not None
    assert frame.index == 2
