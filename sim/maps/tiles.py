"""Cutting a map into tiles: the same bytes in several maps, which searched together give the same matches.

Descriptors are copied as they were normalized over the whole set, with its statistics and its directions if they were
shrunk. Drives are cut at borders and joined again when a folder of tiles is opened (`numbering`), so no place is kept
twice and no sequence is lost.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import msgspec
import numpy as np

from edge.errors import ConfigError, MapError
from edge.files import AtomicFolder
from edge.geodesy import first_known
from edge.reference_map import store
from edge.reference_map.checksums import FileKey, sha256_of
from edge.reference_map.spatial_index import BLOCK_PLACES, bounds_of
from edge.reference_map.store import MapHeader, ReferenceMap, Segment, TileOf

COPIED = (store.STATISTICS, store.PROJECTION)
ROWS = 256
"""So many places are copied at a time."""


def split_map(reference_map: ReferenceMap, output: Path, places: int) -> list[MapHeader]:
    """Write tiles of at most about `places` places as maps in the folder `output`, named by their order; their headers.

    All are of nearly one size, and but for the last of a multiple of BLOCK_PLACES, so that a position allows the same
    places of them as of the whole. ConfigError for a number of places that gives no tiles, MapError if something is at
    `output` or cannot be written.
    """
    total = reference_map.header.places
    if not 0 < places < total:
        raise ConfigError(f"--places: {places} is not between 1 and {total - 1}, less than what the map has")
    if output.exists():
        raise MapError(f"{output}: already exists; name another folder")
    borders = _borders(total, places)
    digits = len(str(len(borders) - 2))
    with AtomicFolder(output) as new:
        headers = [
            _write_tile(reference_map, new.path / f"{index:0{digits}}", start, end)
            for index, (start, end) in enumerate(pairwise(borders))
        ]
        new.put_in_place()
    return headers


def publish_map(reference_map: ReferenceMap, output: Path, *, pictures: bool = False) -> MapHeader:
    """Write a map once more at `output`, without the pictures of its places; its header. MapError as of `split_map`."""
    if output.exists():
        raise MapError(f"{output}: already exists; name another folder")
    with AtomicFolder(output) as new:
        header = _write_tile(reference_map, new.path, 0, reference_map.header.places, is_whole=True, pictures=pictures)
        new.put_in_place()
    return header


def _borders(total: int, places: int) -> list[int]:
    """Where tiles begin and end, in whole blocks."""
    blocks = -(-total // BLOCK_PLACES)
    tiles = min(-(-total // places), blocks)
    return [min(total, blocks * index // tiles * BLOCK_PLACES) for index in range(tiles + 1)]


def _write_tile(
    whole: ReferenceMap, folder: Path, start: int, end: int, *, is_whole: bool = False, pictures: bool = True
) -> MapHeader:
    """The map of places [start, end), which is no tile where it is_whole."""
    folder.mkdir(exist_ok=True)
    records = whole.places[start:end].copy()
    first_byte = int(records["thumbnail_at"][0])
    last_byte = int(records["thumbnail_at"][-1]) + int(records["thumbnail_bytes"][-1])
    records["thumbnail_at"] -= first_byte
    if not pictures:
        records["thumbnail_at"] = records["thumbnail_bytes"] = first_byte = last_byte = 0
    records.tofile(folder / store.PLACES)
    with (folder / store.DESCRIPTORS).open("wb") as file:
        for plane in whole.descriptors:
            _copy(plane, file, start, end)
    with (folder / store.RAW).open("wb") as file:
        _copy(whole.raw(), file, start, end)
    if whole.keypoints is not None:
        with (folder / store.KEYPOINTS).open("wb") as file:
            _copy(whole.keypoints, file, start, end)
    with (whole.path / store.THUMBNAILS).open("rb") as source, (folder / store.THUMBNAILS).open("wb") as file:
        source.seek(first_byte)
        file.write(source.read(last_byte - first_byte))
    for name in COPIED:
        if name in whole.header.files:
            shutil.copyfile(whole.path / name, folder / name)
    header = msgspec.structs.replace(
        whole.header,
        version=max(store.VERSION, whole.header.version),
        places=end - start,
        segments=tuple(_segments(whole.header, start, end)),
        bounds=bounds_of(records),
        files={name: FileKey((folder / name).stat().st_size, sha256_of(folder / name)) for name in whole.header.files},
        tile=whole.header.tile if is_whole else _tile_of(whole, start),
        header_sha256="",
    )
    data = store.encode_header(header)
    (folder / store.HEADER).write_bytes(data)
    return msgspec.json.decode(data, type=MapHeader)


def _copy(array: np.ndarray, file: BinaryIO, start: int, end: int) -> None:
    for at in range(start, end, ROWS):
        file.write(array[at : min(at + ROWS, end)].tobytes())


def _segments(header: MapHeader, start: int, end: int) -> Iterator[Segment]:
    for segment in header.segments:
        first, last = max(start, segment.start), min(end, segment.end)
        if first < last:
            yield msgspec.structs.replace(segment, start=first - start, end=last - start)


def _tile_of(whole: ReferenceMap, start: int) -> TileOf:
    """What a tile must know of its map; a tile of a tile is one of the map that this was cut from."""
    of = whole.header.tile
    begins = start not in [segment.start for segment in whole.header.segments]
    if of is not None:
        return TileOf(of.map_sha256, of.start + start, begins or (start == 0 and of.continues), of.origin)
    origin = first_known(whole.places["lat_deg"], whole.places["lon_deg"])
    return TileOf(whole.header.header_sha256, start, begins, origin)
