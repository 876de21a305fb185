"""The maps of a folder as they lie on the disk: size, age, use, and what may be done with them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from edge.errors import MapError
from edge.layers.tally import Tally, key_of, source_of
from edge.reference_map import LearnedFolder, MapHeader, is_signed, maps_in, read_header

KEEP_FILE = "keep"
CLOCK_SET_UNIX_S = 1_763_000_000
"""November 2025: a clock that says less was never set, as after a start without a battery and without a network."""


@dataclass(frozen=True)
class StoredMap:
    """A map of a folder. keys: what drives counted it by. used_unix_s: when one last recognized it, 0.0 for never."""

    path: Path
    header: MapHeader
    size_bytes: int
    made_unix_s: float
    recognized: int
    used_unix_s: float
    is_signed: bool
    is_kept: bool
    is_retired: bool

    @property
    def is_from_drive(self) -> bool:
        """Whether live mapping made it, and it has the name that it was given."""
        return all(segment.source == source_of(self.path) for segment in self.header.segments)

    @property
    def needed_unix_s(self) -> float:
        """When it was made or last recognized; infinite, so that it goes last, where no clock was set then."""
        newest_s = max(self.made_unix_s, self.used_unix_s)
        return newest_s if newest_s >= CLOCK_SET_UNIX_S else math.inf


def keys_of(header: MapHeader, path: Path) -> set[str]:
    """What drives may have counted a map by: as a finished map, and, as of the drive that made it, while it grew."""
    return {key_of(header, path), *(segment.source for segment in header.segments)}


def stored_maps(folder: Path, tallies: Sequence[Tally]) -> list[StoredMap]:
    """All maps of a folder that can be read, in the order of their names. MapError if the folder cannot be read.

    tallies: of all drives, the oldest first.
    """
    learned, found = LearnedFolder(folder), []
    if not folder.is_dir():
        raise MapError(f"{folder}: no such folder of maps")
    by_drive = [(tally.began_unix_s, tally.maps) for tally in tallies]
    for path in maps_in(folder):
        with contextlib.suppress(MapError, OSError):
            header = read_header(path)
            files = [file.stat() for file in path.iterdir()]
            size_bytes, made_unix_s = sum(file.st_size for file in files), (path / "map.json").stat().st_mtime
            keys = keys_of(header, path)
            used = [(sum(maps.get(key, 0) for key in keys), began_s) for began_s, maps in by_drive]
            counted = sum(frames for frames, _ in used)
            used_unix_s = max((began_s for frames, began_s in used if frames), default=0.0)
            marks = is_signed(path), (path / KEEP_FILE).exists(), learned.retires(path)
            found.append(StoredMap(path, header, size_bytes, made_unix_s, counted, used_unix_s, *marks))
    return found
