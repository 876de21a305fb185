"""Maps of any size on the disk, of streets that run side by side and descriptors that are random numbers."""

from __future__ import annotations

import hashlib
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.geodesy import all_moved
from edge.reference_map import store
from edge.reference_map.checksums import FileKey, sha256_of
from edge.reference_map.costs import squared_norms
from edge.reference_map.place_records import PLACE
from edge.reference_map.spatial_index import bounds_of
from edge.reference_map.store import MapHeader, ModelKey, RegionsKey, Segment
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG

REGIONS = RegionsKey("left-right", 0.4)
STREET_M, APART_M, SPACING_M = 10_000.0, 100.0, 2.0
BLOCK = 4096


def write_simulated_map(path: Path, places: int, model: ModelKey, first: int = 0) -> None:
    """A whole map, every checksum of which holds, of the streets from place `first` on."""
    path.mkdir(parents=True)
    rng = np.random.default_rng(places + first)
    records = _places(first, places)
    records["norm_sq"] = _write_descriptors(path / store.DESCRIPTORS, rng, places, model.dimensions)
    records.tofile(path / store.PLACES)
    np.ones((2, REGIONS.count, model.dimensions)).tofile(path / store.STATISTICS)
    (path / store.THUMBNAILS).touch()
    names = (store.DESCRIPTORS, store.PLACES, store.STATISTICS, store.THUMBNAILS)
    files = {name: FileKey((path / name).stat().st_size, sha256_of(path / name)) for name in names}
    sizes = store.expected_sizes(places, REGIONS.count, model.dimensions, model.dimensions)
    files[store.RAW] = _write_hole(path / store.RAW, sizes[store.RAW])
    a_street = round(STREET_M / SPACING_M)
    borders = [0, *range(a_street - first % a_street, places, a_street), places]
    segments = tuple(Segment(start, end, "front", "simulated") for start, end in pairwise(borders))
    header = MapHeader.begun(model, REGIONS, SamplingConfig())
    header = replace(header, places=places, segments=segments, bounds=bounds_of(records), files=files)
    (path / store.HEADER).write_bytes(store.encode_header(header))


def _places(first: int, places: int) -> NDArray[np.void]:
    """Places every 2 m along streets of 10 km that lie 100 m apart."""
    records = np.zeros(places, dtype=PLACE)
    street, along_m = np.divmod((first + np.arange(places)) * SPACING_M, STREET_M)
    lat_deg, lon_deg = np.full(places, ORIGIN_LAT_DEG), np.full(places, ORIGIN_LON_DEG)
    moves_m = np.column_stack([street * APART_M, along_m])
    records["lat_deg"], records["lon_deg"] = all_moved(lat_deg, lon_deg, moves_m)
    records["route_m"] = along_m
    records["row"] = np.arange(places)
    records["position_sigma_m"] = 1.0
    return records


def _write_descriptors(file: Path, rng: np.random.Generator, places: int, dimensions: int) -> NDArray[np.int32]:
    """Random bytes in the layout of a map; the squared norm of every place (N,)."""
    norms_sq = np.zeros(places, dtype=np.int32)
    with file.open("wb") as stream:
        for _ in range(REGIONS.count):
            for start in range(0, places, BLOCK):
                count = min(BLOCK, places - start)
                rows = np.frombuffer(rng.bytes(count * dimensions), dtype=np.int8).reshape(1, count, dimensions) >> 1
                norms_sq[start : start + count] += squared_norms(rows)
                stream.write(rows.tobytes())
    return norms_sq


def _write_hole(file: Path, size: int) -> FileKey:
    """A file of zeros that takes no room."""
    with file.open("wb") as stream:
        stream.truncate(size)
    return FileKey(size, _digest_of_zeros(size))


@cache
def _digest_of_zeros(size: int) -> str:
    digest, zeros = hashlib.sha256(), bytes(1 << 20)
    for _ in range(size >> 20):
        digest.update(zeros)
    digest.update(bytes(size % (1 << 20)))
    return digest.hexdigest()
