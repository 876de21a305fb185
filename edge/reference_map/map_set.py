"""A map, or a folder of maps, as one: only the headers are read at the start, and a map is opened where it is searched.

Maps of a folder are taken in the order of their names, and their places are counted through (`numbering`). One that
cannot be used is left out, and told of once; a single map that cannot be used is an error.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import MapError
from edge.reference_map.checksums import Checksums
from edge.reference_map.loaded_map import LoadedMap, Origin
from edge.reference_map.place_index import PlaceIndex
from edge.reference_map.route import east_north_of
from edge.reference_map.spatial_index import MapBounds, Ranges, SpatialIndex
from edge.reference_map.store import (
    HEADER,
    PROJECTION,
    MapHeader,
    ReferenceMap,
    open_map,
    open_unverified,
    read_header,
    read_thumbnail,
)

SPARE = 2
"""So many maps stay open beyond those in use: a vehicle may come back to where it has just been."""

log = logging.getLogger(__name__)
Tell = Callable[[str, str], object]
"""Is called with the name of a map that is left out, and why."""


def log_left_out(name: str, why: str) -> None:
    """A line in the log."""
    log.warning("%s; left out", why)


class MapSet:
    """Some maps, and those of them that are open."""

    def __init__(self, path: Path, folders: Sequence[Path], headers: Sequence[MapHeader], tell: Tell | None) -> None:
        """folders, headers: of the maps at `path`. tell: None for a single map, which is not left out."""
        self.path, self.folders, self.headers = path, tuple(folders), tuple(headers)
        self.names = tuple(map(_name_of, folders))
        self.numbering = PlaceIndex(headers)
        self.areas = MapBounds([header.bounds for header in headers])
        self.left_out: dict[int, str] = {}
        self._tell = tell
        self._open: dict[int, LoadedMap] = {}  # the one used longest ago first
        self._areas: dict[int, tuple[Origin, SpatialIndex]] = {}
        self._in_use: set[int] = set()

    @classmethod
    def of(cls, reference_map: ReferenceMap, verification: Checksums | None = None) -> MapSet:
        """One open map, of which that is left to be verified."""
        atlas = cls(reference_map.path, [reference_map.path], [reference_map.header], None)
        atlas._open[0] = LoadedMap(reference_map, verification or Checksums(reference_map.path, {}, []))
        atlas._in_use = {0}
        return atlas

    @property
    def is_folder(self) -> bool:
        """Whether these are the maps of a folder, even if there is but one."""
        return self._tell is not None

    @property
    def open_count(self) -> int:
        """How many maps are open."""
        return len(self._open)

    @property
    def sha256(self) -> str:
        """A checksum of all headers, and so of all maps."""
        digests = [header.header_sha256 for header in self.headers]
        return digests[0] if not self.is_folder else hashlib.sha256("".join(digests).encode()).hexdigest()

    def __str__(self) -> str:
        """For people: how much there is that can be used."""
        used = [header.places for index, header in enumerate(self.headers) if index not in self.left_out]
        return f"{sum(used)} places" + (f" in {len(used)} map{'s' * (len(used) > 1)}" if self.is_folder else "")

    def spell(self, maps: Sequence[int]) -> str:
        """Some maps, for people; the names of the first."""
        names = ", ".join(self.names[index] for index in maps[:3])
        return f"{len(maps)} of its maps ({names}{', ...' if len(maps) > 3 else ''})" if self.is_folder else "the map"

    def locate(self, place: int) -> tuple[str | None, int]:
        """The name of a place's map, None if there is only that, and its row there."""
        index = self.numbering.map_of(place)
        return self.names[index] if self.is_folder else None, place - self.numbering.starts[index]

    def feed_row(self, place: int) -> int | None:
        """The row of the feed that a place was made of; None where its map cannot be opened."""
        return int(self.records(place, place + 1)[0]["row"]) if self.opened([(place, place + 1)]) else None

    def leave_out(self, index: int, error: MapError) -> None:
        """Go on without a map. MapError if it is the only one, or was the last."""
        if self._tell is None:
            raise error
        self._close(index)
        self.left_out[index] = _printable(str(error))
        self._tell(self.names[index], self.left_out[index])
        if len(self.left_out) == len(self.headers):
            raise MapError(f"{self.path}: none of its {len(self.headers)} maps can be used; build or copy them again")

    def opened(self, ranges: Ranges, at_most: int | None = None) -> Ranges | None:
        """Open what the ranges touch; the ranges without maps that cannot be used. None if `at_most` did not suffice.

        Then those many have been opened, so that it gets further with the next call.
        """
        touched = self.numbering.maps_of(ranges)
        missing = [index for index in touched if not self._has(index)]
        for index in [one for one in touched if self._has(one)] + missing[:at_most]:
            self._sheet(index)
        if at_most is not None and len(missing) > at_most:
            return None
        return self.numbering.without(ranges, self.left_out)

    def within(self, lat_deg: float, lon_deg: float, radius_m: float, *, limit: int, at_most: int) -> Ranges | None:
        """Ranges that hold all places within `radius_m` of a position, and some more; None while that is not known.

        At most so many maps are opened to find out. Of a radius that holds more than `limit` places, some ranges that
        are too many come at once.
        """
        starts = self.numbering.starts
        inside = self.areas.inside(lat_deg, lon_deg, radius_m).tolist()
        if sum(self.headers[index].places for index in inside) > limit:
            return [(starts[index], starts[index + 1]) for index in inside]
        out: Ranges = []
        for index in self.areas.within(lat_deg, lon_deg, radius_m).tolist():
            if index not in self._areas and index not in self.left_out:
                if at_most == 0:
                    return None
                at_most -= not self._has(index)
                self._sheet(index)
            if index in self._areas:
                origin, areas = self._areas[index]
                found = areas.within(east_north_of(lat_deg, lon_deg, origin), radius_m)
                out += [(start + starts[index], end + starts[index]) for start, end in found]
        return out

    def records(self, start: int, end: int) -> NDArray[np.void]:
        """Records of PLACE of some places that are `opened`."""
        pieces = [sheet.map.places[rows] for sheet, rows in self._pieces([(start, end)])]
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)

    def route_m(self, ranges: Ranges) -> NDArray[np.float64]:
        """Metres along their drives (n,) of places that are `opened`."""
        return np.concatenate([sheet.route_m[rows] for sheet, rows in self._pieces(ranges)])

    def east_north_m(self, ranges: Ranges) -> NDArray[np.float64]:
        """Metres (n, 2) of places that are `opened`, from an origin close to them all; NaN where unknown."""
        pieces = list(self._pieces(ranges))
        origin = next((sheet.origin for sheet, _ in pieces if sheet.origin is not None), None)
        return np.concatenate([sheet.east_north_m(origin)[rows] for sheet, rows in pieces])

    def costs(self, query: NDArray[np.float32], ranges: Ranges) -> NDArray[np.int32]:
        """Normalised rows (n, R, D) against places that are `opened`: (n, orders, places), see `CostMatcher.costs`."""
        encoded: dict[str, NDArray[np.int8]] = {}
        costs = []
        for index, pieces in groupby(self.numbering.by_map(ranges), key=lambda piece: piece[0]):
            matcher = self._open[index].matcher
            shrinking = self.headers[index].files.get(PROJECTION)
            alike = shrinking.sha256 if shrinking else ""  # tiles of one map were shrunk alike
            if alike not in encoded:
                encoded[alike] = matcher.encoded(query)
            costs.append(matcher.costs_of_encoded(encoded[alike], [(start, end) for _, start, end in pieces]))
        return costs[0] if len(costs) == 1 else np.concatenate(costs, axis=2)

    def thumbnail(self, place: int) -> bytes:
        """The place's small JPEG, for people; b"" where there is none. Any thread may ask."""
        index = self.numbering.map_of(place)
        try:
            return read_thumbnail(self.folders[index], place - self.numbering.starts[index])
        except MapError:
            return b""

    def use(self, maps: Iterable[int]) -> None:
        """From now on these are in use: they stay open and are verified. Others are closed, but for a few.

        A single map is always in use.
        """
        if self._tell is None:
            return
        self._in_use = set(maps) - self.left_out.keys()
        idle = [index for index in self._open if index not in self._in_use]
        for index in idle[: max(0, len(idle) - SPARE)]:
            self._close(index)

    def verify(self, max_bytes: int, maps: Collection[int] | None = None) -> bool:
        """Read on by that much of what is in use, or of some `maps`; True when all checksums of it were seen to hold.

        A map of which one does not is left out. MapError if that is the only one, or was the last.
        """
        wanted = self._in_use if maps is None else maps
        for index in sorted(self._open.keys() & wanted):
            try:
                if not self._open[index].verification.step(max_bytes):
                    return False
            except MapError as error:
                self.leave_out(index, error)
                return False
        return True

    def check_every_file(self) -> None:
        """Check every byte of every map now, those that only people see included; see `leave_out`."""
        for index, folder in enumerate(self.folders):
            if index not in self.left_out:
                try:
                    open_map(folder, every_file=True)
                except MapError as error:
                    self.leave_out(index, error)

    def close(self) -> None:
        """Close all maps."""
        for index in list(self._open):
            self._close(index)

    def _pieces(self, ranges: Ranges) -> Iterator[tuple[LoadedMap, slice]]:
        for index, start, end in self.numbering.by_map(ranges):
            yield self._open[index], slice(start, end)

    def _has(self, index: int) -> bool:
        return index in self._open or index in self.left_out

    def _sheet(self, index: int) -> None:
        """Open a map, or leave it out; one that is open is now the one used last."""
        if index in self.left_out:
            return
        try:
            sheet = self._open.pop(index, None) or self._opened_anew(index)
        except MapError as error:
            self.leave_out(index, error)
            return
        self._open[index] = sheet
        if index not in self._areas and sheet.origin is not None:
            self._areas[index] = sheet.origin, sheet.areas()

    def _opened_anew(self, index: int) -> LoadedMap:
        """Open a map, if it is still the one whose header was read and agreed to at the start."""
        sheet = LoadedMap.open(self.folders[index])
        if sheet.map.header != self.headers[index]:
            raise MapError(f"{self.folders[index]}: another map than at the start; start again to use it")
        return sheet

    def _close(self, index: int) -> None:
        sheet = self._open.pop(index, None)
        if sheet is not None:
            sheet.verification.close()


