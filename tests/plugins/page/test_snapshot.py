"""What the daemon publishes for the live page; publishing it costs next to nothing."""

from __future__ import annotations

import json
import logging
import socket
import tracemalloc
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")

from edge.camera import CameraHealth, Frame
from edge.config import Config, RigConfig, SamplingConfig, SequenceConfig
from edge.descriptor.network import Network
from edge.feed import read_feed
from edge.journal.records import FrameUsed
from edge.localization.place_fix import frame_used
from edge.recognition.recognizer import PlaceRecognizer, open_recognizer
from edge.reference_map import MapSet, ReferenceMap, Route, open_map
from edge.telemetry import LinkStatus
from edge_plugins.mapping.status import MappingStatus, MappingView
from edge_plugins.page import PageConfig
from edge_plugins.page.plugin import open_page
from edge_plugins.page.snapshot import DaemonStatus, LiveStatus, PageSnapshot, map_view
from sim.traverse import traverse

FRAMES, LENGTH = 30, 10
MAPPING = MappingView(
    MappingStatus("waiting", "no GPS", "20260101T120000Z", 40, 32, 80.0), ((47.0, 8.0), (47.1, 8.0)), 1,
)  # fmt: skip


@pytest.fixture(scope="module")
def street(make_street: Callable[..., Path]) -> ReferenceMap:
    return open_map(make_street(range(FRAMES)) / "map")


@pytest.fixture
def recognizer(street: ReferenceMap, grid: Network) -> PlaceRecognizer:
    config = Config(sampling=SamplingConfig(by="frames"), sequence=SequenceConfig(length=LENGTH))
    return open_recognizer(config, network=grid, map_set=MapSet.of(street))


@pytest.fixture
def watched(street: ReferenceMap, recognizer: PlaceRecognizer) -> LiveStatus:
    """The status after a drive along the map."""
    status = LiveStatus("a model", 1.08)
    for item in traverse(read_feed(street.path.with_name("feed")), SamplingConfig()):
        show(status, recognizer, item.frame)
    return status


def snapshot(status: LiveStatus, recognizer: PlaceRecognizer) -> PageSnapshot:
    daemon = DaemonStatus(
        stamp_ns=10**9 * FRAMES,
        map_name="a map",
        state="on the map",
        why="",
        camera=CameraHealth("running", "", 0, delivered=FRAMES),
        link=LinkStatus("closed", "serial:none:57600", "report"),
        stages_ms={"network": 8.5},
        journal_lost=0,
        mapping=MAPPING,
    )
    return status.snapshot(daemon)


def show(status: LiveStatus, recognizer: PlaceRecognizer, frame: Frame) -> None:
    match = recognizer.observe(frame.image, frame.stamp_ns)
    used = frame_used(frame.index, frame.stamp_ns, match, Route(recognizer.map_set), RigConfig())
    status.add(frame, match, used, (-27.0, 153.0))


def test_a_snapshot_shows_the_newest_frame_and_how_it_came_to_its_place(
    watched: LiveStatus, recognizer: PlaceRecognizer
) -> None:
    shown = snapshot(watched, recognizer)
    status = shown.status
    assert (status.frames_used, status.state, status.camera.delivered) == (FRAMES, "on the map", FRAMES)
    assert status.newest is not None
    assert status.newest.place == FRAMES - 1
    assert shown.image is not None
    assert [sample.used.uniqueness is None for sample in status.history] == [True] * (LENGTH - 1) + [False] * (
        FRAMES - LENGTH + 1
    )


def test_meters_are_counted_until_a_place_is_recognized(watched: LiveStatus, recognizer: PlaceRecognizer) -> None:
    shown = snapshot(watched, recognizer).status
    unrecognized = len(list(takewhile(lambda one: not one.used.accepted, reversed(shown.history))))
    assert shown.searched == (2.0 * unrecognized, 80.0, "m")
    nothing = FrameUsed(FRAMES, FRAMES * 10**9, False, False)
    frame = Frame(np.zeros((4, 4, 3), np.uint8), nothing.stamp_ns, FRAMES)
    watched.add(frame, None, nothing, (0.0, 0.0))
    assert snapshot(watched, recognizer).status.searched[0] == 2.0 * (unrecognized + 1)
    watched.add(frame, None, FrameUsed(FRAMES + 1, FRAMES * 10**9 + 1, True, False), (0.0, 0.0))
    assert snapshot(watched, recognizer).status.searched[0] == 0.0


def test_a_snapshot_has_the_map_of_this_drive(watched: LiveStatus, recognizer: PlaceRecognizer) -> None:
    shown = json.loads(snapshot(watched, recognizer).as_json(0))["mapping"]
    assert shown["status"]["why"] == "no GPS"
    assert shown["line"] == [[47.0, 8.0], [47.1, 8.0]]


def test_a_snapshot_is_not_changed_by_later_frames(
    watched: LiveStatus, recognizer: PlaceRecognizer, street: ReferenceMap
) -> None:
    before = snapshot(watched, recognizer)
    history = before.status.history
    item = next(traverse(read_feed(street.path.with_name("feed")), SamplingConfig()))
    show(watched, recognizer, Frame(np.ascontiguousarray(item.frame.image[:, ::-1]), 60 * 10**9, FRAMES))
    assert before.status.history == history


def test_adding_a_frame_keeps_the_picture_and_copies_nothing(
    watched: LiveStatus, recognizer: PlaceRecognizer, street: ReferenceMap
) -> None:
    """It runs for every frame, whether somebody looks or not: the work waits for a snapshot."""
    item = next(traverse(read_feed(street.path.with_name("feed")), SamplingConfig()))
    tracemalloc.start()
    for _ in range(100):
        watched.add(item.frame, None, FrameUsed(item.frame.index, item.frame.stamp_ns), None)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert snapshot(watched, recognizer).image is item.frame.image
    assert peak_bytes < item.frame.image.nbytes


def test_no_page_is_no_reason_to_stop(street: ReferenceMap, caplog: pytest.LogCaptureFixture) -> None:
    assert not PageConfig(port=0).asks(Config())
    with socket.create_server(("127.0.0.1", 0)) as taken, caplog.at_level(logging.INFO):
        assert open_page(PageConfig(port=taken.getsockname()[1]), map_view(MapSet.of(street))) is None
        assert "no live page: [page] 127.0.0.1:" in caplog.text
        assert "Address already in use" in caplog.text
        assert open_page(PageConfig(bind="203.0.113.1", port=8642), map_view(MapSet.of(street))) is None
