"""Two cameras, one of which maps, against one that only recognizes: all search the same number of places."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from edge.config import Config, MapConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.geodesy import VehiclePosition
from edge.recognizer import PlaceRecognizer, model_key, open_recognizer
from edge.reference_map import RegionsKey, open_map_set
from edge.sequence import Travel
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.live_map import LiveMap
from edge_plugins.mapping.place_log import create_log, log_of
from edge_plugins.mapping.place_log_records import DriveBegun, LogHeader, PlacePassed, encoded
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG
from sim.bench.frames import smooth_picture
from sim.bench.simulated_map import write_simulated_map
from sim.bench.timing import Times
from sim.research.bench.rows import Row, Section, at_most

SIZE_PX = (640, 480)
LENGTH = 40
SPACING_M = SamplingConfig().spacing_m
BLOCK = 20
MOST_TIMES = 2.0
cpu_ns: Callable[[], int] = time.process_time_ns
"""Of all threads, since mapping writes in one of its own."""


class TwoCameras:
    """A recognizer on a growing map, and the map."""

    def __init__(self, folder: Path, places: int, network: Network) -> None:
        """The map has so many places to begin with."""
        regions = RegionsKey("left-right", 0.4, "set")
        header = LogHeader(model_key(network), regions, SamplingConfig())
        folder.mkdir()
        _write_log(log_of(folder / "drive"), header, places)
        began_s = time.monotonic()
        self.live = LiveMap(MappingConfig(folder=str(folder), min_free_mb=0.0), header, "rear")
        self.resumed_s = time.monotonic() - began_s
        config = Config(map=MapConfig(path=str(folder), places_per_frame=2 * places))
        self.recognizer = open_recognizer(config, network=network, newest=self.live.so_far())
        self._driven_m = 0.0

    def step_with(self, pictures: Sequence[np.ndarray], frame: int) -> None:
        """One frame of each camera, of alternating pictures."""
        ahead, back = pictures[2 * frame : 2 * frame + 2]
        self._driven_m += SPACING_M
        self.recognizer.observe(ahead, frame * 200_000_000, Travel(self._driven_m))
        raw = self.recognizer.describe(back)
        self.live.add(raw, back, _position(self.live.status.places), self._driven_m)
        newest = self.live.newly_searchable(self._driven_m)
        if newest is not None:
            self.recognizer.grow_maps(self.recognizer.map_set.with_newest(newest))


def _position(row: int) -> VehiclePosition:
    lat_deg = ORIGIN_LAT_DEG + row * SPACING_M / 110_800
    return VehiclePosition(0, lat_deg, ORIGIN_LON_DEG, 0.0, 0.0, 10.0, sigma_m=1.0, source="gps")


def _write_log(path: Path, header: LogHeader, places: int) -> None:
    """The file of a drive of random places."""
    create_log(path, header).close()
    rng = np.random.default_rng(3)
    with path.open("ab") as stream:
        stream.write(encoded(DriveBegun("rear")))
        for row in range(places):
            raw = np.maximum(rng.standard_normal((2, 4096), np.float32), 0).astype("<f2")
            at = _position(row)
            place = Place(row, at.lat_deg, at.lon_deg, 0.0, 0.0, row * SPACING_M, b"", 1.0, "gps")
            stream.write(encoded(PlacePassed(place, raw.tobytes())))


def _alternately(racers: Mapping[str, Callable[[int], None]], frames: int) -> dict[str, Times]:
    """The times of each racer's frames after the first LENGTH, BLOCK frames of one racer after BLOCK of another."""
    runs_ms: dict[str, list[float]] = {name: [] for name in racers}
    for first in range(0, LENGTH + frames, BLOCK):
        for name, step in racers.items():
            for frame in range(first, min(first + BLOCK, LENGTH + frames)):
                began_ns = cpu_ns()
                step(frame)
                runs_ms[name].append((cpu_ns() - began_ns) / 1e6)
    return {name: Times(tuple(times[LENGTH:])) for name, times in runs_ms.items()}


def _by_block(times: Times) -> Times:
    """Means of blocks: frames differ in cost, since a place is mapped or normalized again with some."""
    starts = range(0, len(times.runs_ms), BLOCK)
    return Times(tuple(statistics.fmean(times.runs_ms[first : first + BLOCK]) for first in starts))


def measure(folder: Path, places: int, frames: int) -> Section:
    """The rows, and the target: at most MOST_TIMES the single camera's."""
    network = Network.load()
    path = folder / f"mapping_{places}.map"
    write_simulated_map(path, places, model_key(network))
    config = Config(map=MapConfig(places_per_frame=2 * places))
    alone: PlaceRecognizer = open_recognizer(config, network=network, map_set=open_map_set(path))
    two = TwoCameras(folder / "mapping", places, network)
    rng = np.random.default_rng(1)
    pictures = [smooth_picture(rng, SIZE_PX) for _ in range(2 * (LENGTH + frames))]

    def one_camera(frame: int) -> None:
        alone.observe(pictures[2 * frame], frame * 200_000_000, Travel(frame * SPACING_M))

    alone_name, two_name = "one camera that recognizes", "two cameras, one that recognizes and one that maps"
    times = _alternately({alone_name: one_camera, two_name: partial(two.step_with, pictures)}, frames)
    two.live.close()
    ratio = _by_block(times[two_name]).ratio(_by_block(times[alone_name]))
    slowest = statistics.quantiles(times[two_name].runs_ms, n=20)[-1]
    rows = [
        Row(alone_name, times[alone_name]),
        Row(two_name, times[two_name], "one camera", ratio, f"all threads; 95 % of frames within {slowest:.1f} ms"),
        Row("restart with the map of the drive", Times((two.resumed_s * 1e3,)), note="once, wall-clock"),
    ]
    target = at_most(f"{two_name}, against one camera", MOST_TIMES, ratio)
    return Section(f"Mapping while driving, {places:,} places", rows, [target])
