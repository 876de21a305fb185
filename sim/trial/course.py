"""The course: a road driven out by day with the camera that looks back, and home with the one that looks ahead.

Rendering and the network cost minutes, so a world is driven once each way; runs differ in which stretches of the road
the map knows, in where the false place is, in odometry, delays and the frames that are used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pymap3d
from numpy.typing import NDArray

import edge
from edge.commands.map_build import build_map
from edge.config import DescriptorConfig, SamplingConfig
from edge.descriptor.normalize import normalize
from edge.feed import Feed, read_feed
from edge.reference_map.builder import MapBuilder, Place
from edge.reference_map.store import ReferenceMap, open_map
from sim.vehicle.daemon_drive import JOURNAL
from sim.world.recording import record_drive
from sim.world.scenario import LightName, Scenario

LENGTH_M = 2000.0
CAMERA_FPS = 10.0
STRETCHES = 10
KNOWN_M = 140.0
PLANTED_M = 130.0
FALSE_BY_M = 300.0
LIGHTS: tuple[LightName, ...] = ("night", "dusk", "rain", "day", "snow")
"""Of the drives home, one for each world in turn."""


@dataclass(frozen=True)
class World:
    """A road with what both cameras saw of it: the map of all of it, the drive home as a feed, and its scenario."""

    seed: int
    home: Scenario
    feed: Feed
    whole_map: ReferenceMap


@dataclass(frozen=True)
class Course:
    """The map of one run; `planted` are the rows [start, end) of it whose positions are false."""

    map_path: Path
    planted: tuple[int, int]


def prepare_world(number: int, folder: Path, length_m: float = LENGTH_M) -> World:
    """Drive the road of a world both ways and map it, unless `folder` has it from an earlier trial."""
    seed = 11 + number
    out = Scenario(seed=seed, length_m=length_m, view="rear", drive_seed=1)
    home = Scenario(
        seed=seed, length_m=length_m, light=LIGHTS[number % len(LIGHTS)], drive_seed=2, direction="reverse", stops=2
    )
    out_feed, home_feed, map_path = (folder / f"{number}_{name}" for name in ("out", "home", "map"))
    if not (out_feed / "frames.csv").exists():
        record_drive(out, out_feed)
    if not (home_feed / "frames.csv").exists():
        record_drive(home, home_feed, fps=CAMERA_FPS)
    if not map_path.exists():
        build_map([read_feed(out_feed)], map_path, DescriptorConfig(), SamplingConfig())
    return World(seed, home, read_feed(home_feed), open_map(map_path))


def lay_course(world: World, seed: int, path: Path, stretches: int = STRETCHES) -> Course:
    """Cut the map of one run out of the whole: known stretches, and one that claims to be FALSE_BY_M away.

    What was seen on the planted stretch is real, and so is matched with every confidence; its positions are not.
    """
    rng = np.random.default_rng([seed, 7])
    slots = int(rng.integers(stretches + 1))  # where among the stretches the planted one lies
    lengths = np.full(stretches + 1, KNOWN_M)
    lengths[slots] = PLANTED_M
    gaps = rng.dirichlet(np.full(stretches + 2, 20.0)) * (world.home.length_m - lengths.sum())
    whole = world.whole_map
    planted = (0, 0)
    with MapBuilder(path, whole.header.model, whole.header.regions, whole.header.sampling, replace=True) as builder:
        start_m, rows = 0.0, 0
        for number, (gap_m, length_m) in enumerate(zip(gaps, lengths, strict=False)):
            start_m += gap_m
            places = list(_stretch(whole, start_m, start_m + length_m, FALSE_BY_M if number == slots else 0.0))
            start_m += length_m
            builder.begin_segment(f"stretch {number}", "rear")
            for raw, place in places:
                builder.add(raw, place)
            if number == slots:
                planted = rows, rows + len(places)
            rows += len(places)
        builder.finish(normalize, edge.__version__)
    return Course(path, planted)


@contextmanager
def one_run(world: World, seed: int, output: Path) -> Iterator[tuple[Course, Path]]:
    """The course of one run while it lasts, and the folder that keeps its journal; a journal of before is removed."""
    folder = output / f"seed_{seed}"
    folder.mkdir(exist_ok=True)
    (folder / JOURNAL).unlink(missing_ok=True)
    with TemporaryDirectory(dir=folder) as passing:
        yield lay_course(world, seed, Path(passing) / "run.map"), folder


def _stretch(
    whole: ReferenceMap, start_m: float, end_m: float, aside_m: float
) -> Iterator[tuple[NDArray[np.float32], Place]]:
    """Raw descriptors and places of a stretch; positions moved to the side of the road."""
    raw, records = whole.raw(), whole.places
    for index in np.flatnonzero((records["route_m"] >= start_m) & (records["route_m"] < end_m)):
        record = records[index]
        side_rad = np.radians(records["heading_deg"][len(records) // 2] + 90)
        lat_deg, lon_deg, _ = pymap3d.enu2geodetic(
            aside_m * np.sin(side_rad), aside_m * np.cos(side_rad), 0.0, record["lat_deg"], record["lon_deg"], 0.0
        )
        place = Place(
            row=int(record["row"]),
            lat_deg=float(lat_deg),
            lon_deg=float(lon_deg),
            heading_deg=float(record["heading_deg"]),
            route_m=float(record["route_m"]),
        )
        yield raw[index].astype(np.float32), replace(place, alt_m=float(record["alt_m"]))
