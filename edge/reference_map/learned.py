"""What `map learn` found of a folder of maps: `.learned.json`, one file, so that one rename changes all of it.

Nothing is moved or deleted, so that a daemon goes on with the maps that it has open. What was learned of a drive is
kept by the checksum of its header: another map of the same name is as it was recorded. A file that cannot be read
changes nothing. Newer positions are in files of their own, named by their checksums, which are written first.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.files import read_kept, replacing
from edge.reference_map.place_records import check_places
from edge.reference_map.spatial_index import bounds_of
from edge.reference_map.store import ReferenceMap, read_header

LEARNED_FILE, POSITIONS = ".learned.json", ".positions"
KEPT_STEPS = 16
"""Earlier states that `map learn --undo` can go back to: a fortnight of learning once a day."""
FIELDS = ("lat_deg", "lon_deg", "position_sigma_m")
"""Rows of a file of positions, each of 8-byte numbers."""
log = logging.getLogger(__name__)


class Newer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Positions of a drive: the checksum of their file. recording: of a drive without GPS, by which it was placed."""

    sha256: str
    recording: str = ""


class Learned(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """retired: name of each drive that is not searched, and the checksum of its header.

    By the checksum of a drive's header: stale: places [start, end) that are no longer there. newer: positions.
    """

    retired: dict[str, str] = {}
    stale: dict[str, list[tuple[int, int]]] = {}
    newer: dict[str, Newer] = {}


class LearnedFolder:
    """The states of a folder, the newest last."""

    def __init__(self, folder: Path) -> None:
        """Read the file."""
        self._file, self._positions = folder / LEARNED_FILE, folder / POSITIONS
        lost = "cannot read it, so all drives are searched"
        self._states = read_kept(self._file, list[Learned], lost) or []

    @property
    def newest(self) -> Learned:
        """What holds now."""
        return self._states[-1] if self._states else Learned()

    def retires(self, map_path: Path) -> bool:
        """Whether a map of the folder is not searched; one whose header is damaged is."""
        try:
            sha256 = self.newest.retired.get(map_path.name)
            return sha256 is not None and sha256 == read_header(map_path).header_sha256
        except MapError:
            return False

    def searched(self, map_paths: list[Path]) -> list[Path]:
        """Those that are not retired; all of them if all are, since those that replaced them are gone."""
        return [path for path in map_paths if not self.retires(path)] or map_paths

    def applied(self, one: ReferenceMap, *, moves: bool = True) -> ReferenceMap:
        """A map of the folder with its stale places, and, if it `moves`, its newest positions. MapError."""
        sha256, places = one.header.header_sha256, len(one.places)
        stale = tuple((a, b) for a, b in self.newest.stale.get(sha256, ()) if 0 <= a < b <= places)
        newer = self.newest.newer.get(sha256) if moves else None
        rows = None if newer is None else self._read(newer.sha256, places)
        if newer is None or rows is None:
            return replace(one, stale=stale) if stale else one
        one = with_positions(replace(one, stale=stale), rows)
        check_places(self._positions / newer.sha256, one.places)
        one = replace(one, header=one.header.checked(one.places))
        if not newer.recording:
            return one
        # What it says of a position is what that recording says: together they are one.
        segments = tuple(msgspec.structs.replace(segment, source=newer.recording) for segment in one.header.segments)
        return replace(one, header=msgspec.structs.replace(one.header, segments=segments))

    def add(self, learned: Learned, positions: Mapping[str, NDArray[np.float64]]) -> None:
        """Let this hold from now on. MapError if it cannot be written; then nothing has changed.

        positions: of drives by the checksums of their headers, rows of FIELDS (3, N); those of `learned.newer`.
        """
        try:
            for sha256, rows in positions.items():
                file = self._positions / learned.newer[sha256].sha256
                file.parent.mkdir(exist_ok=True)
                if not file.exists():
                    with replacing(file) as stream:
                        stream.write(_encoded(rows))
        except OSError as error:
            raise MapError(f"{self._positions}: cannot write it: {error.strerror}") from None
        self._write([*self._states, learned])

    def undo(self) -> None:
        """Go back to the state before. MapError if there is none, or the file cannot be written."""
        if not self._states:
            raise MapError(f"{self._file.parent}: nothing to undo: nothing was ever learned here")
        self._write(self._states[:-1])

    def _read(self, sha256: str, places: int) -> NDArray[np.float64] | None:
        """Rows of FIELDS (3, N); None, and a line in the log, where they are not what was written."""
        try:
            data = (self._positions / sha256).read_bytes()
        except OSError as error:
            log.warning("%s: positions are as recorded: %s", self._positions / sha256, error.strerror)
            return None
        if hashlib.sha256(data).hexdigest() != sha256 or len(data) != 8 * len(FIELDS) * places:
            log.warning("%s: damaged; positions are as recorded", self._positions / sha256)
            return None
        return np.frombuffer(data, "<f8").reshape(len(FIELDS), places)

    def _write(self, states: list[Learned]) -> None:
        kept = states[-KEPT_STEPS:]
        try:
            with replacing(self._file) as stream:
                stream.write(msgspec.json.encode(kept))
            named = {one.sha256 for state in kept for one in state.newer.values()}
            for file in self._positions.glob("[!.]*"):
                if file.name not in named:
                    file.unlink()
        except OSError as error:
            raise MapError(f"{self._file}: cannot write it: {error.strerror}") from None
        self._states = kept


def with_positions(one: ReferenceMap, rows: NDArray[np.float64]) -> ReferenceMap:
    """A map whose places are elsewhere, by rows of FIELDS (3, N)."""
    records = one.places.copy()
    for name, values in zip(FIELDS, rows, strict=True):
        records[name] = values
    return replace(one, header=msgspec.structs.replace(one.header, bounds=bounds_of(records)), places=records)


def checksum(rows: NDArray[np.float64]) -> str:
    """The name of a file of positions, rows of FIELDS (3, N)."""
    return hashlib.sha256(_encoded(rows)).hexdigest()


def _encoded(rows: NDArray[np.float64]) -> bytes:
    return np.ascontiguousarray(rows, "<f8").tobytes()
