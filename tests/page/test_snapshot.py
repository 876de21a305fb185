"""What the daemon hands to the live page; that it is told costs next to nothing."""

from __future__ import annotations

import logging
import socket
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

pytest.importorskip("starlette")

from edge.camera import CameraHealth
from edge.config import Config, PageConfig, SamplingConfig, SequenceConfig
from edge.descriptor.network import Head, Network
from edge.feed import read_feed
from edge.feed.traverse import traverse
from edge.health.stage_times import StageTimes
from edge.page.snapshot import LiveStatus, map_view, open_page
from edge.recognizer import PlaceRecognizer
from edge.reference_map.costs import COST_ONE
from edge.reference_map.map_set import MapSet
from edge.reference_map.store import ReferenceMap, open_map
from edge.telemetry.autopilot import AutopilotConnection

FRAMES, LENGTH = 30, 10


@pytest.fixture(scope="module")
def street(make_street: Callable[..., Path]) -> ReferenceMap:
    return open_map(make_street(range(FRAMES)) / "map")


@pytest.fixture
def watched(street: ReferenceMap, network: Network, tmp_path: Path) -> LiveStatus:
    """The status after a drive along the map."""
    config = Config(sequence=SequenceConfig(length=LENGTH))
    config = replace(config, telemetry=replace(config.telemetry, connection=f"serial:{tmp_path}/none:57600"))
    recognizer = PlaceRecognizer(network, Head.load(network), street, config)
    with closing(AutopilotConnection(config.telemetry)) as autopilot:
        status = LiveStatus(
            config,
            "a model",
            recognizer,
            StageTimes(),
            lambda: CameraHealth("running", "", 0, delivered=FRAMES),
            autopilot,
            None,
            lambda: 10**9 * FRAMES,
        )
        for item in traverse(read_feed(street.path.with_name("feed")), config.sampling):
            status.note(item.frame, recognizer.observe(item.frame.image, item.frame.stamp_ns))
        return status


def test_a_snapshot_shows_the_newest_frame_and_how_it_came_to_its_place(watched: LiveStatus) -> None:
    snapshot = watched.snapshot("on the map", "")
    status = snapshot.status
    assert (status.frames_used, status.state, status.camera.delivered) == (FRAMES, "on the map", FRAMES)
    assert status.match is not None
    assert status.match.place == FRAMES - 1
    assert snapshot.image is not None
    assert snapshot.costs.shape == (2, FRAMES)
    assert snapshot.places.tolist() == list(range(FRAMES))
    assert snapshot.window.shape == (LENGTH, FRAMES)
    # On its own map every frame is nearest to its own place: the chosen line is the diagonal of the window.
    rows = np.arange(LENGTH)
    assert (snapshot.window.argmin(axis=1) == FRAMES - LENGTH + rows).all()
    assert snapshot.window[rows, FRAMES - LENGTH + rows].max() < 0.2 * COST_ONE
    assert [used.uniqueness is None for used in status.history] == [True] * (LENGTH - 1) + [False] * (
        FRAMES - LENGTH + 1
    )


def test_a_snapshot_is_not_changed_by_later_frames(watched: LiveStatus, street: ReferenceMap) -> None:
    before = watched.snapshot("on the map", "")
    window, costs, history = before.window.copy(), before.costs.copy(), before.status.history
    item = next(traverse(read_feed(street.path.with_name("feed")), SamplingConfig()))
    watched.note(item.frame, watched._recognizer.observe(item.frame.image[:, ::-1], 60 * 10**9))
    assert (before.window == window).all()
    assert (before.costs == costs).all()
    assert before.status.history == history


def test_a_note_keeps_the_picture_and_copies_nothing(watched: LiveStatus, street: ReferenceMap) -> None:
    """It runs for every frame, whether somebody looks or not: the work waits for a snapshot."""
    item = next(traverse(read_feed(street.path.with_name("feed")), SamplingConfig()))
    tracemalloc.start()
    for _ in range(100):
        watched.note(item.frame, None)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert watched.snapshot("on the map", "").image is item.frame.image
    assert peak_bytes < item.frame.image.nbytes


def test_the_map_of_the_page_is_thinned_out(street: ReferenceMap) -> None:
    view = map_view(MapSet.of(street))
    assert (view.places, len(view.drives), len(view.drives[0])) == (FRAMES, 1, FRAMES)
    assert view.drives[0][0] == (-27.0, 153.0)
    assert view.thumbnail(3).startswith(b"\xff\xd8")


def test_no_page_is_no_reason_to_stop(street: ReferenceMap, caplog: pytest.LogCaptureFixture) -> None:
    assert open_page(PageConfig(port=0), MapSet.of(street)) is None
    with socket.create_server(("127.0.0.1", 0)) as taken, caplog.at_level(logging.INFO):
        assert open_page(PageConfig(port=taken.getsockname()[1]), MapSet.of(street)) is None
        assert "no live page: [page] 127.0.0.1:" in caplog.text
        assert "Address already in use" in caplog.text
        assert open_page(PageConfig(bind="203.0.113.1", port=8642), MapSet.of(street)) is None
