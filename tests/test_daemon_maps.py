"""`lookback run` and its map: checked before anything is published, and searched around the autopilot's position."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from edge.camera import Frame
from edge.config import AcceptanceConfig, Config, MapConfig, SamplingConfig, SequenceConfig, TelemetryConfig
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.journal.records import MapExcluded, PlaceFix, StateChanged
from edge.map_verification import MapVerification
from edge.opened_parts import OpenedParts
from edge.recognition.recognizer import model_key
from edge.reference_map import open_map_set
from edge.reference_map.checksums import ChecksumSchedule
from edge.reference_map.store import DESCRIPTORS, HEADER
from edge_plugins.mapping.builder import Place
from edge_plugins.page import PageConfig
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG, Pose
from sim.journal import records_of
from sim.maps.tiles import split_map
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import PtyLink
from tests.faults.simulated_daemon import ScriptedFrames
from tests.map_of import map_of
from tests.udp_port import free_port

FRAMES, PERIOD_MS = 80, 60
PLACES, APART_M = 300, 40.0


@pytest.fixture(scope="module")
def street(make_street: Callable[..., Path]) -> Path:
    return make_street(range(FRAMES), period_ms=PERIOD_MS)


def start(folder: Path, feed: Path, path: Path, connection: str, **of_map: Any) -> subprocess.Popen[str]:
    config = {
        "camera": {"kind": "feed", "device": str(feed)},
        "sampling": {"by": "time", "interval_s": PERIOD_MS / 1000},
        "map": {"path": str(path), **of_map},
        "sequence": {"length": 10},
        "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0, "hold_off_s": 0.2},
        "telemetry": {"connection": connection, "journal": "events.jsonl"},
    }
    (folder / "lookback.toml").write_text(tomli_w.dumps(config))
    command = [sys.executable, "-m", "edge", "run", str(folder / "lookback.toml")]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def states(folder: Path) -> set[str]:
    return {record.state for record in records_of(folder / "events.jsonl", StateChanged)}


def test_damage_that_is_found_later_ends_the_program_before_anything_is_published(
    street: Path, tmp_path: Path, play_on: Callable[[Path, Path], Path]
) -> None:
    shutil.copytree(street / "map", tmp_path / "map")
    data = bytearray((tmp_path / "map" / DESCRIPTORS).read_bytes())
    data[-1] ^= 1
    (tmp_path / "map" / DESCRIPTORS).write_bytes(data)
    process = start(tmp_path, play_on(street / "feed", tmp_path / "feed"), tmp_path / "map", "udp:127.0.0.1:9")
    said = process.communicate(timeout=120)[1]
    assert process.returncode == 78, said
    assert f"{DESCRIPTORS}: damaged" in said.splitlines()[-1]
    assert "Traceback" not in said
    assert not list(records_of(tmp_path / "events.jsonl", PlaceFix))


class HeldUp(ChecksumSchedule):
    """Checksums on a disk that does not answer until it may."""

    def __init__(self, path: Path) -> None:
        super().__init__({path: ({}, ())})
        self.answers = threading.Event()

    def step(self, max_bytes: int, first: Sequence[Path] = ()) -> dict[Path, str]:
        self.answers.wait()
        return super().step(max_bytes, first)


def test_a_slow_disk_holds_up_checksums_and_not_the_loop(street: Path) -> None:
    """At 2 MB a second they held it up for 3.8 s. A match on a map that is not checked does not count yet."""
    maps = open_map_set(street / "map")
    verification = MapVerification(maps, lambda record: None)
    held_up = verification.checksums = HeldUp(street / "map")
    while verification.may_wait:
        assert verification.check_next(maps, [], waits=True) is None
    assert verification.check_next(maps, [], waits=True) is None, "without any waiting from now on"
    assert not held_up.is_verified([street / "map"])
    held_up.answers.set()
    while not held_up.is_done:
        assert verification.check_next(maps, []) is None
    assert held_up.is_verified([street / "map"])


def test_a_map_that_is_cut_off_while_in_use_is_excluded_and_the_daemon_goes_on(
    street: Path, grid: Network, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        shutil.copytree(street / "map", tmp_path / "maps" / name)
    now_ns, images = 10**12, FeedImages(read_feed(street / "feed"))
    frames = ScriptedFrames(lambda: now_ns)
    config = Config(
        sampling=SamplingConfig(by="frames"),
        map=MapConfig(path=str(tmp_path / "maps")),
        sequence=SequenceConfig(length=10),
        telemetry=TelemetryConfig(connection=f"udpin:127.0.0.1:{free_port()}", journal=str(tmp_path / "events.jsonl")),
        plugins={"page": PageConfig(port=0)},
    )
    with ExitStack() as opened:
        parts = OpenedParts(config, opened, lambda: now_ns, frames=frames, network=grid)
        daemon = Daemon(parts)
        for index in range(FRAMES):
            if index == FRAMES // 2:
                os.truncate(tmp_path / "maps" / "b" / DESCRIPTORS, 0)
            now_ns += PERIOD_MS * 1_000_000
            frames.next = Frame(images.read(index), now_ns, index)
            daemon.turn()
        assert parts.frames_used == FRAMES
        assert parts.recognizer.map_set.names == ("a",)
        assert parts.recognizer.state == "on the map"
    excluded = [(one.map, one.why) for one in records_of(tmp_path / "events.jsonl", MapExcluded)]
    why = f"{tmp_path / 'maps' / 'b' / DESCRIPTORS}: cut off while it is in use; copy the map again"
    assert excluded == [("b", why)]


@pytest.fixture(scope="module", params=["one map", "tiles"])
def long_map(request: pytest.FixtureRequest, grid: Network, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 km of places that look like nothing, around the place where the simulated autopilot stands."""
    path = tmp_path_factory.mktemp("long") / "map"
    rng = np.random.default_rng(0)
    places = [
        Place(row, ORIGIN_LAT_DEG + (row - PLACES / 2) * APART_M / 110_800, ORIGIN_LON_DEG, route_m=row * APART_M)
        for row in range(PLACES)
    ]
    long = map_of(path, rng.random((PLACES, 2, grid.info.dimensions), dtype=np.float32), places, model=model_key(grid))
    if request.param == "tiles":
        split_map(long, path.with_name("tiles"), 64)
        return path.with_name("tiles")
    return path


