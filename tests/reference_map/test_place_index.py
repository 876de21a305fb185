"""Places of several maps counted through: nothing is lost or counted twice, whatever the maps are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from edge.config import SamplingConfig
from edge.reference_map.place_index import PlaceIndex
from edge.reference_map.spatial_index import Ranges
from edge.reference_map.store import FORMAT, VERSION, MapHeader, ModelKey, RegionsKey, Segment, TileOf


def header(lengths: list[int], tile: TileOf | None = None) -> MapHeader:
    """Of a map with segments of those lengths, every other one seen from behind."""
    ends = np.cumsum(lengths).tolist()
    segments = tuple(
        Segment(end - length, end, "rear" if number % 2 else "front", "")
        for number, (end, length) in enumerate(zip(ends, lengths, strict=True))
    )
    key, regions = ModelKey("test", "0" * 64, "fc6", 8), RegionsKey("left-right", 0.4)
    return MapHeader(
        FORMAT, VERSION, "", key, regions, 8, SamplingConfig(), ends[-1], segments, bounds=None, files={}, tile=tile
    )


lengths = st.lists(st.integers(1, 30), min_size=1, max_size=4)
several = st.lists(lengths, min_size=1, max_size=6)


def inside(ranges: Ranges, places: int) -> np.ndarray:
    """How often each place is in the ranges."""
    count = np.zeros(places, dtype=int)
    for start, end in ranges:
        assert 0 <= start < end <= places
        count[start:end] += 1
    return count


@given(of_maps=several, data=st.data())
def test_ranges_in_pieces(of_maps: list[list[int]], data: st.DataObject) -> None:
    numbering = PlaceIndex([header(one) for one in of_maps])
    total = sum(map(sum, of_maps))
    assert numbering.places == total
    cuts = sorted(data.draw(st.sets(st.integers(0, total), max_size=6)))
    ranges = list(zip(cuts[::2], cuts[1::2], strict=False))
    wanted = inside(ranges, total)
    maps = np.repeat(np.arange(len(of_maps)), [sum(one) for one in of_maps])
    flat = [length for one in of_maps for length in one]
    segments = np.repeat(np.arange(len(flat)), flat)
    pieces = list(numbering.by_map(ranges))
    starts = [(numbering.starts[index] + start, numbering.starts[index] + end) for index, start, end in pieces]
    np.testing.assert_array_equal(inside(starts, total), wanted)
    assert all((maps[start:end] == index).all() for (index, _, _), (start, end) in zip(pieces, starts, strict=True))
    drives = list(numbering.by_segment(ranges))
    np.testing.assert_array_equal(inside([(start, end) for _, start, end in drives], total), wanted)
    assert all((segments[start:end] == number).all() for number, start, end in drives)
    assert numbering.maps_of(ranges) == sorted(set(maps[wanted == 1].tolist()))


@given(of_drives=lengths, data=st.data())
def test_tiles_that_follow_each_other_are_as_whole_as_their_map(of_drives: list[int], data: st.DataObject) -> None:
    total = sum(of_drives)
    borders = [0, *sorted(data.draw(st.sets(st.integers(1, max(1, total - 1)), max_size=5)) - {total}), total]
    begins = [0, *np.cumsum(of_drives).tolist()]
    whole, tiles = PlaceIndex([header(of_drives)]), []
    for start, end in pairwise(borders):
        inner = [start, *(at for at in begins if start < at < end), end]
        tile = TileOf("0" * 64, start, start not in begins, None)
        tiles.append(header(np.diff(inner).tolist(), tile))
    numbering = PlaceIndex(tiles)
    assert [numbering.segment_of(place) for place in range(total)] == [
        whole.segment_of(place) for place in range(total)
    ]
    assert numbering.whole(total - 1) == (0, total)
    assert numbering.widened([(total // 2, total)], 3) == whole.widened([(total // 2, total)], 3)
    if len(tiles) > 2:
        # Without the second, the others are maps of their own.
        gap = PlaceIndex([tiles[0], *tiles[2:]])
        assert gap.whole(0) == (0, borders[1])
        assert gap.segment_of(borders[1]) > gap.segment_of(borders[1] - 1)


def test_a_drive_over_several_tiles_moved_as_its_vehicle_only_if_it_did_in_each() -> None:
    for each in ((True, True), (True, False), (False, True)):
        tiles = [header([10], TileOf("0" * 64, 10 * number, bool(number), None)) for number in range(2)]
        segments = [replace(tile.segments[0], moved_as_driven=moved) for tile, moved in zip(tiles, each, strict=True)]
        index = PlaceIndex([replace(tile, segments=(one,)) for tile, one in zip(tiles, segments, strict=True)])
        assert index.segments == [(0, 20)]
        assert index.moved_as_driven(0) == all(each)
