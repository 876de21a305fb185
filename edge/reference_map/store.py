"""The map's folder, opened only after its header, sizes and checksums hold.

    map.json         header: format, model, regions, sampling, counts, segments, checksums; its own checksum last
    descriptors.i8   (N, R * D) int8, normalised over the whole set; memory-mapped, the only file matching reads
    places.bin       (N,) records of PLACE: where the place is, and its thumbnail
    statistics.f64   (2, R, D) mean and deviation of the raw set
    raw.f16          (N, R, D) raw descriptors, so that the map can grow and be normalised again without images
    thumbnails.jpgs  one small JPEG after another, for people

Numbers are little-endian. A map is written to a folder beside it, synced, and put in place by one rename, so that
after a crash there is the old map or the new one.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.errors import MapError

FORMAT = "lookback-map"
VERSION = 1
HEADER = "map.json"
DESCRIPTORS = "descriptors.i8"
PLACES = "places.bin"
STATISTICS = "statistics.f64"
RAW = "raw.f16"
THUMBNAILS = "thumbnails.jpgs"
MATCHING_FILES = (DESCRIPTORS, PLACES, STATISTICS)
"""What recognition reads; the other files are for growing the map and for people."""

MAX_HEADER_BYTES = 16 << 20

PLACE = np.dtype(
    [
        ("lat_deg", "<f8"),  # NaN where the position is not known, as in all columns but the last four
        ("lon_deg", "<f8"),
        ("alt_m", "<f8"),
        ("heading_deg", "<f8"),  # of the vehicle, clockwise from north
        ("route_m", "<f8"),  # along the drive that made the segment
        ("row", "<i4"),  # of the feed
        ("norm_sq", "<i4"),  # squared length of the int8 descriptor
        ("thumbnail_at", "<i8"),  # where in thumbnails.jpgs, and how long
        ("thumbnail_bytes", "<i4"),
    ]
)


class ModelKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which network and which of its layers made the descriptors; a query must come from the very same."""

    name: str
    sha256: str
    tap: str
    dimensions: int


class RegionsKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How images were cut (section III-D) and normalised (eq. 1); a query must be treated alike."""

    kind: Literal["left-right", "whole"]
    width: float
    normalization: Literal["set", "none"]

    @property
    def count(self) -> int:
        """How many regions a descriptor has."""
        return 2 if self.kind == "left-right" else 1


class Segment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Places [start, end) of one drive, and where its camera looked; no trajectory crosses into the next segment."""

    start: int
    end: int
    view: Literal["front", "rear"]
    source: str


class FileKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Size and checksum of one file of the map."""

    bytes: int
    sha256: str


class MapHeader(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`map.json`."""

    format: str
    version: int
    lookback: str
    model: ModelKey
    regions: RegionsKey
    sampling: SamplingConfig
    places: int
    segments: tuple[Segment, ...]
    files: dict[str, FileKey]
    header_sha256: str = ""


@dataclass(frozen=True)
class ReferenceMap:
    """An open map: descriptors (N, R * D) int8 memory-mapped read-only, places (N,) of PLACE."""

    path: Path
    header: MapHeader
    descriptors: NDArray[np.int8]
    places: NDArray[np.void]

    def thumbnail(self, place: int) -> bytes:
        """The place's small JPEG, for people."""
        record = self.places[place]
        with (self.path / THUMBNAILS).open("rb") as file:
            file.seek(int(record["thumbnail_at"]))
            return file.read(int(record["thumbnail_bytes"]))

    def raw(self) -> NDArray[np.float16]:
        """Raw descriptors (N, R, D) float16, memory-mapped, for normalising again."""
        header = self.header
        shape = (header.places, header.regions.count, header.model.dimensions)
        return np.memmap(self.path / RAW, dtype="<f2", mode="r", shape=shape)


