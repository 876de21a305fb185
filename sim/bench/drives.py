"""Whole frames through the daemon's recognizer, mapping, maps of every size, and the daemon itself."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import tomli_w

from edge.config import Config, MapConfig, RigConfig, SamplingConfig, SequenceConfig
from edge.descriptor import NormalizedRows
from edge.descriptor.network import Network
from edge.errors import LookbackError
from edge.feed import FeedHeader, FeedRow
from edge.feed.writer import FeedWriter
from edge.geodesy import VehiclePosition, moved
from edge.recognition.recognizer import model_key, open_recognizer
from edge.reference_map import ModelKey, RegionsKey, open_map_set
from edge.sequence import MotionPrior, PlaceMatch, SearchRegion
from edge.sequence.place_search import PlaceSearch
from edge.sequence.submap import MEASURED_SLOPES
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.drive_store import DriveStore
from edge_plugins.mapping.live_map import LiveMap
from edge_plugins.mapping.place_log_records import LogHeader
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG
from sim.bench.frames import SIZE_PX, run_frames, smooth_picture
from sim.bench.simulated_map import APART_M, SPACING_M, STREET_M, write_simulated_map
from sim.bench.stages import FOV_DEG, floor_of, read_all
from sim.bench.table import Row, Run, raced
from sim.bench.timing import Times, thread_ns, time_ms, wall_ns

USUAL, RADIUS_M = 10_000, 500.0
GRID = Path("grid")
USED_HZ, QUICK_HZ, BEGUN_S = 5, 15, 4
"""Rates of the camera, at either of which so many pictures a second are used; and seconds before the measurement."""
DISK_SHARE = 0.8
PASSED_PX = 8
"""By which each picture that is mapped is further along a wide one."""


def measure(folder: Path, rounds: int, *, quick: bool) -> Iterator[Row]:
    """In a folder that is empty."""
    yield from frames(folder / "frames.map", USUAL, 60 if quick else 300)
    yield from mapping(folder / "mapping", 60 if quick else 300)
    for places in (10_000,) if quick else (10_000, 100_000, 1_000_000):
        yield from maps(folder, places, rounds, model_key(Network.load(GRID)))
    for size in (SIZE_PX,) if quick else (SIZE_PX, (1920, 1080)):
        yield from daemon(folder / f"feed{size[0]}", size, 3 if quick else 15)


def frames(path: Path, places: int, number: int) -> Iterator[Row]:
    """A row for each stage of a frame, and for all of them. Floors run after each frame, so that both slow down."""
    network = Network.load(GRID)
    write_simulated_map(path, places, model_key(network))
    descriptors = np.ones(places * 2 * network.info.dimensions, dtype=np.int8)
    sums = np.zeros((MEASURED_SLOPES, 2, places), dtype=np.int32)
    racers: dict[str, Run] = {
        "network": floor_of(network.path, (1, *network.size, 3)),
        "matching": lambda: read_all(descriptors),
        "search": lambda: np.add(sums, 1, out=sums),
    }
    measured, floors = [], []
    for frame in run_frames(path, places, number, network, RigConfig()):
        measured.append(frame)
        floors.append({stage: time_ms(floor) for stage, floor in racers.items()})
    for stage in measured[-1]:
        times = Times(tuple(frame.get(stage, 0.0) for frame in measured))
        least = Times(tuple(floor[stage] for floor in floors)) if stage in racers else None
        yield Row(f"frame: {stage}", f"{places:,} places", times, least)
    whole = Times(tuple(sum(frame.values()) for frame in measured))
    least = Times(tuple(sum((frame | floor).values()) for frame, floor in zip(measured, floors, strict=True)))
    of_network = Times(tuple(frame["network"] for frame in measured))
    slow_ms = np.quantile(whole.runs_ms, 0.95)
    size = f"{places:,} places; 95 % within {slow_ms:.1f} ms"
    yield Row("**whole frame**", size, whole, least, "its network alone", of_network, most=1.3)


def mapping(folder: Path, places: int) -> Iterator[Row]:
    """A place of a second camera, described, written and made searchable, beside a frame that is recognized.

    And its keypoints, whose thread has all CPU time that is not the caller's: at most, since each neighbor shows all of
    the points again, which no road does.
    """
    network = Network.load(GRID)
    header = LogHeader(model_key(network), RegionsKey("left-right", 0.4), SamplingConfig())
    folder.mkdir()
    mapping = MappingConfig(folder=str(folder), min_free_mb=0.0)
    store = DriveStore(mapping, header, "rear", fov_deg=FOV_DEG)
    live = LiveMap(mapping, store)
    config = Config(map=MapConfig(path=str(folder)), sequence=SequenceConfig(directions="forward"))  # where none looks
    recognizer = open_recognizer(config, network=network, newest=live.searched.so_far())
    rng, mapped, recognized, found = np.random.default_rng(1), [], [], []
    width, height = SIZE_PX
    wide = smooth_picture(rng, (width + PASSED_PX * places, height))
    with closing(store):
        for place in range(places):
            ahead, back = smooth_picture(rng, SIZE_PX), wide[:, PASSED_PX * place : PASSED_PX * place + width]
            whole_ns = time.process_time_ns()
            driven_m, began_ns = place * SPACING_M, thread_ns()
            recognizer.observe(ahead, place * 200_000_000, MotionPrior(driven_m))
            turned_ns = thread_ns()
            lat_deg = ORIGIN_LAT_DEG + driven_m / 110_800
            at = VehiclePosition(0, lat_deg, ORIGIN_LON_DEG, 0.0, 0.0, 10.0, sigma_m=1.0, source="gps")
            live.add(recognizer.describe(back), back, at, driven_m)
            newest = live.newly_searchable(driven_m)
            if newest is not None:
                recognizer.grow_maps(recognizer.map_set.with_newest(newest))
            mapped.append((thread_ns() - turned_ns) / 1e6)
            recognized.append((turned_ns - began_ns) / 1e6)
            store.keypoints.wait()
            found.append((time.process_time_ns() - whole_ns - (thread_ns() - began_ns)) / 1e6)
    size, rival = f"map of {places} places that grows", "a frame recognized on it"
    yield Row("mapping one place", size, Times(tuple(mapped)), None, rival, Times(tuple(recognized)))
    yield Row("its keypoints, in their thread", "every point seen by all neighbors", Times(tuple(found)))


class BenchDrive:
    """A vehicle that drives along a map, a place a frame, and sees it as the map has it."""

    def __init__(self, path: Path, start: int, *, known: bool) -> None:
        self._map_set = open_map_set(path)
        self._search = PlaceSearch(self._map_set, Config())
        self._length, self._known, self._place = Config().sequence_frames, known, start
        self._ring: list[np.ndarray] = []
        for _ in range(self._length):
            self.step()

    def step(self) -> PlaceMatch | None:
        """One frame."""
        place = self._place
        half_sum, half_difference = self._map_set.maps[0].descriptors[:, place].astype(np.float32)
        seen = np.stack([half_sum + half_difference, half_sum - half_difference])
        self._ring = [*self._ring, seen][-self._length :]
        street, along_m = divmod(place * SPACING_M, STREET_M)
        at = moved(ORIGIN_LAT_DEG, ORIGIN_LON_DEG, street * APART_M, along_m)
        near = SearchRegion(*at, RADIUS_M) if self._known else None
        self._place += 1
        return self._search.push(
            NormalizedRows(seen[np.newaxis]), lambda: np.stack(self._ring), MotionPrior(search_region=near)
        )


def maps(folder: Path, places: int, rounds: int, model: ModelKey) -> Iterator[Row]:
    """Opening a map, and a frame on it, beside 10,000 places that are searched whole. LookbackError: no room."""
    need, free = places * (2 * model.dimensions + 100), shutil.disk_usage(folder).free
    if need > DISK_SHARE * free:
        raise LookbackError(f"a map of {places:,} places needs {need / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free")
    path, small = folder / f"{places}.map", folder / "whole.map"
    write_simulated_map(path, places, model)
    if not small.exists():
        write_simulated_map(small, USUAL, model)
    size = f"{places:,} places"
    few = max(2, rounds // 3)
    yield raced(
        "opening a map, wall-clock", size, few, lambda: PlaceSearch(open_map_set(path), Config()), clock=wall_ns
    )
    whole = (f"{USUAL:,} places, whole", BenchDrive(small, 100, known=False).step)
    known = BenchDrive(path, places // 2, known=True).step
    yield raced(f"frame, place known to {RADIUS_M:g} m", size, rounds, known, rival=whole, most=1.5)
    if places > USUAL:
        yield raced(
            "frame, place not known", size, rounds, BenchDrive(path, places // 2, known=False).step, rival=whole
        )
    shutil.rmtree(path)


def daemon(feed: Path, size: tuple[int, int], seconds: int) -> Iterator[Row]:
    """`lookback run` with a camera of JPEG pictures: CPU time of all its threads in a second, and its start."""
    rng, pictures = np.random.default_rng(0), 20
    with FeedWriter(feed, FeedHeader("camera", "front", *size)) as writer:
        for number in range(pictures):
            grain = rng.normal(0, 4.0, (size[1], size[0], 3)).astype(np.int16)  # files as large as those of a street
            picture = (smooth_picture(rng, size) + grain).clip(0, 255).astype(np.uint8)
            writer.write(picture, FeedRow("", number))
    write_simulated_map(feed / "map", USUAL, model_key(Network.load(GRID)))
    words = f"{size[0]}x{size[1]}"
    for hz in (USED_HZ, QUICK_HZ):
        rows = [f"frames/{number % pictures:06d}.jpg,{number * 10**9 // hz}" for number in range(hz * 120)]
        (feed / "frames.csv").write_text("\n".join(["file,stamp_ns", *rows]), encoding="utf-8")
        start_ms, second_ms = run_daemon(_config(feed, hz), seconds)
        yield Row(f"`lookback run`, a second of {hz} pictures, {USED_HZ} used", words, Times(tuple(second_ms)))
    yield Row("`lookback run`, start to its first picture, wall-clock", words, Times((start_ms,)))


def _config(feed: Path, hz: int) -> Path:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    config = {
        "camera": {"kind": "feed", "device": str(feed)},
        "descriptor": {"model": "grid"},
        "map": {"path": str(feed / "map")},
        "sampling": {"by": "frames", "spacing_frames": hz // USED_HZ},
        "sequence": {"length": 10},
        "telemetry": {"connection": f"udpin:127.0.0.1:{port}", "journal": str(feed / "events.jsonl")},
        "page": {"port": 0},
    }
    (feed / "lookback.toml").write_text(tomli_w.dumps(config), encoding="utf-8")
    return feed / "lookback.toml"


def run_daemon(config: Path, seconds: int) -> tuple[float, Sequence[float]]:
    """Milliseconds until it is ready, with its first picture, and of CPU in each second. LookbackError: it ends."""
    address, log = config.with_name("notify"), config.with_name("log")
    address.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager, log.open("w") as stderr:
        manager.bind(str(address))
        manager.settimeout(0.1)
        command, environment = [sys.executable, "-m", "edge", "run", str(config)], {"NOTIFY_SOCKET": str(address)}
        began_s = time.monotonic()
        with subprocess.Popen(command, env={**os.environ, **environment}, stderr=stderr) as process:
            try:
                while process.poll() is None:
                    try:
                        if manager.recv(4096) == b"READY=1":
                            start_ms = 1e3 * (time.monotonic() - began_s)
                            time.sleep(BEGUN_S)
                            return start_ms, [_cpu_ms(process.pid) for _ in range(seconds)]
                    except TimeoutError:
                        continue
            finally:
                process.kill()
    raise LookbackError(f"the daemon does not start: {log.read_text(encoding='utf-8').strip()}")


def _cpu_ms(process: int) -> float:
    """Of the next second."""

    def used() -> int:
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return int(fields[11]) + int(fields[12])  # utime and stime, proc(5)

    before = used()
    time.sleep(1)
    return 1e3 * (used() - before) / os.sysconf("SC_CLK_TCK")
