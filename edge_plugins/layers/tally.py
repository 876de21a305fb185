"""What a drive recognized: frames and passes by map, context and stretch; one small file for each run of the daemon.

The files lie in `.drives` of the folder of maps. A run writes to its own file only, whose counts only grow, so those of
several vehicles are joined by having all files in one folder.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError, reason
from edge.files import Behind, replacing
from edge.reference_map import MapHeader, MapSet
from edge.reference_map.store import plain_size

TALLIES, SUFFIX = ".drives", ".json"
STRETCH_PLACES = 50
"""Places that are counted together: 100 m of a map with a place each 2 m."""
KEPT_FILES = 1000
"""A vehicle's folder has at most so many, each of about 4 kB for 5 km; the oldest are deleted at a start."""
MOST_BYTES = 4 << 20
"""Of a file that is read: 5,000 km, and at most 60 MB of memory."""
WRITTEN_EACH_NS = 60_000_000_000
APART_SHARE, APART_M = 0.1, 20.0
"""By how much odometer and map may differ between two places for all in between to have been passed."""
LONGEST_PASSED_M = 2000.0
"""Over longer gaps, another road of the same length is as likely."""
LIGHTS = ((40.0, "dark"), (80.0, "dim"), (256.0, "bright"))
"""Mean gray level, of 255, below which pictures are called that."""
Counts = dict[str, dict[str, dict[int, int]]]
"""By map (`key_of`), context ("front forward dim") and stretch (row // STRETCH_PLACES)."""
log = logging.getLogger(__name__)


def light_of(gray_level: float) -> str:
    """What pictures of a mean gray level are called."""
    return next((name for limit, name in LIGHTS if gray_level < limit), "light unknown")


def source_of(map_path: Path) -> str:
    """What a map of a drive says of itself, by which it is known as long as it has its name: see `StoredMap`."""
    return f"drive of {map_path.name}"


def key_of(header: MapHeader, map_path: Path) -> str:
    """What a map is counted by: its checksum, or the source of the map of this drive, which has none yet."""
    return header.header_sha256 or source_of(map_path)


class Tally(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file. began_unix_s: of the run. recognized: frames believed. passed: how often no frame of a stretch was."""

    began_unix_s: float
    recognized: Counts
    passed: Counts

    @property
    def maps(self) -> dict[str, int]:
        """Frames believed by map."""
        return {key: sum(sum(one.values()) for one in contexts.values()) for key, contexts in self.recognized.items()}


class DriveTally:
    """Counts in memory, and writes from a thread of its own; a disk that refuses costs the counts, and nothing else."""

    def __init__(self, folder: Path, view: Literal["front", "rear"], began_unix_s: float, name: str) -> None:
        """folder: of maps. view: of the camera. name: by which no other run of any vehicle goes."""
        self._file, self._view = folder / TALLIES / f"{began_unix_s:012.0f}-{name}{SUFFIX}", view
        self._tally = Tally(began_unix_s, {}, {})
        self._last: dict[str, tuple[int, float]] = {}  # row and odometer of the newest frame by map
        self._written_ns = 0
        self._behind = Behind()
        self._behind.start(self._delete_oldest)

    def count(
        self,
        maps: MapSet,
        place: int,
        direction: str,
        image: NDArray[np.uint8],
        driven_m: float | None,
        now_ns: int,
    ) -> None:
        """A frame (H, W, 3) was believed to show a place, counted through the maps; driven_m: odometer, if known."""
        number = maps.index.map_of(place)
        first, one = maps.index.starts[number], maps.maps[number]
        key, row = key_of(one.header, one.path), place - first
        context = f"{self._view} {direction} {light_of(float(image[::8, ::8].mean()))}"
        _add(self._tally.recognized, key, context, [row // STRETCH_PLACES])
        before = self._last.pop(key, None)
        if driven_m is not None:
            if before is not None and _is_whole(maps, first + before[0], place, driven_m - before[1]):
                ends = sorted((before[0], row))
                between = set(range(ends[0] // STRETCH_PLACES + 1, ends[1] // STRETCH_PLACES))
                # What is not searched is not missed.
                gone = (range(a // STRETCH_PLACES, -(-b // STRETCH_PLACES)) for a, b in one.stale)
                _add(self._tally.passed, key, context, sorted(between.difference(*gone)))
            self._last[key] = row, driven_m
        if now_ns - self._written_ns >= WRITTEN_EACH_NS:
            self._written_ns = now_ns
            self._behind.start(partial(self._write, self._encoded()))

    def close(self) -> None:
        """Begin to write what is left, see `wait_for_writes`."""
        if self._tally.recognized:
            self._behind.start(partial(self._write, self._encoded()))

    def _encoded(self) -> bytes:
        return msgspec.json.encode(self._tally)

    def _write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(exist_ok=True)
            with replacing(self._file) as stream:
                stream.write(data)

    def _delete_oldest(self) -> None:
        with contextlib.suppress(OSError):
            for file in sorted(self._file.parent.glob(f"*{SUFFIX}"))[:-KEPT_FILES]:
                file.unlink()


def read_tallies(folder: Path) -> list[Tally]:
    """Of all drives of a folder of maps, the oldest first; one that cannot be read is named in the log."""
    found = []
    for file in sorted((folder / TALLIES).glob(f"*{SUFFIX}")):
        try:
            found.append(read_tally(file))
        except MapError as error:
            log.warning("%s; it is not counted", error)
    return sorted(found, key=lambda one: one.began_unix_s)


def read_tally(file: Path) -> Tally:
    """Of one drive; MapError."""
    try:
        if plain_size(file) > MOST_BYTES:
            raise MapError(f"{file}: too large for counts of a drive; delete it")
        return msgspec.json.decode(file.read_bytes(), type=Tally)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise MapError(f"{file}: cannot read these counts: {reason(error)}") from None


def _is_whole(maps: MapSet, before: int, place: int, driven_m: float) -> bool:
    """Whether the vehicle drove along the map's drive from one place to another."""
    index, route_m = maps.index, maps.places["route_m"]
    apart_m = abs(float(route_m[place] - route_m[before])) if index.segment_of(place) == index.segment_of(before) else 0
    return 0 < apart_m < LONGEST_PASSED_M and abs(apart_m - driven_m) <= APART_M + APART_SHARE * apart_m


def _add(counts: Counts, key: str, context: str, stretches: Iterable[int]) -> None:
    of_context = counts.setdefault(key, {}).setdefault(context, {})
    for stretch in stretches:
        of_context[stretch] = of_context.get(stretch, 0) + 1