def open_map(path: Path, *, every_file: bool = False) -> ReferenceMap:
    """Open a map after checking header, sizes and checksums; MapError names the file and what is wrong.

    By default the checksums of the files that matching reads are checked, with `every_file` those of all.
    """
    header = read_header(path)
    _check_sizes(path, header)
    for name in sorted(header.files) if every_file else MATCHING_FILES:
        if sha256_of(path / name) != header.files[name].sha256:
            raise MapError(f"{path / name}: damaged (its checksum does not hold); build or copy the map again")
    places = np.fromfile(path / PLACES, dtype=PLACE)
    width = header.regions.count * header.model.dimensions
    descriptors = np.memmap(path / DESCRIPTORS, dtype=np.int8, mode="r", shape=(header.places, width))
    return ReferenceMap(path, header, descriptors, places)


def read_header(path: Path) -> MapHeader:
    """Read and check `map.json` alone."""
    file = path / HEADER
    if not path.is_dir():
        raise MapError(f"{path}: no such map; make one with `lookback map build FEED -o {path}`")
    try:
        if file.stat().st_size > MAX_HEADER_BYTES:
            raise MapError(f"{file}: too large for a map header")
        data = file.read_bytes()
    except OSError as error:
        raise MapError(f"{file}: cannot read it: {error.strerror}") from None
    try:
        header = msgspec.json.decode(data, type=MapHeader)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MapError(f"{file}: damaged, or not a map header: {error}") from None
    if header.format != FORMAT or header.version != VERSION:
        raise MapError(f"{file}: format {header.format!r} version {header.version}; this program reads {VERSION}")
    # The canonical encoding must give the same bytes, so that no bit of the file goes unchecked.
    if encode_header(msgspec.structs.replace(header, header_sha256="")) != data:
        raise MapError(f"{file}: damaged (its checksum does not hold); build or copy the map again")
    _check_header(file, header)
    return header


def encode_header(header: MapHeader) -> bytes:
    """The file's bytes: indented JSON with `header_sha256` computed over the same JSON without it."""
    digest = hashlib.sha256(msgspec.json.encode(header)).hexdigest()
    return msgspec.json.format(msgspec.json.encode(msgspec.structs.replace(header, header_sha256=digest)), indent=1)


def expected_sizes(places: int, regions: int, dimensions: int) -> dict[str, int]:
    """Bytes of the files whose size follows from the counts."""
    values = places * regions * dimensions
    return {
        DESCRIPTORS: values,
        PLACES: places * PLACE.itemsize,
        STATISTICS: 2 * regions * dimensions * 8,
        RAW: values * 2,
    }


def _check_header(file: Path, header: MapHeader) -> None:
    """Hold the header's own claims against each other, before anything is read by them."""
    sizes = expected_sizes(header.places, header.regions.count, header.model.dimensions)
    if set(header.files) != {*sizes, THUMBNAILS}:
        raise MapError(f"{file}: files: not the files of a map")
    for name, size in sizes.items():
        if header.files[name].bytes != size:
            raise MapError(f"{file}: files: {name} should have {size} bytes by the counts in the header")
    bounds = [0, *(segment.end for segment in header.segments)]
    starts = [segment.start for segment in header.segments]
    if header.places < 1 or starts != bounds[:-1] or bounds[-1] != header.places or sorted(set(bounds)) != bounds:
        raise MapError(f"{file}: segments: they do not cover the {header.places} places one after another")
    if not (math.isfinite(header.regions.width) and 0 < header.regions.width <= 1):
        raise MapError(f"{file}: regions: width {header.regions.width} is not between 0 and 1")


def _check_sizes(path: Path, header: MapHeader) -> None:
    for name, key in header.files.items():
        try:
            size = (path / name).stat().st_size
        except OSError as error:
            raise MapError(f"{path / name}: cannot read it: {error.strerror}") from None
        if size != key.bytes:
            raise MapError(f"{path / name}: {size} bytes where the header says {key.bytes}; build or copy it again")


def sha256_of(file: Path) -> str:
    """Checksum of a file, read in pieces."""
    try:
        with file.open("rb") as stream:
            digest = hashlib.sha256()
            while block := stream.read(1 << 20):
                digest.update(block)
    except OSError as error:
        raise MapError(f"{file}: cannot read it: {error.strerror}") from None
    return digest.hexdigest()
