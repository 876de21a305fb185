"""The map's folder, used only after its header, sizes and checksums match.

    map.json         header: format, model, regions, sampling, counts, segments, bounds, checksums; its own last
    descriptors.i8   (R, N, K) int8, normalized over the whole set, as `costs.encode` has it; memory-mapped, the only
                     file that matching reads
    places.bin       (N,) records of PLACE (`place_records`): where the place is, how well that is known, its thumbnail
    statistics.f64   (2, R, D) mean and deviation of the raw set
    projection.f32   (K, D) of a map whose descriptors were shrunk to K < D dimensions
    raw.f16          (N, R, D) raw descriptors, so that the map can grow and be normalized again without images
    keypoints.bin    (N, K) records of KEYPOINT (`keypoint_file`) of a map that has them; memory-mapped
    thumbnails.jpgs  one small JPEG after another, for people

Numbers are little-endian. A map is written to a folder beside it, synced, and put in place by one rename, so that
after a crash there is the old map or the new one.
"""

from __future__ import annotations

import hashlib
import math
import mmap
import stat
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

import edge
from edge.config import DescriptorConfig, SamplingConfig
from edge.errors import MapError, reason
from edge.geodesy import Origin
from edge.reference_map.checksums import FileKey, check_files
from edge.reference_map.keypoint_file import KeypointsKey, mapped
from edge.reference_map.place_records import MAX_SIGMA_M, PLACE, PLACE_OF_FORMAT_3, check_steps, read_places
from edge.reference_map.spatial_index import Bounds
from edge.toml_file import Line

FORMAT = "lookback-map"
VERSION = 4
VERSION_WITH_KEYPOINTS = 5
RECORDS = {3: PLACE_OF_FORMAT_3, VERSION: PLACE, VERSION_WITH_KEYPOINTS: PLACE}
"""The versions that are read, and what a place of each has."""
HEADER = "map.json"
DESCRIPTORS = "descriptors.i8"
PLACES = "places.bin"
STATISTICS = "statistics.f64"
PROJECTION = "projection.f32"
RAW = "raw.f16"
KEYPOINTS = "keypoints.bin"
THUMBNAILS = "thumbnails.jpgs"
MATCHING_FILES = (DESCRIPTORS, PLACES, STATISTICS, PROJECTION, KEYPOINTS)
"""What recognition reads; the other files are for growing the map and for people."""

MAX_HEADER_BYTES = 16 << 20


class ModelKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Which network and which of its layers made the descriptors; a query must come from the very same.

    provider: what ran the network. A query may come from another, since each is compared with the CPU at the start.
    """

    name: Line
    sha256: Line
    tap: Line
    dimensions: int
    provider: Line = "cpu"

    def __str__(self) -> str:
        return f"{self.name} ({self.sha256[:12]}, {self.tap})"


class RegionsKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How images were cut (section III-D) and normalized (eq. 1); a query must be treated alike."""

    kind: Literal["left-right", "whole"]
    width: float
    normalization: Literal["set"] = "set"

    @classmethod
    def of(cls, config: DescriptorConfig) -> RegionsKey:
        """As a vehicle of that config describes images."""
        return cls("left-right", config.region_width)

    def __str__(self) -> str:
        return f"{self.kind} of width {self.width:g}"

    @property
    def count(self) -> int:
        """How many regions a descriptor has."""
        return 2 if self.kind == "left-right" else 1


class Segment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Places [start, end) of one drive, and where its camera faced; no trajectory crosses into the next segment.

    moved_as_driven: whether all its positions moved as an odometer and the heading said (`gps_motion`). whole_sigma_m:
    one standard deviation along the drive of what all its positions are off by together, beside their own, as by the
    times of a video that was laid over a track; None where nobody knows. heading_is_course: whether no heading was
    recorded, and its headings are the course of its positions.
    """

    start: int
    end: int
    view: Literal["front", "rear"]
    source: Line
    moved_as_driven: bool = False
    whole_sigma_m: Annotated[float, msgspec.Meta(ge=0, le=MAX_SIGMA_M)] | None = None
    heading_is_course: bool = False


class TileOf(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The larger map that a tile was cut from: its header's checksum, and where in it the tile begins.

    continues: the tile's first segment goes on with the drive that the tile before it ends with. origin: latitude and
    longitude of the larger map's local meters, which its tiles share; null where it knows no position.
    """

    map_sha256: str
    start: int
    continues: bool
    origin: Origin | None


