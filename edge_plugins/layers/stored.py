"""The maps of a folder as they lie on the disk: size, age, marks, and which are deleted when the disk's share is full.

Only maps that live mapping made are ever deleted, by the name that they were given; never one that is signed, or that
has a file `keep` in its folder (`lookback map keep`), nor one without which a stretch has no layer left. Retired drives
go first, then the one that was made longest ago.
"""

from __future__ import annotations

import contextlib
import logging
import math
import shutil
from dataclasses import dataclass
from pathlib import Path

from edge.errors import MapError
from edge.reference_map import MapHeader, is_signed, maps_in, open_map_set, read_header
from edge.reference_map.map_folder import is_kept, is_retired
from edge_plugins.layers.road import NEEDED, stretches

CLOCK_SET_UNIX_S = 1_763_000_000
"""November 2025: a clock that says less was never set, as after a start without a battery and without a network."""
DELETED = ".being-deleted"
ROWS_APART = 5
"""Rows of a drive that are read, 10 m apart: a stretch is 25 m, and the daemon's start waits for this."""
log = logging.getLogger(__name__)


def source_of(map_path: Path) -> str:
    """What a map of a drive says of itself, by which it is known as long as it has its name: see `StoredMap`."""
    return f"drive of {map_path.name}"


@dataclass(frozen=True)
class StoredMap:
    """A map of a folder."""

    path: Path
    header: MapHeader
    size_bytes: int
    made_unix_s: float
    is_signed: bool
    is_kept: bool
    is_retired: bool

    @property
    def is_from_drive(self) -> bool:
        """Whether live mapping made it, and it has the name that it was given."""
        return all(segment.source == source_of(self.path) for segment in self.header.segments)

    @property
    def needed_unix_s(self) -> float:
        """When it was made; infinite, so that it goes last, where no clock was set then."""
        return self.made_unix_s if self.made_unix_s >= CLOCK_SET_UNIX_S else math.inf


def stored_maps(folder: Path) -> list[StoredMap]:
    """All maps of a folder that can be read, in the order of their names. MapError if the folder cannot be read."""
    if not folder.is_dir():
        raise MapError(f"{folder}: no such folder of maps")
    found = []
    for path in maps_in(folder):
        with contextlib.suppress(MapError, OSError):
            header = read_header(path)
            size_bytes = sum(file.stat().st_size for file in path.iterdir())
            made_unix_s = (path / "map.json").stat().st_mtime
            marks = is_signed(path), is_kept(path), is_retired(path)
            found.append(StoredMap(path, header, size_bytes, made_unix_s, *marks))
    return found


def delete_oldest(folder: Path, quota_bytes: float) -> list[Path]:
    """Delete maps of drives until all maps of the folder together take at most `quota_bytes`; those deleted."""
    for left_over in folder.glob(f".*{DELETED}"):
        shutil.rmtree(left_over, ignore_errors=True)
    maps = stored_maps(folder)
    total = sum(one.size_bytes for one in maps)
    if total <= quota_bytes:
        return []
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
        maps = open_map_set(folder, with_retired=True).maps
        return [{maps[number].path for number in one.rows} for one in stretches(maps, ROWS_APART)]
    return []
