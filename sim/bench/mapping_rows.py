"""Two cameras, one of which maps, against one that only recognizes: both search the same number of places."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from edge.config import Config, MapConfig, MappingConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.descriptor.normalize import normalize
from edge.geodesy import VehiclePosition
from edge.mapping import LiveMap, header_of
from edge.mapping.completion import log_of
from edge.mapping.place_log import DriveBegun, LogHeader, PlacePassed, create_log, encoded
from edge.recognizer import PlaceRecognizer, model_key, open_recognizer
from edge.reference_map import Place, RegionsKey, open_map_set
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG
from sim.bench.network_rows import smooth_picture
from sim.bench.rows import Row, Section, Target
from sim.bench.simulated_map import write_simulated_map
from sim.bench.timing import Times

SIZE_PX = (640, 480)
LENGTH = 40
SPACING_M = SamplingConfig().spacing_m
MOST_TIMES = 2.0
cpu_ns: Callable[[], int] = time.process_time_ns
"""Of all threads, since mapping writes in one of its own."""


class TwoCameras:
    """A recognizer on a growing map, and the map."""

    def __init__(self, folder: Path, places: int, network: Network) -> None:
        """The map has so many places to begin with."""
        regions = RegionsKey("left-right", 0.4, "set")
        header = header_of(model_key(network), regions, SamplingConfig())
        folder.mkdir()
        _write_log(log_of(folder / "drive"), header, places)
        began_s = time.monotonic()
        self.live = LiveMap(MappingConfig(folder=str(folder), min_free_mb=0.0), header, "rear", normalize)
        self.resumed_s = time.monotonic() - began_s
        config = Config(map=MapConfig(path=str(folder), places_per_frame=2 * places))
        self.recognizer = open_recognizer(config, network=network, newest=self.live.so_far())
        self._driven_m = 0.0

    def step(self, ahead: np.ndarray, back: np.ndarray, frame: int) -> None:
        """One frame of each camera."""
        self._driven_m += SPACING_M
        self.recognizer.observe(ahead, frame * 200_000_000, distance_m=self._driven_m)
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


def _times(run: Callable[[int], None], frames: int) -> Times:
    runs_ms = []
    for frame in range(LENGTH + frames):
        began_ns = cpu_ns()
        run(frame)
        if frame >= LENGTH:
            runs_ms.append((cpu_ns() - began_ns) / 1e6)
    return Times(tuple(runs_ms))


def measure(folder: Path, places: int, frames: int) -> Section:
    """The rows, and the target: at most MOST_TIMES the single camera's."""
    network = Network.load()
    path = folder / f"mapping_{places}.map"
    write_simulated_map(path, places, model_key(network))
    config = Config(map=MapConfig(places_per_frame=2 * places))
    alone: PlaceRecognizer = open_recognizer(config, network=network, map_set=open_map_set(path))
    both = TwoCameras(folder / "mapping", places, network)
    rng = np.random.default_rng(1)
    pictures = [smooth_picture(rng, SIZE_PX) for _ in range(2 * (LENGTH + frames))]

    def one_camera(frame: int) -> None:
        alone.observe(pictures[2 * frame], frame * 200_000_000, distance_m=frame * SPACING_M)

    def two_cameras(frame: int) -> None:
        both.step(pictures[2 * frame], pictures[2 * frame + 1], frame)

    single, double = _times(one_camera, frames), _times(two_cameras, frames)
    both.live.close()
    mean = statistics.fmean(double.runs_ms) / statistics.fmean(single.runs_ms)
    slowest = statistics.quantiles(double.runs_ms, n=20)[-1]
    rows = [
        Row("one camera that recognizes", single),
        Row(
            "two cameras, one that recognizes and one that maps",
            double,
            "one camera",
            mean,
            f"ratio of means; 95 % of frames within {slowest:.1f} ms; all threads",
        ),
        Row("restart with the map of the drive", Times((both.resumed_s * 1e3,)), note="once, wall-clock time"),
    ]
    target = Target(
        f"two cameras with a growing map of {places:,} places", "2x one camera or less", f"{mean:.2f}x",
        mean <= MOST_TIMES,
    )  # fmt: skip
    return Section(f"Mapping while driving, {places:,} places", rows, [target])