class MapHeader(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`map.json`. dimensions: values of a region that are matched; fewer than the model's where they were shrunk.

    bounds: null where no place has a position. tile: null for a map that was not cut from a larger one. keypoints: of
    a map that has them, which is of VERSION_WITH_KEYPOINTS; others do not have the key.
    """

    format: str
    version: int
    lookback: Line
    model: ModelKey
    regions: RegionsKey
    dimensions: int
    sampling: SamplingConfig
    places: int
    segments: tuple[Segment, ...]
    bounds: Bounds | None
    files: dict[str, FileKey]
    tile: TileOf | None = None
    keypoints: KeypointsKey | msgspec.UnsetType = msgspec.UNSET
    header_sha256: str = ""

    @classmethod
    def begun(cls, model: ModelKey, regions: RegionsKey, sampling: SamplingConfig) -> MapHeader:
        """Of a map without places."""
        version = FORMAT, VERSION, edge.__version__
        return cls(*version, model, regions, model.dimensions, sampling, places=0, segments=(), bounds=None, files={})

    def with_keypoints(self, key: KeypointsKey | None) -> MapHeader:
        """With or without a file of keypoints."""
        version = VERSION if key is None else VERSION_WITH_KEYPOINTS
        return replace(self, version=version, keypoints=msgspec.UNSET if key is None else key)

    @property
    def keypoints_key(self) -> KeypointsKey | None:
        """None for a map without them."""
        return None if isinstance(self.keypoints, msgspec.UnsetType) else self.keypoints

    def with_segment(
        self,
        source: str,
        view: Literal["front", "rear"],
        *,
        has_odometer: bool = False,
        whole_sigma_m: float | None = None,
        heading_is_course: bool = False,
    ) -> MapHeader:
        """With a further drive, to which the next places belong; sequences are never searched across its beginning.

        has_odometer: whether its way was measured by what its positions have no part in; see `checked`.
        """
        begun = Segment(self.places, self.places, view, source, has_odometer, whole_sigma_m, heading_is_course)
        return replace(self, segments=(*self.first(self.places).segments, begun))

    def doubted(self) -> MapHeader:
        """With a last drive that nothing vouches for."""
        *before, last = self.segments
        return replace(self, segments=(*before, replace(last, moved_as_driven=False)))

    def with_places(self, places: int) -> MapHeader:
        """With so many places, the new ones in the last segment."""
        *before, last = self.segments
        return replace(self, places=places, segments=(*before, replace(last, end=places)))

    def checked(self, places: NDArray[np.void]) -> MapHeader:
        """With those drives alone as moved as driven whose places (N,) of PLACE did."""
        from edge.reference_map.gps_motion import moved_as_driven  # which only makers of maps need

        moved = (one.moved_as_driven and moved_as_driven(places[one.start : one.end]) for one in self.segments)
        alike = zip(self.segments, moved, strict=True)
        return replace(self, segments=tuple(replace(one, moved_as_driven=has) for one, has in alike))

    def first(self, places: int) -> MapHeader:
        """Of the first places alone, with the segments that have any."""
        segments = (replace(one, end=min(one.end, places)) for one in self.segments)
        return replace(self, places=places, segments=tuple(one for one in segments if one.start < one.end))

    @property
    def shrunk_by(self) -> str:
        """Checksum of the projection, "" where descriptors are whole: tiles of one map were shrunk alike."""
        return self.files[PROJECTION].sha256 if PROJECTION in self.files else ""


class _Kind(msgspec.Struct, frozen=True):
    """What is read first, since headers of other versions have other fields."""

    format: str
    version: int


@dataclass(frozen=True)
class ReferenceMap:
    """An open map: descriptors (R, N, K) int8 memory-mapped read-only, places (N,) of PLACE, projection (K, D)."""

    path: Path
    header: MapHeader
    descriptors: NDArray[np.int8]
    places: NDArray[np.void]
    projection: NDArray[np.float32] | None = None

    def thumbnail(self, place: int) -> bytes:
        """The place's small JPEG, for people; unverified. OSError if it cannot be read."""
        record = self.places[place]
        with (self.path / THUMBNAILS).open("rb") as file:
            file.seek(max(0, int(record["thumbnail_at"])))
            return file.read(max(0, int(record["thumbnail_bytes"])))

    @cached_property
    def keypoints(self) -> NDArray[np.void] | None:
        """Records (N, K) of KEYPOINT, memory-mapped and unverified; None for a map without them. MapError."""
        key = self.header.keypoints_key
        return None if key is None else mapped(self.path / KEYPOINTS, key, self.header.places)

    @property
    def mapped_files(self) -> dict[str, NDArray[Any]]:
        """What is memory-mapped so far, by the names of the files: keypoints only where they were read."""
        opened = vars(self).get("keypoints")
        return {DESCRIPTORS: self.descriptors} if opened is None else {DESCRIPTORS: self.descriptors, KEYPOINTS: opened}

    def release(self) -> None:
        """Give back the memory that mapped files take in this process; what is read again comes anew."""
        for array in self.mapped_files.values():
            pages: mmap.mmap | None = getattr(array, "_mmap", None)
            if pages is not None:
                pages.madvise(mmap.MADV_DONTNEED)

    def statistics(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and standard deviation (R, D) of all raw descriptors. MapError if the file cannot be read."""
        shape = (2, self.header.regions.count, self.header.model.dimensions)
        try:
            mean, deviation = np.fromfile(self.path / STATISTICS, dtype="<f8").reshape(shape)
        except (OSError, ValueError) as error:
            raise MapError(f"{self.path / STATISTICS}: cannot read it: {reason(error)}") from None
        if not (np.isfinite(mean).all() and np.isfinite(deviation).all()):
            raise MapError(f"{self.path / STATISTICS}: damaged (not a number); build or copy the map again")
        return mean, deviation

    def raw(self) -> NDArray[np.float16]:
        """Raw descriptors (N, R, D) float16, memory-mapped, for normalizing again."""
        header = self.header
        shape = (header.places, header.regions.count, header.model.dimensions)
        return np.memmap(self.path / RAW, dtype="<f2", mode="r", shape=shape)


def open_map(path: Path, *, every_file: bool = False) -> ReferenceMap:
    """Open a map after checking header, sizes and checksums; MapError names the file and what is wrong.

    By default the checksums of the files that matching reads are checked, with `every_file` those of all.
    """
    reference_map = open_unverified(path)
    files = reference_map.header.files
    check_files(path, files, sorted(files) if every_file else matching_files(reference_map.header))
    return reference_map


def matching_files(header: MapHeader) -> list[str]:
    """Names of the files that a match rests on, of this map."""
    return [name for name in sorted(header.files) if name in MATCHING_FILES]


def open_unverified(path: Path, projections: dict[str, NDArray[np.float32]] | None = None) -> ReferenceMap:
    """Open a map of which the header and the sizes hold; nothing that rests on its other files may be published yet.

    projections: those of other maps by their checksum, since tiles of one map share it; one that is read here is
    checked and added. Raises MapError.
    """
    header = read_header(path)
    _check_sizes(path, header)
    regions, kept = header.regions.count, header.dimensions
    try:
        places = read_places(path / PLACES, RECORDS[header.version])
        check_steps(path / PLACES, places, [segment.start for segment in header.segments])
        descriptors = np.memmap(path / DESCRIPTORS, dtype=np.int8, mode="r", shape=(regions, header.places, kept))
        projection = _read_projection(path, header, {} if projections is None else projections)
    except OSError as error:  # too many open files, or no memory to map it
        raise MapError(f"{path}: cannot open it: {error.strerror}") from None
    return ReferenceMap(path, header, descriptors, places, projection)


def _read_projection(
    path: Path, header: MapHeader, known: dict[str, NDArray[np.float32]]
) -> NDArray[np.float32] | None:
    if PROJECTION not in header.files:
        return None
    sha256 = header.files[PROJECTION].sha256
    if sha256 not in known:
        # Other maps may rest on it as well, so that it cannot be checked later with this one.
        check_files(path, header.files, [PROJECTION])
        projection = np.fromfile(path / PROJECTION, dtype="<f4")
        known[sha256] = projection.reshape(header.dimensions, header.model.dimensions)
    return known[sha256]


def read_header(path: Path) -> MapHeader:
    """Read and check `map.json` alone."""
    file = path / HEADER
    if not path.is_dir():
        raise MapError(f"{path}: no such map; make one with `lookback map build FEED -o {path}`")
    try:
        if all(one.name.startswith(".") for one in path.iterdir()):  # such as the file of a drive that is being mapped
            raise MapError(f"{path}: no map in it yet; make one with `lookback map build FEED -o {path}/NAME`")
        if plain_size(file) > MAX_HEADER_BYTES:
            raise MapError(f"{file}: too large for a map header")
        data = file.read_bytes()
    except OSError as error:
        raise MapError(f"{file}: cannot read it: {error.strerror}") from None
    try:
        kind = msgspec.json.decode(data, type=_Kind)
        if kind.format != FORMAT or kind.version not in RECORDS:
            raise MapError(
                f"{file}: format {kind.format!r} version {kind.version}; this program reads"
                f" {min(RECORDS)} to {max(RECORDS)}; build the map again"
            )
        header = msgspec.json.decode(data, type=MapHeader)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MapError(f"{file}: damaged, or not a map header: {error}") from None
    # The canonical encoding must give the same bytes, so that no bit of the file goes unchecked.
    if encode_header(replace(header, header_sha256="")) != data:
        raise MapError(f"{file}: damaged (checksum mismatch); build or copy the map again")
    _check_header(file, header)
    return header


def plain_size(file: Path) -> int:
    """Bytes of a map's file; MapError for a link, which may lead anywhere, and for a pipe, which may never end."""
    try:
        status = file.lstat()
    except OSError as error:
        raise MapError(f"{file}: cannot read it: {error.strerror}") from None
    if not stat.S_ISREG(status.st_mode):
        raise MapError(f"{file}: not a regular file; build or copy the map again")
    return status.st_size


def encode_header(header: MapHeader) -> bytes:
    """The file's bytes: indented JSON with `header_sha256` computed over the same JSON without it."""
    digest = hashlib.sha256(msgspec.json.encode(header)).hexdigest()
    return msgspec.json.format(msgspec.json.encode(replace(header, header_sha256=digest)), indent=1)


def expected_sizes(
    places: int, regions: int, dimensions: int, kept: int, version: int = VERSION, keypoint_bytes: int = 0
) -> dict[str, int]:
    """Bytes of the files whose size follows from the counts; `kept` of the model's `dimensions` are matched.

    keypoint_bytes: of the keypoints of a place.
    """
    values = places * regions
    sizes = {
        DESCRIPTORS: values * kept,
        PLACES: places * RECORDS[version].itemsize,
        STATISTICS: 2 * regions * dimensions * 8,
        RAW: values * dimensions * 2,
    }
    if keypoint_bytes:
        sizes[KEYPOINTS] = places * keypoint_bytes
    return sizes if kept == dimensions else {**sizes, PROJECTION: kept * dimensions * 4}


def _check_header(file: Path, header: MapHeader) -> None:
    """Hold the header's own claims against each other, before anything is read by them."""
    if not 1 <= header.dimensions <= header.model.dimensions:
        raise MapError(f"{file}: dimensions: {header.dimensions} of the model's {header.model.dimensions}")
    counts = header.places, header.regions.count, header.model.dimensions, header.dimensions
    key = header.keypoints_key
    if (key is not None) != (header.version == VERSION_WITH_KEYPOINTS):
        raise MapError(f"{file}: keypoints: not those of a map of version {header.version}")
    sizes = expected_sizes(*counts, header.version, 0 if key is None else key.place_bytes)
    if set(header.files) != {*sizes, THUMBNAILS}:
        raise MapError(f"{file}: files: not the list of files of a map")
    for name, size in sizes.items():
        if header.files[name].bytes != size:
            raise MapError(f"{file}: files: {name} should have {size} bytes by the counts in the header")
    bounds = [0, *(segment.end for segment in header.segments)]
    starts = [segment.start for segment in header.segments]
    if header.places < 1 or starts != bounds[:-1] or bounds[-1] != header.places or sorted(set(bounds)) != bounds:
        raise MapError(f"{file}: segments: they do not cover the {header.places} places one after another")
    _check_extent(file, header.bounds, header.tile)
    if not (math.isfinite(header.regions.width) and 0 < header.regions.width <= 1):
        raise MapError(f"{file}: regions: width {header.regions.width} is not between 0 and 1")


def _check_sizes(path: Path, header: MapHeader) -> None:
    for name, key in header.files.items():
        size = plain_size(path / name)
        if size != key.bytes:
            raise MapError(f"{path / name}: {size} bytes where the header says {key.bytes}; build or copy it again")


def _check_extent(file: Path, bounds: Bounds | None, tile: TileOf | None) -> None:
    # A comparison with what is no number is False.
    if bounds is not None and not (
        -90 <= bounds.south <= bounds.north <= 90 and -180 <= bounds.west <= bounds.east <= bounds.west + 360 <= 720
    ):
        raise MapError(f"{file}: bounds: not south to north and west to east in degrees")
    lat_deg, lon_deg = (tile.origin if tile else None) or (0.0, 0.0)
    if tile is not None and not (tile.start >= 0 and abs(lat_deg) <= 90 and abs(lon_deg) <= 360):
        raise MapError(f"{file}: tile: not a valid place or origin")
