"""The maps of a folder as they lie on the disk: size, age, use, and which are deleted when the disk's share is full.

Only maps that live mapping made are ever deleted, by the name that they were given; never one that is signed, or that
has a file `keep` in its folder (`lookback map keep`), nor one without which a stretch has no layer left. Retired drives
go first, then the one that was recognized, or made, longest ago.
"""

from __future__ import annotations

import contextlib
import logging
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from edge.errors import MapError
from edge.reference_map import MapHeader, is_signed, maps_in, open_map_set, read_header
from edge.reference_map.learned import LearnedFolder
from edge_plugins.layers.road import NEEDED, stretches
from edge_plugins.layers.tally import Tally, key_of, read_tallies, source_of

KEEP_FILE = "keep"
CLOCK_SET_UNIX_S = 1_763_000_000
"""November 2025: a clock that says less was never set, as after a start without a battery and without a network."""
DELETED = ".being-deleted"
ROWS_APART = 5
"""Rows of a drive that are looked at, 10 m apart: a stretch is 25 m, and the daemon's start waits for this."""
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StoredMap:
    """A map of a folder. recognized: frames, by all drives. used_unix_s: when one last recognized it, 0.0 for never."""

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


def delete_oldest(folder: Path, quota_bytes: float) -> list[Path]:
    """Delete maps of drives until all maps of the folder together take at most `quota_bytes`; those deleted."""
    for left_over in folder.glob(f".*{DELETED}"):
        shutil.rmtree(left_over, ignore_errors=True)
    maps = stored_maps(folder, [])
    total = sum(one.size_bytes for one in maps)
    if total <= quota_bytes:
        return []
    maps = stored_maps(folder, read_tallies(folder))
    may_go = [one for one in maps if one.is_from_drive and not (one.is_kept or one.is_signed)]
    road = _layers_of_road(folder)
    deleted: list[Path] = []
    for one in sorted(may_go, key=lambda one: (not one.is_retired, one.needed_unix_s)):
        if total <= quota_bytes:
            break
        own = [layers for layers in road if one.path in layers]
        if sum(len(layers) == 1 for layers in own) >= min(NEEDED, len(own)) > 0:
            continue
        try:
            # By one rename first: half a map must never be found.
            gone = one.path.with_name(f".{one.path.name}{DELETED}")
            one.path.rename(gone)
            shutil.rmtree(gone)
        except OSError as error:
            log.warning("%s: cannot delete it: %s", one.path, error.strerror)
            continue
        log.info("%s: deleted, since the maps take more than [mapping] quota_mb", one.path)
        deleted.append(one.path)
        total -= one.size_bytes
        for layers in own:
            layers.discard(one.path)
    if total > quota_bytes:
        log.warning("%s: its maps take %.0f MB, more than [mapping] quota_mb; none may be deleted", folder, total / 1e6)
    return deleted


def _layers_of_road(folder: Path) -> list[set[Path]]:
    """The maps of each stretch; none where no map of the folder can be used."""
    with contextlib.suppress(MapError):
        maps = open_map_set(folder, as_recorded=True).maps
        return [{maps[number].path for number in one.rows} for one in stretches(maps, ROWS_APART)]
    return []
