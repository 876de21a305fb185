"""A map that grows while it is searched: places are added in memory, and stay normalized over the whole set.

Mean and deviation (eq. 1) change with each place. So with each place RENEWED of the others, in turn, are normalized
again from their raw values: each descriptor was normalized with at least the first 15 sixteenths of the places that
there are. That costs the same for each place, however many there are. What is searched is never copied:
the descriptors lie in one piece of address space, of which only as much is memory as there are places.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.descriptor import RunningStatistics, normalized
from edge.reference_map.costs import CostMatcher, encode, inverse_lengths, squared_norms
from edge.reference_map.keypoint_file import KeypointsKey
from edge.reference_map.map_so_far import CAPACITY, PartialMap
from edge.reference_map.place_records import PLACE
from edge.reference_map.spatial_index import bounds_of
from edge.reference_map.store import MapHeader, ModelKey, RegionsKey
from edge_plugins.mapping.builder import DriveByDrive, Place

RENEWED = 16
"""Descriptors that are normalized again with each place that is added."""
MAP_NORESERVE = 0x4000  # Linux; Python 3.10 has no name for it

RawRows = Callable[[Sequence[int]], NDArray[np.float32]]
"""Raw descriptors (n, R, D) of some places by their rows, as they were added."""


class GrowingMap(DriveByDrive):
    """Places in the order in which they were passed, with what is needed to search them."""

    def __init__(
        self,
        path: Path,
        model: ModelKey,
        regions: RegionsKey,
        sampling: SamplingConfig,
        raw_rows: RawRows,
        *,
        thumbnails: Callable[[int], bytes] = lambda row: b"",
        keypoints: Any = None,
        capacity: int = CAPACITY,
    ) -> None:
        """path: where the map will be when it is complete. raw_rows, thumbnails: of places that were added.

        keypoints: what has the records (K,) of KEYPOINT of each row.
        """
        self.path, self._header = path, MapHeader.begun(model, regions, sampling)
        self._raw_rows, self._thumbnails, self._keypoints = raw_rows, thumbnails, keypoints
        shape = (regions.count, capacity, model.dimensions)
        memory = mmap.mmap(-1, int(np.prod(shape)), mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | MAP_NORESERVE)
        self._descriptors = np.frombuffer(memory, np.int8).reshape(shape)
        self._inverse = np.empty(capacity)
        self._places = np.empty(capacity, PLACE)
        self._statistics = RunningStatistics((regions.count, model.dimensions))
        self._next = 0  # of the descriptors to renew

    @property
    def count(self) -> int:
        """How many places it has."""
        return self._header.places

    @property
    def is_full(self) -> bool:
        """Whether no further place can be added."""
        return self.count == len(self._places)

    @property
    def places(self) -> NDArray[np.void]:
        """Records of PLACE of all places (N,)."""
        return self._places[: self.count]

    @property
    def mapped_m(self) -> float:
        """Length of its drives."""
        route_m, drives = self.places["route_m"], self._header.first(self.count).segments
        return float(sum(route_m[one.end - 1] - route_m[one.start] for one in drives))

    def add(self, raw: NDArray[np.float32], place: Place) -> None:
        """Add one place with its raw descriptor (R, D) to the current segment, and renew some of the others."""
        self.add_all(raw.astype("<f2").astype(np.float32)[np.newaxis], [place])
        others = range(min(RENEWED, self.count - 1))
        rows = [(self._next + number) % (self.count - 1) for number in others]
        if rows:
            self._next = (rows[-1] + 1) % self.count
            self._encode(rows, self._raw_rows(rows))

    def add_all(self, raw: NDArray[np.float32], places: Sequence[Place]) -> None:
        """Add places with their raw descriptors (n, R, D), of which each value is a float16; `renew` has to follow."""
        first, self._header = self.count, self._header.with_places(self.count + len(places))
        for row, place in enumerate(places, start=first):
            self._places[row] = place.record()
        self._statistics.update_all(raw)
        self._encode(range(first, self.count), raw)

    def keep_keypoints(self, key: KeypointsKey | None) -> None:
        """The places have keypoints of this key; None: none."""
        self._header = self._header.with_keypoints(key)

    def check(self) -> None:
        """Check again whether the drives moved as they claim."""
        self._header = self._header.checked(self.places)

    def renew(self) -> None:
        """Normalize all places again with the statistics of all, and check what their drives claim."""
        self.check()
        for first in range(0, self.count, RENEWED):
            rows = range(first, min(first + RENEWED, self.count))
            self._encode(rows, self._raw_rows(rows))

    def first(self, places: int) -> PartialMap:
        """A map of the first places."""
        records = self._places[:places]
        header = replace(self._header.first(places), bounds=bounds_of(records))
        descriptors = self._descriptors[:, :places]
        matcher = CostMatcher(descriptors, self._inverse[:places])
        return PartialMap(
            self.path,
            header,
            descriptors,
            records,
            matcher=matcher,
            mean=self._statistics.mean.copy(),
            deviation=self._statistics.deviation,
            thumbnails=self._thumbnails,
            keypoints=None if self._header.keypoints_key is None else self._keypoints,
        )

    def _encode(self, rows: Sequence[int], raw: NDArray[np.float32]) -> None:
        """Normalize some places with the statistics so far, and keep them as they are matched."""
        encoded = encode(normalized(raw, self._statistics.mean, self._statistics.deviation))
        norms_sq = squared_norms(encoded)
        self._descriptors[:, list(rows)] = encoded
        self._places["norm_sq"][list(rows)] = norms_sq
        self._inverse[list(rows)] = inverse_lengths(norms_sq)
