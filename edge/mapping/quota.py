"""Which maps are kept: how often each was recognized, and which are deleted when the disk's share is full.

Only maps that live mapping made are ever deleted, by the name that they were given; never one that is signed, or that
has a file `keep` in its folder (`lookback map keep`). The map that was recognized, or made, longest ago goes first.
"""

from __future__ import annotations

import contextlib
import logging
import math
import shutil
from dataclasses import dataclass
from pathlib import Path

import msgspec

from edge.errors import MapError
from edge.files import replacing
from edge.mapping.completion import source_of
from edge.reference_map import MapHeader, is_signed, read_header

USAGE_FILE = ".usage.json"
KEEP_FILE = "keep"
DELETED = ".being-deleted"
WRITTEN_EACH_NS = 60_000_000_000
CLOCK_SET_UNIX_S = 1_763_000_000
"""November 2025: a clock that says less was never set, as after a start without a battery and without a network."""
log = logging.getLogger(__name__)


class MapUsage(msgspec.Struct, frozen=True):
    """How many places of a map were recognized, and when the last one was (Unix time in seconds)."""

    recognized: int = 0
    last_unix_s: float = 0.0


class Usage:
    """The file of a folder of maps that counts how often each was recognized; without it, counting starts again."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / USAGE_FILE
        self.maps: dict[str, MapUsage] = {}
        self._written_ns: int | None = None
        with contextlib.suppress(OSError, msgspec.DecodeError, UnicodeDecodeError):
            self.maps = msgspec.json.decode(self._file.read_bytes(), type=dict[str, MapUsage])

    def count(self, name: str, unix_s: float, now_ns: int) -> None:
        """One place of a map was recognized; written once a minute."""
        before = self.maps.get(name, MapUsage())
        self.maps[name] = MapUsage(before.recognized + 1, round(unix_s, 3))
        if self._written_ns is None or now_ns - self._written_ns >= WRITTEN_EACH_NS:
            self._written_ns = now_ns
            self.write()

    def write(self) -> None:
        """Replace the file; a disk that refuses it costs the count, and nothing else."""
        if self.maps:
            with contextlib.suppress(OSError), replacing(self._file) as stream:
                stream.write(msgspec.json.encode(self.maps))


@dataclass(frozen=True)
class StoredMap:
    """A map of a folder: what it takes on the disk, when it was made or last recognized, and whether it must stay."""

    path: Path
    header: MapHeader
    size_bytes: int
    made_unix_s: float
    used: MapUsage
    is_kept: bool

    @property
    def is_from_drive(self) -> bool:
        """Whether live mapping made it, and it has the name that it was given."""
        return all(segment.source == source_of(self.path) for segment in self.header.segments)

    @property
    def needed_unix_s(self) -> float:
        """When it was made or last recognized; infinite, so that it goes last, where no clock was set then."""
        newest_s = max(self.made_unix_s, self.used.last_unix_s)
        return newest_s if newest_s >= CLOCK_SET_UNIX_S else math.inf


def stored_maps(folder: Path) -> list[StoredMap]:
    """All maps of a folder that can be read, in the order of their names. MapError if the folder cannot be read."""
    usage, found = Usage(folder).maps, []
    try:
        paths = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        raise MapError(f"{folder}: cannot read it: {error.strerror}") from None
    for path in paths:
        with contextlib.suppress(MapError, OSError):
            header = read_header(path)
            files = [file.stat() for file in path.iterdir()]
            size_bytes, made_unix_s = sum(file.st_size for file in files), (path / "map.json").stat().st_mtime
            kept = is_signed(path) or (path / KEEP_FILE).exists()
            found.append(StoredMap(path, header, size_bytes, made_unix_s, usage.get(path.name, MapUsage()), kept))
    return found


def retire(folder: Path, quota_bytes: float) -> list[Path]:
    """Delete maps of drives until all maps of the folder together take at most `quota_bytes`; those deleted."""
    for left_over in folder.glob(f".*{DELETED}"):
        shutil.rmtree(left_over, ignore_errors=True)
    maps = stored_maps(folder)
    total = sum(one.size_bytes for one in maps)
    may_go = [one for one in maps if one.is_from_drive and not one.is_kept]
    deleted = []
    for one in sorted(may_go, key=lambda one: one.needed_unix_s):
        if total <= quota_bytes:
            break
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
    if total > quota_bytes:
        log.warning("%s: its maps take %.0f MB, more than [mapping] quota_mb; none may be deleted", folder, total / 1e6)
    return deleted
