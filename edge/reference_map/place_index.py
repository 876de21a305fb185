"""The places of several maps counted through, as if they were one map. Known from their headers alone.

Tiles that were cut from one map and follow each other are as whole as that map was: a drive that runs on from one into
the next is one segment.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from itertools import accumulate, pairwise

from edge.reference_map.spatial_index import Ranges
from edge.reference_map.store import MapHeader

STEEPEST = 2.0  # places per frame, above the steepest slope of the default limits


class PlaceIndex:
    """Which map, which row of it and which segment a place belongs to; `places` is how many there are together."""

    def __init__(self, headers: Sequence[MapHeader]) -> None:
        """headers: of the maps, in their order."""
        self.starts: list[int] = list(accumulate((header.places for header in headers), initial=0))
        """The first place of each map, and one more at the end."""
        self.places = self.starts[-1]
        self.rows = list(pairwise(self.starts))
        """Places [start, end) of each map."""
        follows = [False, *(_follows(before, after) for before, after in pairwise(headers))]
        self._breaks = [start for start, is_next in zip(self.starts, [*follows, False], strict=True) if not is_next]
        begins, self._views, self._sources, self._moved, self._whole = [], [], [], [], []
        for header, start, is_next in zip(headers, self.starts, follows, strict=False):
            for number, segment in enumerate(header.segments):
                if number or not (is_next and header.tile and header.tile.continues):
                    begins.append(start + segment.start)
                    self._views.append(segment.view)
                    self._sources.append(segment.source)
                    self._moved.append(segment.moved_as_driven)
                    self._whole.append(segment.whole_sigma_m)
                else:
                    self._moved[-1] &= segment.moved_as_driven
        self._segments = [*begins, self.places]

    def map_of(self, place: int) -> int:
        """The number of the map that a place lies in."""
        return bisect_right(self.starts, place) - 1

    def segment_of(self, place: int) -> int:
        """The number of its segment."""
        return bisect_right(self._segments, place) - 1

    def segment(self, number: int) -> tuple[int, int]:
        """The places [start, end) of a segment."""
        return self._segments[number], self._segments[number + 1]

    @property
    def segments(self) -> list[tuple[int, int]]:
        """The places [start, end) of each segment, in order."""
        return list(pairwise(self._segments))

    def view(self, segment: int) -> str:
        """Where the camera of a segment faced."""
        return self._views[segment]

    def recording(self, segment: int) -> str:
        """The name of the recording that a segment comes from; it may have several, in several maps."""
        return self._sources[segment]

    def moved_as_driven(self, segment: int) -> bool:
        """Whether its positions are known to have moved as its vehicle did, see `Segment`."""
        return self._moved[segment]

    def whole_sigma_m(self, segment: int) -> float | None:
        """What all its positions are off by together, see `Segment`."""
        return self._whole[segment]

    def by_map(self, ranges: Ranges) -> Iterator[tuple[int, int, int]]:
        """The ranges in pieces that lie in one map each: its number, and rows [start, end) of it."""
        for start, end in ranges:
            for index in range(self.map_of(start), self.map_of(end - 1) + 1):
                first, last = self.starts[index : index + 2]
                yield index, max(start, first) - first, min(end, last) - first

    def by_segment(self, ranges: Ranges) -> Iterator[tuple[int, int, int]]:
        """The ranges in pieces that lie in one segment each: its number, and places [start, end)."""
        for start, end in ranges:
            for number in range(self.segment_of(start), self.segment_of(end - 1) + 1):
                first, last = self.segment(number)
                yield number, max(start, first), min(end, last)

    def maps_of(self, ranges: Ranges) -> list[int]:
        """The maps that the ranges touch, in order."""
        return sorted({index for index, _, _ in self.by_map(ranges)})

    def widened(self, ranges: Ranges, sequence_length: int) -> Ranges:
        """The ranges with the places that a sequence ending in them may have passed before."""
        return widened(ranges, sequence_length, self._breaks)

    def whole(self, place: int) -> tuple[int, int]:
        """The map that a place lies in, with the tiles before and after it: places [start, end)."""
        number = bisect_right(self._breaks, place)
        return self._breaks[number - 1], self._breaks[number]


def _follows(before: MapHeader, after: MapHeader) -> bool:
    """Whether two maps are tiles of one, and the second begins where the first ends."""
    first, second = before.tile, after.tile
    return (
        first is not None
        and second is not None
        and first.map_sha256 == second.map_sha256
        and first.start + before.places == second.start
    )


def widened(ranges: Ranges, sequence_length: int, breaks: Sequence[int]) -> Ranges:
    """Sorted ranges with the places that a sequence ending in them may have passed before; merged where they touch.

    breaks: 0, the number of places, and in between the places that no sequence crosses.
    """
    margin = math.ceil(STEEPEST * sequence_length)
    out: Ranges = []
    for start, end in ranges:
        floor, ceiling = breaks[bisect_right(breaks, start) - 1], breaks[bisect_left(breaks, end)]
        first, last = max(floor, start - margin), min(ceiling, end + margin)
        if out and first <= out[-1][1]:
            out[-1] = (out[-1][0], max(last, out[-1][1]))
        else:
            out.append((first, last))
    return out
