"""A map, or a folder of maps, as one: all of them opened at the start, and a map of this drive that grows.

Maps of a folder are taken in the order of their names, and their places are counted through (`PlaceIndex`). One that
cannot be used is excluded with the reason; a single map that cannot be used is an error.
"""

from __future__ import annotations

import hashlib
import logging
import mmap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import DescriptorConfig
from edge.errors import MapError, one_line
from edge.geodesy import Origin, east_north, first_known
from edge.reference_map.checksums import ChecksumSchedule, check_files
from edge.reference_map.costs import CostMatcher
from edge.reference_map.map_so_far import CAPACITY, PartialMap
from edge.reference_map.place_index import PlaceIndex
from edge.reference_map.place_records import PLACE
from edge.reference_map.self_similarity import lap_places
from edge.reference_map.spatial_index import Ranges, SpatialIndex
from edge.reference_map.store import KEYPOINTS, PLACES, MapHeader, ModelKey, ReferenceMap, RegionsKey, matching_files

SAMPLED_MAPS = 16
CUT = "cut off while it is in use; copy the map again"
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ExcludedMap:
    """A map of the folder that is not used, and why."""

    name: str
    why: str

    def log(self) -> None:
        """A line in the log."""
        log.warning("%s; excluded", self.why)


@dataclass(frozen=True)
class MapSet:
    """Some open maps, their places counted through.

    is_folder: whether these are the maps of a folder, even if there is but one. maps: each with its own rows of
    `places`. places: (N,) records of PLACE. excluded: maps of the folder that cannot be used. room: where `places` lie
    with space for further ones, if the last map grows: copying a million places would take longer than a frame may.
    """

    path: Path
    is_folder: bool
    maps: tuple[ReferenceMap, ...]
    places: NDArray[np.void]
    excluded: tuple[ExcludedMap, ...] = ()
    room: NDArray[np.void] | None = None

    @classmethod
    def of(
        cls,
        maps: ReferenceMap | Sequence[ReferenceMap],
        folder: Path | None = None,
        excluded: Sequence[ExcludedMap] = (),
    ) -> MapSet:
        """One open map, or those of a folder; MapError if none of them is usable."""
        several = [maps] if isinstance(maps, ReferenceMap) else maps
        if not several:
            raise MapError(f"{folder}: none of its {len(excluded)} maps is usable; the first: {excluded[0].why}")
        # One array for all, so that nothing needs to know where a map begins. The maps' own are views of it.
        places = several[0].places if len(several) == 1 else np.concatenate([one.places for one in several])
        return cls._in_order(several, places, folder, excluded)

    @classmethod
    def _in_order(
        cls,
        maps: Sequence[ReferenceMap],
        places: NDArray[np.void],
        folder: Path | None,
        excluded: Iterable[ExcludedMap],
    ) -> MapSet:
        """Some maps whose places are these, one map's after another's."""
        rows = PlaceIndex([one.header for one in maps]).rows
        several = tuple(replace(one, places=places[slice(*own)]) for one, own in zip(maps, rows, strict=True))
        path = several[0].path if folder is None else folder
        return cls(path, folder is not None, several, places, tuple(excluded))

    @cached_property
    def index(self) -> PlaceIndex:
        """Which map, row and segment a place belongs to."""
        return PlaceIndex(self.headers)

    @cached_property
    def blocks(self) -> SpatialIndex:
        """Where the places lie."""
        bounds = [(*rows, header.bounds) for header, rows in zip(self.headers, self.index.rows, strict=True)]
        return SpatialIndex(self.places, bounds)

    @cached_property
    def matchers(self) -> tuple[CostMatcher, ...]:
        """Of all maps."""
        return tuple(one.matcher if isinstance(one, PartialMap) else CostMatcher.of(one) for one in self.maps)

    def with_newest(self, newest: PartialMap) -> MapSet:
        """A new set with the map of this drive as it now is, after all others; places that were there stay theirs."""
        others = [one for one in self.maps if one.path != newest.path]  # those before it: it is always the last
        first = sum(one.header.places for one in others)
        end, room = first + newest.header.places, self.room
        if room is None or len(room) < end:
            room = np.empty(first + max(CAPACITY, newest.header.places), PLACE)  # of which only what is used is memory
            room[:first] = self.places[:first]
        room[first:end] = newest.places
        grown = replace(MapSet._in_order([*others, newest], room[:end], self.path, self.excluded), room=room)
        known = len(grown.index.segments) - len(newest.header.segments)
        # What the others have is not computed again.
        vars(grown)["laps"] = (*self.laps[:known], *[None] * len(newest.header.segments))
        vars(grown)["matchers"] = (*self.matchers[: len(others)], newest.matcher)
        return grown

    @property
    def headers(self) -> tuple[MapHeader, ...]:
        """Of all maps."""
        return tuple(one.header for one in self.maps)

    @cached_property
    def laps(self) -> tuple[int | None, ...]:
        """How many places a lap has, of each segment; None where it is not closed, or grows."""
        growing = len(self.maps[-1].header.segments) if isinstance(self.maps[-1], PartialMap) else 0
        segments = self.index.segments[: len(self.index.segments) - growing]
        return (*lap_places(self.maps, self.places, self.index, segments), *[None] * growing)

    @property
    def names(self) -> tuple[str, ...]:
        """Of all maps."""
        return tuple(name_of(one.path) for one in self.maps)

    @property
    def sha256(self) -> str:
        """A checksum of all headers, and so of all maps."""
        digests = [header.header_sha256 for header in self.headers]
        return digests[0] if not self.is_folder else hashlib.sha256("".join(digests).encode()).hexdigest()

    def __str__(self) -> str:
        """For people: how much there is."""
        count = len(self.maps)
        return f"{self.index.places} places" + (f" in {count} map{'s' * (count > 1)}" if self.is_folder else "")

    def spell(self, maps: Sequence[int]) -> str:
        """Some maps, for people; the names of the first."""
        names = ", ".join(self.names[index] for index in maps[:3])
        return f"{len(maps)} of its maps ({names}{', ...' if len(maps) > 3 else ''})" if self.is_folder else "the map"

    def locate(self, place_index: int) -> tuple[str | None, int]:
        """The name of a place's map, None if there is only that, and its row there."""
        index = self.index.map_of(place_index)
        name = name_of(self.maps[index].path) if self.is_folder else None
        return name, place_index - self.index.starts[index]

    def folders_of(self, ranges: Ranges) -> list[Path]:
        """The folders of the maps that some places lie in."""
        return [self.maps[index].path for index in self.index.maps_of(ranges)]

    def folders_behind(self, place_index: int, sequence_length: int) -> list[Path]:
        """Of the maps that a match rests on: that of its place, and the tiles that its sequence may have come from."""
        return self.folders_of(self.index.widened([(place_index, place_index + 1)], sequence_length))

    def check_places(self, ranges: Ranges) -> None:
        """Check where some places are against the checksums of their maps, if on the disk. MapError for damage."""
        for one in (self.maps[index] for index in self.index.maps_of(ranges)):
            check_files(one.path, one.header.files, {PLACES} & one.header.files.keys())

    def checksum_schedule(self) -> ChecksumSchedule:
        """What must be checked before anything that rests on a map is published."""
        return ChecksumSchedule({one.path: (one.header.files, matching_files(one.header)) for one in self.maps})

    def costs(self, query: NDArray[np.float32], ranges: Ranges) -> NDArray[np.int32]:
        """Normalized rows (n, R, D) against some places: (n, orders, places), see `CostMatcher.costs`.

        MapError for a map of which that is no longer possible.
        """
        encoded: dict[int, NDArray[np.int8]] = {}  # tiles of one map have one projection
        costs = []
        for index, pieces in groupby(self.index.by_map(ranges), key=lambda piece: piece[0]):
            matcher, cut = self.matchers[index], _cut_off(self.maps[index])
            if cut is not None:
                raise MapError(f"{cut}: {CUT}")
            alike = id(matcher.projection)
            if alike not in encoded:
                encoded[alike] = matcher.encoded(query)
            costs.append(matcher.costs_of_encoded(encoded[alike], [(start, end) for _, start, end in pieces]))
        return costs[0] if len(costs) == 1 else np.concatenate(costs, axis=2)

    def keypoints_of(self, place_index: int) -> NDArray[np.void]:
        """Records (K,) of KEYPOINT of a place of a map that has them; a copy. MapError where that is not possible."""
        index = self.index.map_of(place_index)
        one = self.maps[index]
        records, cut = one.keypoints, _cut_off(one)
        if cut is not None or records is None:
            raise MapError(f"{cut or one.path / KEYPOINTS}: {CUT}")
        record = np.array(records[place_index - self.index.starts[index]])
        pages: mmap.mmap | None = getattr(records, "_mmap", None)
        if pages is not None:  # or a drive would keep all that it passes
            pages.madvise(mmap.MADV_DONTNEED)
        return record

    def east_north_m(self, ranges: Ranges) -> NDArray[np.float64]:
        """Meters (n, 2) of some places, from an origin close to them all; NaN where unknown."""
        places = self.places_in(ranges)
        return east_north(places["lat_deg"], places["lon_deg"], self.origin(ranges))

    def origin(self, ranges: Ranges) -> Origin | None:
        """The origin of `east_north_m`, None where no position is known."""
        origins = (self._origin(index) for index in self.index.maps_of(ranges))
        return next((origin for origin in origins if origin is not None), None)

    def places_in(self, ranges: Ranges) -> NDArray[np.void]:
        """Records of PLACE of some places."""
        pieces = [self.places[start:end] for start, end in ranges]
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)

    def release(self, ranges: Ranges) -> None:
        """Give back the memory of the maps that some places lie in, since they will not be searched for a while."""
        for index in self.index.maps_of(ranges):
            self.maps[index].release()

    def statistics(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and standard deviation (R, D) of the raw descriptors, of a few maps where there are many.

        Alike for all regions, since the left of the query may be the map's right. Maps whose file cannot be read are
        skipped, since their checksums will exclude them; MapError if that is all.
        """
        found: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        failed = MapError(f"{self.path}: no map")
        for one in self.maps[:: -(-len(self.maps) // SAMPLED_MAPS)]:
            try:
                found.append(one.statistics())
            except MapError as error:
                failed = error
        if not found:
            raise failed
        each = np.mean(found, axis=0)
        each[:] = each.mean(axis=1, keepdims=True)
        return each[0], each[1]

    def thumbnail(self, place_index: int) -> bytes:
        """The place's small JPEG, for people; b"" where there is none. Read from the disk; any thread may ask."""
        index = self.index.map_of(place_index)
        try:
            return self.maps[index].thumbnail(place_index - self.index.starts[index])
        except OSError:
            return b""

    @property
    def cut(self) -> dict[Path, str]:
        """The folders of maps that were cut off, and so cannot be searched any more."""
        found = ((one.path, _cut_off(one)) for one in self.maps)
        return {path: f"{file}: {CUT}" for path, file in found if file is not None}

    def without(self, damaged: Mapping[Path, str]) -> MapSet:
        """A new set without the maps in some folders, each with the reason. MapError for the only one, or the last."""
        if not damaged:
            return self
        if not self.is_folder:
            raise MapError(next(iter(damaged.values())))
        kept = [one for one in self.maps if one.path not in damaged]
        reasons = [ExcludedMap(name_of(path), printable(why)) for path, why in damaged.items()]
        return MapSet.of(kept, self.path, [*self.excluded, *reasons])

    def fitting(self, model: ModelKey, descriptor: DescriptorConfig) -> MapSet:
        """A set without the maps whose descriptors this model and these regions cannot be compared with; MapError."""
        unfit = ((one.path, _misfit(one, model, descriptor)) for one in self.maps)
        return self.without({path: why for path, why in unfit if why})

    def _origin(self, index: int) -> tuple[float, float] | None:
        one = self.maps[index]
        tile = one.header.tile
        return tile.origin if tile else first_known(one.places["lat_deg"], one.places["lon_deg"])


def _cut_off(one: ReferenceMap) -> Path | None:
    """A file of a map that has become shorter than what is mapped of it: to read beyond its end kills the process."""
    for name, array in one.mapped_files.items():
        pages: mmap.mmap | None = getattr(array, "_mmap", None)
        if pages is not None and pages.size() < array.nbytes:
            return one.path / name
    return None


def _misfit(one: ReferenceMap, model: ModelKey, wanted: DescriptorConfig) -> str:
    """Why a map's descriptors cannot be compared with this model's of these regions; "" if they can."""
    made, ours = one.header, RegionsKey.of(wanted)
    if made.model.sha256 != model.sha256 or made.model.tap != model.tap:
        return (
            f"{one.path}: made with model {made.model}, but the model here is {model};"
            " name the map's by --model or in [descriptor] model"
        )
    if ours != made.regions:
        return (
            f"{one.path}: made with regions {made.regions}, but [descriptor] is {ours};"
            " change it or build the map again"
        )
    return ""


def name_of(folder: Path) -> str:
    """The name of a map's folder, for people."""
    return printable(folder.name)


def printable(text: str) -> str:
    """A text with any names of files, as journal and page can have it: one line of UTF-8."""
    return one_line(text.encode("utf-8", "replace").decode())
