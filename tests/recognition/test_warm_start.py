"""A run starts where the last one was: the recognizer's statistics survive a restart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.config import AcceptanceConfig, Config, DescriptorConfig, SamplingConfig, SequenceConfig, TelemetryConfig
from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.files import wait_for_writes
from edge.recognition.recognizer import PlaceRecognizer, open_recognizer
from edge.recognition.sequence_matcher import MAP_COUNTS_AS
from edge.recognition.warm_start import COUNTS_AS_MOST, WarmStart
from edge.reference_map import MapSet
from edge.reference_map.store import ReferenceMap, open_map
from tests.files_written import wait_for_files


@pytest.fixture(scope="module")
def street(make_street: Callable[..., Path]) -> tuple[Path, ReferenceMap]:
    folder = make_street(range(60), sampling=SamplingConfig(by="frames"))
    return folder / "feed", open_map(folder / "map")


def config(folder: Path, minutes: float = 30.0, journal: str = "events.jsonl") -> Config:
    return Config(
        descriptor=DescriptorConfig(keep_statistics_min=minutes),
        sampling=SamplingConfig(by="frames"),
        sequence=SequenceConfig(length=8),
        acceptance=AcceptanceConfig(window_m=10.0),
        telemetry=TelemetryConfig(journal=str(folder / journal) if journal else ""),
    )


def test_a_restart_goes_on_with_the_statistics_of_the_run_before(
    street: tuple[Path, ReferenceMap], grid: Network, tmp_path: Path
) -> None:
    feed, places = read_feed(street[0]), street[1]
    images = FeedImages(feed)

    def start() -> tuple[PlaceRecognizer, WarmStart]:
        recognizer = open_recognizer(config(tmp_path), network=grid, map_set=MapSet.of(places))
        return recognizer, WarmStart(config(tmp_path), recognizer)

    first, memory = start()
    assert first.matcher.statistics and first.matcher.statistics.count == MAP_COUNTS_AS
    for row in range(40):
        first.observe(images.read(row), feed.rows[row].stamp_ns)
    memory.keep()
    wait_for_writes()
    second, _ = start()
    assert first.matcher.statistics is not None
    assert second.matcher.statistics is not None
    assert second.matcher.statistics.count == first.matcher.statistics.count == 40 + MAP_COUNTS_AS
    assert second.matcher.statistics.count <= COUNTS_AS_MOST
    np.testing.assert_array_equal(second.matcher.statistics.mean, first.matcher.statistics.mean)
    for row in range(40, 60):
        stamp_ns = feed.rows[row].stamp_ns
        first.observe(images.read(row), stamp_ns)
        second.observe(images.read(row), stamp_ns)
    np.testing.assert_allclose(second.matcher.statistics.mean, first.matcher.statistics.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        second.matcher.statistics.deviation, first.matcher.statistics.deviation, rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("changes", [{"minutes": 0.0}, {"journal": ""}], ids=["not asked for", "no journal"])
def test_nothing_is_kept_where_it_is_not_asked_for(
    street: tuple[Path, ReferenceMap], grid: Network, tmp_path: Path, changes: dict[str, object]
) -> None:
    feed, places = read_feed(street[0]), street[1]
    wanted = config(tmp_path, **changes)  # type: ignore[arg-type]
    recognizer = open_recognizer(wanted, network=grid, map_set=MapSet.of(places))
    memory = WarmStart(wanted, recognizer)
    images = FeedImages(feed)
    for row in range(25):
        recognizer.observe(images.read(row), feed.rows[row].stamp_ns)
    memory.keep()
    wait_for_writes()
    assert list(tmp_path.iterdir()) == []


def test_a_first_minute_is_not_worth_a_write(street: tuple[Path, ReferenceMap], grid: Network, tmp_path: Path) -> None:
    feed, places = read_feed(street[0]), street[1]
    recognizer = open_recognizer(config(tmp_path), network=grid, map_set=MapSet.of(places))
    memory = WarmStart(config(tmp_path), recognizer)
    images = FeedImages(feed)
    for row in range(25):
        recognizer.observe(images.read(row), feed.rows[row].stamp_ns)
    state = tmp_path / "events.state"
    for at_s, there in ((100, False), (130, False), (161, True)):
        memory.keep_if_due(at_s * 1_000_000_000)
        wait_for_files()
        assert state.exists() is there