@pytest.mark.parametrize("gps", [True, False])
def test_a_large_map_is_searched_where_the_autopilot_says(
    street: Path, long_map: Path, tmp_path: Path, cable: PtyLink, gps: bool
) -> None:
    """With a position there is an answer, "off the map"; without, this map is still being gone through."""
    autopilot = SimulatedAutopilot(cable, lambda _: Pose(0.0, 0.0, 0.0, 5.0, 0.0), gps=gps)
    stop = threading.Event()
    flying = threading.Thread(target=autopilot.run, args=(stop,))
    flying.start()
    try:
        connection = f"serial:{cable.device}:921600"
        process = start(tmp_path, street / "feed", long_map, connection, places_per_frame=250, search_radius_m=10.0)
        said = process.communicate(timeout=120)[1]
    finally:
        stop.set()
        flying.join()
    assert process.returncode == 0, said
    assert ("off the map" in states(tmp_path)) == gps


@pytest.fixture
def elsewhere(grid: Network, tmp_path: Path) -> Path:
    raw, places = (
        np.random.default_rng(0).random((60, 2, grid.info.dimensions)),
        [Place(row, 0.0, 0.0, route_m=2.0 * row) for row in range(60)],
    )
    return map_of(tmp_path / "maps", raw, places, model=model_key(grid)).path


def test_a_map_that_is_swapped_is_used_without_a_restart_and_a_bad_one_is_not(
    street: Path, elsewhere: Path, grid: Network, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    now_ns, images = 10**12, FeedImages(read_feed(street / "feed"))
    frames = ScriptedFrames(lambda: now_ns)
    config = Config(
        sampling=SamplingConfig(by="frames"),
        map=MapConfig(path=str(elsewhere)),
        sequence=SequenceConfig(length=10),
        acceptance=AcceptanceConfig(window_m=10.0, hold_off_s=0.2),
        telemetry=TelemetryConfig(connection=f"udpin:127.0.0.1:{free_port()}", journal=str(tmp_path / "events.jsonl")),
        plugins={"page": PageConfig(port=0)},
    )

    with ExitStack() as parts:
        daemon = Daemon(OpenedParts(config, parts, lambda: now_ns, frames=frames, network=grid))

        def drive(first: int, last: int) -> int:
            nonlocal now_ns
            for index in range(first, last):
                now_ns += PERIOD_MS * 1_000_000
                frames.next = Frame(images.read(index), now_ns, index)
                daemon.turn()
            return len(list(records_of(tmp_path / "events.jsonl", PlaceFix)))

        assert drive(0, 40) == 0
        elsewhere.rename(tmp_path / ".old")
        shutil.copytree(street / "map", elsewhere)
        assert drive(0, 40) == 0, "not opened again yet"
        daemon.reopen_maps()
        found = drive(0, 40)
        assert found > 0
        (elsewhere / HEADER).unlink()
        daemon.reopen_maps()
        assert "the maps so far stay in use" in caplog.text
        assert drive(40, 80) > found


def test_a_running_daemon_opens_its_maps_again_at_sighup(street: Path, tmp_path: Path) -> None:
    said = []
    with start(tmp_path, street / "feed", street / "map", "udp:127.0.0.1:9") as process:
        assert process.stderr is not None
        for line in process.stderr:
            said.append(line)
            if "sampling:" in line:
                process.send_signal(signal.SIGHUP)
            if "maps opened again: 80 places" in line:
                process.terminate()
    assert process.returncode == 0 and "maps opened again" in "".join(said), said
