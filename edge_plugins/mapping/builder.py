"""Building a map: place after place to the disk, then eq. 1 over the whole set, then one rename.

Memory does not grow with the map: raw descriptors go to their file as they come, and the whole set is normalized
from there in blocks.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.descriptor import normalized
from edge.errors import MapError
from edge.files import AtomicFolder
from edge.geodesy import POSITION_SOURCES, PositionSource
from edge.reference_map import store
from edge.reference_map.checksums import FileKey, sha256_of
from edge.reference_map.costs import encode, project, squared_norms
from edge.reference_map.place_records import PLACE
from edge.reference_map.spatial_index import bounds_of
from edge.reference_map.store import MapHeader, ModelKey, RegionsKey
from edge_plugins.mapping.keypoint_rows import KeyOf, KeypointRows

BLOCK_ROWS = 256
USABLE_SIGMA_M = 25.0
"""A position of less accuracy is not used: GPS of that kind counts as unhealthy as well."""
NAN = float("nan")

Blocks = Callable[[], Iterator[NDArray[np.float32]]]
"""Goes through the normalized set, a block (n, R, D) at a time."""
Shrink = Callable[[Blocks], NDArray[np.float32]]
"""The directions (K, D) of a set along which its descriptors are shrunk."""


@dataclass(frozen=True)
class Place:
    """Where a place is, as far as it is known (NaN where not), and what people see of it.

    position_sigma_m: one standard deviation of the position's distance from the truth.
    """

    row: int
    lat_deg: float = NAN
    lon_deg: float = NAN
    alt_m: float = NAN
    heading_deg: float = NAN
    route_m: float = NAN
    thumbnail: bytes = b""
    position_sigma_m: float = NAN
    position_source: PositionSource = "unknown"

    def record(self, thumbnail_at: int = 0) -> tuple[float | int, ...]:
        """The place as a record of PLACE before its descriptor is encoded; thumbnail_at: where its picture begins."""
        position = (self.lat_deg, self.lon_deg, self.alt_m, self.heading_deg, self.route_m)
        accuracy = self.position_sigma_m, POSITION_SOURCES.index(self.position_source)
        return (*position, self.row, 0, thumbnail_at, len(self.thumbnail), *accuracy)


class DriveByDrive:
    """A map that gets its places drive by drive."""

    _header: MapHeader

    def begin_segment(
        self,
        source: str,
        view: Literal["front", "rear"],
        *,
        has_odometer: bool = False,
        whole_sigma_m: float | None = None,
        heading_is_course: bool = False,
    ) -> None:
        """Start a further drive, see `MapHeader.with_segment`."""
        self._header = self._header.with_segment(
            source,
            view,
            has_odometer=has_odometer,
            whole_sigma_m=whole_sigma_m,
            heading_is_course=heading_is_course,
        )

    def doubt(self) -> None:
        """Nothing vouches for the current drive."""
        self._header = self._header.doubted()


class MapBuilder(DriveByDrive):
    """Writes a map; use it as a context manager: what is not finished leaves nothing behind."""

    def __init__(
        self,
        path: Path,
        model: ModelKey,
        regions: RegionsKey,
        sampling: SamplingConfig,
        *,
        shrink: Shrink | None = None,
        replace: bool = False,
        keypoints: KeyOf | None = None,
        keeps_pictures: bool = True,
    ) -> None:
        """Start a map that `finish` will put at `path`; MapError if something is there and `replace` is False.

        shrink: the descriptors of each region; None: as they are. keypoints: the key of a map that has them.
        keeps_pictures: small ones of places, for people.
        """
        if path.exists() and not replace:
            raise MapError(f"{path}: already exists; remove it, or name another folder")
        if path.exists() and not (path / store.HEADER).is_file():
            raise MapError(f"{path}: not a map, so it will not be replaced; name another folder")
        self._path, self._shrink, self._keeps_pictures = path, shrink, keeps_pictures
        self._header = MapHeader.begun(model, regions, sampling)
        self._records: list[tuple[float | int, ...]] = []
        self._thumbnail_at = 0
        self.unused: Counter[str] = Counter()
        """Positions that were given and are not used, by the reason; their places have none."""
        self._new = AtomicFolder(path)
        self._folder = self._new.path
        self._raw = (self._folder / store.RAW).open("wb")
        self._thumbnails = (self._folder / store.THUMBNAILS).open("wb")
        self.keypoints = None if keypoints is None else KeypointRows(self._folder / store.KEYPOINTS, keypoints)
        """Of a map that has them, each place's are added here."""

    def add(self, raw: NDArray[np.float32], place: Place) -> None:
        """Add one place with its raw descriptor (R, D) to the current segment.

        Its position is not used where that would be no truth for other drives, see `unused`.
        """
        why = _unusable(place)
        if why and not math.isnan(place.lat_deg):
            self.unused[why] += 1
            place = replace(place, lat_deg=NAN, lon_deg=NAN, alt_m=NAN)
        if not self._keeps_pictures:
            place = replace(place, thumbnail=b"")
        self._raw.write(raw.astype("<f2").tobytes())
        self._thumbnails.write(place.thumbnail)
        self._records.append(place.record(self._thumbnail_at))
        self._thumbnail_at += len(place.thumbnail)
        self._header = self._header.with_places(len(self._records))

    def finish(self) -> MapHeader:
        """Normalize the whole set, write, sync, and rename into place. MapError if no place was added."""
        if len(self._records) < 2:
            few = f"a map needs at least 2 places, and this drive has {len(self._records)}"
            raise MapError(f"{self._path}: {few}: use a smaller spacing, or a longer drive")
        self._raw.close()
        self._thumbnails.close()
        mean, deviation = self._statistics()
        np.stack([mean, deviation]).astype("<f8").tofile(self._folder / store.STATISTICS)
        places = np.array(self._records, dtype=PLACE)
        places["norm_sq"] = self._write_descriptors(lambda: self._normalized_blocks(mean, deviation))
        places.tofile(self._folder / store.PLACES)
        header = self._header.first(len(places)).checked(places)
        if self.keypoints is not None:
            header = header.with_keypoints(self.keypoints.finish(places, header.segments))
        header = msgspec.structs.replace(header, bounds=bounds_of(places), files=self._files())
        (self._folder / store.HEADER).write_bytes(store.encode_header(header))
        self._new.put_in_place()
        return header

    def _write_descriptors(self, blocks: Blocks) -> NDArray[np.int32]:
        """Shrink and encode the set, and write it plane by plane; the squared norm (N,) of every place."""
        projection = None
        if self._shrink is not None:
            projection = self._shrink(blocks)
            self._header = msgspec.structs.replace(self._header, dimensions=len(projection))
            projection.astype("<f4").tofile(self._folder / store.PROJECTION)
        norms_sq: list[NDArray[np.int32]] = []
        at = 0
        with (self._folder / store.DESCRIPTORS).open("wb") as file:
            for block in blocks():
                encoded = encode(block if projection is None else project(block, projection))
                for plane in range(self._header.regions.count):
                    file.seek((plane * len(self._records) + at) * self._header.dimensions)
                    file.write(encoded[plane].tobytes())
                norms_sq.append(squared_norms(encoded))
                at += len(block)
        return np.concatenate(norms_sq)

    def _normalized_blocks(
        self, mean: NDArray[np.float64], deviation: NDArray[np.float64]
    ) -> Iterator[NDArray[np.float32]]:
        return (normalized(block, mean, deviation) for block in self._raw_blocks())

    def _statistics(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and standard deviation (R, D) over the whole set, from the raw values as they were stored."""
        count = len(self._records)
        mean = sum(block.sum(axis=0, dtype=np.float64) for block in self._raw_blocks()) / count
        squares = sum(np.square(block - mean).sum(axis=0) for block in self._raw_blocks())
        return np.asarray(mean), np.sqrt(np.asarray(squares) / count)

    def _raw_blocks(self) -> Iterator[NDArray[np.float32]]:
        shape = (len(self._records), self._header.regions.count, self._header.model.dimensions)
        raw = np.memmap(self._folder / store.RAW, dtype="<f2", mode="r", shape=shape)
        for at in range(0, len(raw), BLOCK_ROWS):
            yield raw[at : at + BLOCK_ROWS].astype(np.float32)

    def _files(self) -> dict[str, FileKey]:
        header = self._header
        has_keypoints = self.keypoints is not None
        sizes = store.expected_sizes(0, 0, header.model.dimensions, header.dimensions, keypoint_bytes=has_keypoints)
        names = [*sizes, store.THUMBNAILS]
        return {name: FileKey((self._folder / name).stat().st_size, sha256_of(self._folder / name)) for name in names}

    def __enter__(self) -> MapBuilder:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        of_keypoints = [] if self.keypoints is None else [self.keypoints.close]
        for close in (self._raw.close, self._thumbnails.close, *of_keypoints):
            with contextlib.suppress(OSError):  # a full disk, once more
                close()
        self._new.__exit__(kind, error, trace)


def _unusable(place: Place) -> str:
    """Why a position is no truth for other drives; "" if it is."""
    if place.position_source == "place_fixes":
        return "rest on positions that Lookback sent"
    if place.position_source == "dead_reckoning" and math.isnan(place.position_sigma_m):
        return "are dead reckoning of unknown accuracy"
    return f"are less accurate than {USABLE_SIGMA_M:g} m" if place.position_sigma_m > USABLE_SIGMA_M else ""


WIDTH_PX = 120


def thumbnail(image: NDArray[np.uint8]) -> bytes:
    """A JPEG of a frame (H, W, 3) BGR, WIDTH_PX wide or up to twice that: a whole factor is reduced by far faster."""
    factor = max(1, image.shape[1] // WIDTH_PX)
    height, width = (max(1, size // factor) for size in image.shape[:2])
    whole = image[: height * factor, : width * factor]
    small = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1].tobytes()