def open_map_set(path: Path, tell: Tell = log_left_out) -> MapSet:
    """Open the map at a path, or a folder of maps, of which nothing but the headers is read. MapError.

    Where there is more than a single map, `tell` is called with each that cannot be used, and why.
    """
    folders = _maps_in(path)
    if not folders:
        return MapSet.of(*open_unverified(path))
    known: list[tuple[Path, MapHeader]] = []
    for folder in folders:
        try:
            known.append((folder, read_header(folder)))
        except MapError as error:
            tell(_name_of(folder), _printable(str(error)))
    if not known:
        raise MapError(f"{path}: none of its {len(folders)} maps can be used; build or copy them again")
    return MapSet(path, [folder for folder, _ in known], [header for _, header in known], tell)


def _maps_in(path: Path) -> list[Path]:
    """The maps of a folder, in the order of their names; none if it is a map itself."""
    try:
        if (path / HEADER).exists() or not path.is_dir():
            return []
        # What is hidden is still being built.
        return sorted(one for one in path.iterdir() if not one.name.startswith(".") and (one / HEADER).exists())
    except OSError as error:
        raise MapError(f"{error.filename}: cannot read it: {error.strerror}") from None


def _name_of(folder: Path) -> str:
    return _printable(folder.name)


def _printable(text: str) -> str:
    """A text with names of files that are not UTF-8, as journal and page can have it."""
    return text.encode("utf-8", "replace").decode()
