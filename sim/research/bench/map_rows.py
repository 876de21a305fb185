"""What size costs: opening a map, verifying it, and a frame on it, with and without a position."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor import NormalizedRows
from edge.geodesy import moved
from edge.reference_map import MapSet, ModelKey, open_map, open_map_set
from edge.reference_map.place_records import PLACE
from edge.sequence import Near, PlaceMatch, Travel
from edge.sequence.place_search import PlaceSearch
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG
from sim.bench.simulated_map import APART_M, REGIONS, SPACING_M, STREET_M, write_simulated_map
from sim.bench.timing import Times, race, time_ms, wall_ns
from sim.research.bench.rows import Row, Section, Target, at_most

OPENING = "opening, with its search (wall-clock)"
VERIFYING = "checksum of the descriptors, between frames (wall-clock)"
RADIUS_M = 500.0
TILES = 100
WHOLE = 10_000
SHARE_OF_MEMORY = 0.8


class Drive:
    """A vehicle that drives along the maps of a set, a place a frame, and sees it as they have it."""

    def __init__(self, map_set: MapSet, start: int, *, known: bool) -> None:
        self.map_set = map_set
        config = Config()
        self.search = PlaceSearch(map_set, config)
        self._length = config.sequence_frames
        self._known = known
        self._place = start
        self._ring: list[np.ndarray] = []
        for _ in range(self._length):
            self.step()

    def step(self) -> PlaceMatch | None:
        """One frame."""
        self._ring = [*self._ring, self._look()][-self._length :]
        near = Near(*match_position(self._place), RADIUS_M) if self._known else None
        change = NormalizedRows(self._ring[-1][np.newaxis])
        self._place += 1
        return self.search.push(change, lambda: np.stack(self._ring), Travel(near=near))

    def _look(self) -> NDArray[np.float32]:
        index = self.map_set.index
        number = index.map_of(self._place)
        return seen_at(self.map_set.maps[number].descriptors, self._place - index.starts[number])


def measure(folder: Path, sizes: Sequence[int], rounds: int, model: ModelKey) -> Section:
    """Rows of each size; those for which disk or memory do not suffice are one line that says so."""
    rows: list[Row] = []
    targets: list[Target] = []
    small = folder / "whole.map"
    write_simulated_map(small, WHOLE, model)
    for places in sizes:
        need, disk = map_bytes(places, model.dimensions), shutil.disk_usage(folder).free
        if need > SHARE_OF_MEMORY * disk:
            skipped = f"skipped: needs {need / 1e9:.1f} GB, {disk / 1e9:.1f} GB free"
            rows.append(Row(OPENING, note=skipped, size=f"{places:,} places"))
            continue
        path = folder / f"{places}.map"
        write_simulated_map(path, places, model)
        rows += _opening(path, places, rounds, targets)
        rows += _frames(path, small, f"{places:,} places", places, rounds, targets)
        shutil.rmtree(path)
        if places >= TILES * Config().map.places_per_frame // 2:
            rows += _tiles(folder / "tiles", small, places, rounds, model)
    shutil.rmtree(small)
    return Section("Maps from a pocket to a city", rows, targets)


def _tiles(path: Path, small: Path, places: int, rounds: int, model: ModelKey) -> list[Row]:
    """The same in a folder of maps."""
    write_simulated_tiles(path, places, TILES, model)
    size = f"{places:,} places in {TILES} tiles"
    rows = [Row(OPENING, _opened(path, rounds), size=size), *_frames(path, small, size, places, rounds, [])]
    shutil.rmtree(path)
    return rows


def _opening(path: Path, places: int, rounds: int, targets: list[Target]) -> list[Row]:
    opening, verifying = _opened(path, rounds), Times((time_ms(lambda: open_map(path), wall_ns),))
    if places == 100_000:
        value = f"{opening.median_ms / 1e3:.2f} s, then {verifying.median_ms / 1e3:.1f} s between frames"
        targets.append(Target("opening a map of 100,000 places", "0.5 s or less", value, opening.median_ms <= 500))
    return [Row(OPENING, opening, size=f"{places:,} places"), Row(VERIFYING, verifying, size=f"{places:,} places")]


def _opened(path: Path, rounds: int) -> Times:
    return race({"open": lambda: PlaceSearch(open_map_set(path), Config())}, max(2, rounds // 3), wall_ns)["open"]


def _frames(path: Path, small: Path, size: str, places: int, rounds: int, targets: list[Target]) -> list[Row]:
    """A frame with a position known to 500 m, or of the whole map, against 10,000 places searched whole."""
    reference = Drive(open_map_set(small), 100, known=False)
    racers: dict[str, Callable[[], object]] = {"whole": reference.step}
    what = "searched whole"
    if places > Config().map.places_per_frame:
        what = f"position known to {RADIUS_M:.0f} m"
        racers["lost"] = Drive(open_map_set(path), places // 2, known=False).step
    around = Drive(open_map_set(path), places // 2, known=True)
    racers["known"] = around.step
    times = race(racers, rounds)
    ratio = times["known"].ratio(times["whole"])
    part = around.search.part
    searched = f"{len(part.places):,}" if part else "in slices"
    rows = [
        Row(f"matching and search, {what}", times["known"], "10,000 places", ratio, size=size),
        Row(f"places searched, {what}", note=searched, size=size),
    ]
    if "lost" in times:
        lost = times["lost"]
        ratio_lost = lost.ratio(times["whole"])
        rows.append(Row("no position: a slice, or around a place", lost, "10,000 places", ratio_lost, size=size))
    if places == 1_000_000:
        wanted = "1,000,000 places with a position known to 500 m, against 10,000 scanned in full"
        targets.append(at_most(wanted, 1.5, ratio))
    return rows


def map_bytes(places: int, dimensions: int) -> int:
    """What a map takes on the disk, and in memory when all of it is matched; raw descriptors are a hole in a file."""
    return places * (REGIONS.count * dimensions + PLACE.itemsize)


def write_simulated_tiles(folder: Path, places: int, tiles: int, model: ModelKey) -> None:
    """Streets with this number of places as a folder of `tiles` maps of equal size."""
    for number, tile in enumerate(np.array_split(np.arange(places), tiles)):
        write_simulated_map(folder / f"{number:04}", len(tile), model, int(tile[0]))


def seen_at(descriptors: NDArray[np.int8], place: int) -> NDArray[np.float32]:
    """What a normalized query (R, D) shows at a place: exactly what the map has there."""
    half_sum, half_difference = descriptors[:, place].astype(np.float32)
    return np.stack([half_sum + half_difference, half_sum - half_difference])


def match_position(place: int) -> tuple[float, float]:
    """Latitude and longitude of a place."""
    street, along_m = divmod(place * SPACING_M, STREET_M)
    return moved(ORIGIN_LAT_DEG, ORIGIN_LON_DEG, street * APART_M, along_m)
