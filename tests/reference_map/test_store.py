"""A map on the disk: what is written is read again, and nothing damaged is ever opened."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from edge.config import SamplingConfig
from edge.descriptor.normalize import normalize
from edge.errors import MapError
from edge.geodesy import POSITION_SOURCES
from edge.reference_map import MapSet, Route, open_map, open_map_set
from edge.reference_map.checksums import FileKey, check_files, pieces_checked, sha256_of
from edge.reference_map.costs import encode
from edge.reference_map.place_records import ASSUMED_SIGMA_M, PLACE, PLACE_OF_FORMAT_3
from edge.reference_map.store import (
    DESCRIPTORS,
    HEADER,
    PLACES,
    ModelKey,
    RegionsKey,
    encode_header,
    open_unverified,
    read_header,
)
from edge_plugins.mapping.builder import MapBuilder, Place
from sim.maps.command import add_map
from sim.maps.shrinking import shrink_to
from tests.files_written import full_disk

MODEL = ModelKey("test", "0" * 64, "fc6", 16)
REGIONS = RegionsKey("left-right", 0.4)


def raw_descriptors(count: int, seed: int = 0) -> np.ndarray:
    raw = np.maximum(np.random.default_rng(seed).normal(size=(count, 2, 16)), 0)
    return raw.astype(np.float16).astype(np.float32)  # as the map stores it


def build(path: Path, raw: np.ndarray, segments: int = 1, *, replace: bool = False) -> None:
    """A map of places 2 m apart going north, thumbnails "0", "11", "222"..."""
    with MapBuilder(path, MODEL, REGIONS, SamplingConfig(), replace=replace) as builder:
        for number, part in enumerate(np.array_split(raw, segments)):
            builder.begin_segment(f"drive {number}", "rear")
            for index, descriptor in enumerate(part):
                place = Place(
                    row=index,
                    lat_deg=-27.0 + index * 2 / 110_800,
                    lon_deg=153.0,
                    alt_m=10.0,
                    heading_deg=0.0,
                    route_m=index * 2.0,
                    thumbnail=str(index).encode() * (index + 1),
                )
                builder.add(descriptor, place)
        builder.finish()


@pytest.fixture
def small_map(tmp_path: Path) -> Path:
    build(tmp_path / "small.map", raw_descriptors(12), segments=2)
    return tmp_path / "small.map"


def test_round_trip(small_map: Path) -> None:
    opened = open_map(small_map, every_file=True)
    raw = raw_descriptors(12)
    np.testing.assert_array_equal(opened.raw(), raw)
    expected = encode(normalize(raw, raw.mean(axis=0, dtype=np.float64), raw.std(axis=0, dtype=np.float64)))
    np.testing.assert_array_equal(opened.descriptors, expected)
    assert [(segment.start, segment.end) for segment in opened.header.segments] == [(0, 6), (6, 12)]
    assert opened.thumbnail(8) == b"222"
    np.testing.assert_array_equal(opened.places["row"], [0, 1, 2, 3, 4, 5] * 2)
    assert not opened.descriptors.flags.writeable


def test_the_same_places_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        build(tmp_path / name, raw_descriptors(9))
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


def test_a_map_grows_without_its_images(tmp_path: Path) -> None:
    raw = raw_descriptors(20)
    build(tmp_path / "first", raw[:12])
    build(tmp_path / "whole", raw, segments=1)
    first = open_map(tmp_path / "first")
    with MapBuilder(tmp_path / "first", MODEL, REGIONS, SamplingConfig(), replace=True) as builder:
        add_map(builder, first)
        for index in range(12, 20):
            builder.add(raw[index], Place(row=index))
        builder.finish()
    grown = open_map(tmp_path / "first", every_file=True)
    np.testing.assert_array_equal(grown.descriptors, open_map(tmp_path / "whole").descriptors)
    assert grown.thumbnail(3) == b"3333"


def place(row: int, **known: Any) -> Place:
    """A place 2 m further north than the one before."""
    return Place(row, -27.0 + row * 2 / 110_800, 153.0, heading_deg=0.0, route_m=row * 2.0, **known)


def build_of(
    path: Path, places: list[Place], *, has_odometer: bool = False, whole_sigma_m: float | None = None
) -> MapBuilder:
    raw = raw_descriptors(len(places))
    with MapBuilder(path, MODEL, REGIONS, SamplingConfig(), replace=True) as builder:
        builder.begin_segment("drive", "rear", has_odometer=has_odometer, whole_sigma_m=whole_sigma_m)
        for descriptor, one in zip(raw, places, strict=True):
            builder.add(descriptor, one)
        builder.finish()
    return builder


def test_a_drive_is_known_to_have_moved_as_its_vehicle_only_if_an_odometer_says_so(tmp_path: Path) -> None:
    """And if its positions agree: here the last ones are 50 m aside. Elsewhere the header is as in earlier versions."""
    right = [place(row) for row in range(40)]
    wrong = [*right[:30], *(dataclasses.replace(one, lon_deg=153.0005) for one in right[30:])]
    for places, has_odometer, moved in ((right, True, True), (right, False, False), (wrong, True, False)):
        build_of(tmp_path / "map", places, has_odometer=has_odometer)
        again = MapBuilder(tmp_path / "again", MODEL, REGIONS, SamplingConfig(), replace=True)
        with again as builder:
            add_map(builder, open_map(tmp_path / "map"))
            builder.finish()
        for path in (tmp_path / "map", tmp_path / "again"):
            assert [one.moved_as_driven for one in read_header(path).segments] == [moved]
            assert ("moved_as_driven" in (path / "map.json").read_text()) == moved


def test_what_a_drive_is_off_by_as_a_whole_is_kept(tmp_path: Path) -> None:
    """Wide where it is not known, even if an odometer agrees; also in a map that is added to another."""
    right = [place(row) for row in range(40)]
    cases = ((2.5, False, (2.5, 0.0)), (0.0, False, (0.0, 0.0)), (None, True, (8.0, 4.5)), (None, False, (8.0, 4.5)))
    for known_m, has_odometer, counts_m in cases:
        build_of(tmp_path / "map", right, has_odometer=has_odometer, whole_sigma_m=known_m)
        with MapBuilder(tmp_path / "again", MODEL, REGIONS, SamplingConfig(), replace=True) as builder:
            add_map(builder, open_map(tmp_path / "map"))
            builder.finish()
        for path in (tmp_path / "map", tmp_path / "again"):
            assert [one.whole_sigma_m for one in read_header(path).segments] == [known_m]
            assert Route(MapSet.of(open_map(path))).drive(0).whole_sigma_m == counts_m


def test_the_accuracy_and_source_of_each_position_are_kept(tmp_path: Path) -> None:
    sources = POSITION_SOURCES[:7]
    given = [place(row, position_sigma_m=row + 0.5, position_source=source) for row, source in enumerate(sources)]
    build_of(tmp_path / "map", given)
    whole = open_map(tmp_path / "map", every_file=True)
    with MapBuilder(
        tmp_path / "again", MODEL, REGIONS, SamplingConfig(), shrink=shrink_to(4, MODEL.dimensions)
    ) as builder:
        add_map(builder, whole)
        builder.finish()
    for path in ("map", "again"):
        found = open_map(tmp_path / path).places
        np.testing.assert_array_equal(found["position_sigma_m"], np.arange(7) + 0.5)
        assert [POSITION_SOURCES[code] for code in found["position_source"]] == list(sources)


def test_positions_that_are_no_truth_for_other_drives_are_not_used(tmp_path: Path) -> None:
    refused = [
        place(1, position_sigma_m=2.0, position_source="place_fixes"),
        place(2, position_sigma_m=25.1, position_source="gps"),
        place(3, position_source="dead_reckoning"),
        Place(4, route_m=8.0, position_source="place_fixes"),
    ]
    used = [place(0), place(5, position_sigma_m=8.0, position_source="dead_reckoning")]
    builder = build_of(tmp_path / "map", [used[0], *refused, used[1]])
    assert sum(builder.unused.values()) == len(builder.unused) == 3
    places = open_map(tmp_path / "map").places
    np.testing.assert_array_equal(np.isnan(places["lat_deg"]), [False, True, True, True, True, False])
    np.testing.assert_array_equal(places["route_m"], np.arange(6) * 2.0)


def as_format_3(path: Path) -> None:
    """Write a map's places and header as Lookback did before positions had an accuracy."""
    places = np.fromfile(path / PLACES, dtype=PLACE)
    old = np.zeros(len(places), dtype=PLACE_OF_FORMAT_3)
    for name in PLACE_OF_FORMAT_3.names or ():
        old[name] = places[name]
    old.tofile(path / PLACES)
    header = read_header(path)
    files = header.files | {PLACES: FileKey(old.nbytes, sha256_of(path / PLACES))}
    (path / HEADER).write_bytes(encode_header(replace(header, version=3, files=files, header_sha256="")))


def test_a_map_of_format_3_is_read_with_the_assumed_accuracy(small_map: Path, tmp_path: Path) -> None:
    new = open_map(small_map)
    as_format_3(small_map)
    old = open_map(small_map, every_file=True)
    assert (old.header.version, new.header.version) == (3, 4)
    assert np.isnan(old.places["position_sigma_m"]).all()
    np.testing.assert_array_equal(old.places["lat_deg"], new.places["lat_deg"])
    position = Route(MapSet.of(old)).position(2, 3.0)
    assert position and position.sigma_m == ASSUMED_SIGMA_M
    assert MapSet.of(old).thumbnail(8) == b"222"
    with MapBuilder(tmp_path / "grown", MODEL, REGIONS, SamplingConfig()) as builder:
        add_map(builder, old)
        builder.finish()
    assert open_map(tmp_path / "grown").header.version == 4


def test_a_position_between_places_far_apart_is_less_accurate(tmp_path: Path) -> None:
    rows = (0, 1, 2, 22, 23, 24)
    build_of(tmp_path / "map", [place(row, position_sigma_m=1.0, position_source="gps") for row in rows])
    route = Route(MapSet.of(open_map(tmp_path / "map")))
    positions = [route.position(2, offset_m) for offset_m in (-1.0, 0.0, 2.0, 20.0, 41.0)]
    assert [round(one.sigma_m, 1) for one in positions if one] == [1.0, 1.0, 1.0, 18.0, 1.0]


def test_a_large_file_is_checked_in_pieces_after_opening(small_map: Path) -> None:
    size = open_unverified(small_map).descriptors.size
    files = read_header(small_map).files
    pieces = list(pieces_checked(small_map, files, [DESCRIPTORS], 100))
    assert (sum(pieces), max(pieces), len(pieces)) == (size, 100, -(-size // 100))
    good = (small_map / DESCRIPTORS).read_bytes()
    (small_map / DESCRIPTORS).write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    open_unverified(small_map)  # nothing is noticed yet
    with pytest.raises(MapError, match=f"{DESCRIPTORS}: damaged"):
        check_files(small_map, files, [DESCRIPTORS])
    (small_map / DESCRIPTORS).unlink()
    with pytest.raises(MapError, match=rf"{DESCRIPTORS}: cannot read it"):
        check_files(small_map, files, [DESCRIPTORS])


def test_maps_in_use_are_checked_first_and_a_damaged_one_is_named(small_map: Path, tmp_path: Path) -> None:
    for name in "abc":
        shutil.copytree(small_map, tmp_path / "maps" / name)
    (tmp_path / "maps" / "c" / DESCRIPTORS).write_bytes(bytes((small_map / DESCRIPTORS).stat().st_size))
    maps = open_map_set(tmp_path / "maps")
    a, b, c = [one.path for one in maps.maps]
    schedule = maps.checksum_schedule()
    assert not schedule.is_verified([b])
    while not schedule.is_verified([b]):
        assert schedule.step(100, [b]) == {}
    assert not schedule.is_verified([a, b])
    damages = [damage for damage in (schedule.step(1 << 20) for _ in range(10)) if damage]
    assert [list(damage) for damage in damages] == [[c]]
    assert schedule.is_verified([a, b])
    assert not schedule.is_verified([c])
    left = maps.without(damages[0])
    assert (left.names, [one.name for one in left.excluded]) == (("a", "b"), ["c"])
    assert len(left.places) == left.index.places == 2 * len(maps.maps[0].places)
    with pytest.raises(MapError, match="none of its 3 maps is usable"):
        left.without({a: "gone", b: "gone"})
    with pytest.raises(MapError, match=r"^gone$"):
        open_map_set(a).without({a: "gone"})


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("lat_deg", 91.0, "place 1 has lat_deg 91"),
        ("lon_deg", np.inf, "place 1 has lon_deg inf"),
        ("alt_m", np.inf, "place 1 has alt_m inf"),
        ("heading_deg", -np.inf, "place 1 has heading_deg -inf"),
        ("route_m", 1e300, "place 1 has route_m 1e"),
        ("route_m", 1e8, r"place 1 has route_m 1e\+08"),
        ("lat_deg", np.nan, "place 1 has half a position"),
        ("position_sigma_m", 0.0, "place 1 has position_sigma_m 0"),
        ("position_sigma_m", np.inf, "place 1 has position_sigma_m inf"),
        ("position_source", 11, "place 1 has position_source 11"),
        ("position_source", -1, "place 1 has position_source -1"),
    ],
)
def test_a_place_that_cannot_be_is_refused_at_opening(small_map: Path, field: str, value: float, told: str) -> None:
    places = np.fromfile(small_map / PLACES, dtype=PLACE)
    places["lat_deg"], places["lon_deg"] = 1.0, 2.0
    places[field][1] = value
    places.tofile(small_map / PLACES)
    with pytest.raises(MapError, match=told):
        open_unverified(small_map)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"version": 2}, "version 2; this program reads 3 to 5; build the map again"),
        ({"format": "other"}, "format"),
        ({"places": 10**12}, "descriptors.i8 should have"),
        ({"places": -1}, "should have"),
        ({"dimensions": 0}, "dimensions"),
        ({"dimensions": 17}, "dimensions"),
        ({"dimensions": 8}, "not the list of files of a map"),
        ({"segments": [{"start": 0, "end": 5, "view": "rear", "source": ""}]}, "segments"),
        ({"surprise": 1}, "surprise"),
        ({"places": "many"}, "places"),
    ],
)
def test_a_header_that_claims_nonsense_is_refused_before_anything_is_read(
    small_map: Path, change: dict[str, object], told: str
) -> None:
    import hashlib

    claims = json.loads((small_map / "map.json").read_bytes()) | change | {"header_sha256": ""}
    digest = hashlib.sha256(msgspec.json.encode(claims)).hexdigest()
    (small_map / "map.json").write_bytes(
        msgspec.json.format(msgspec.json.encode(claims | {"header_sha256": digest}), indent=1)
    )
    with pytest.raises(MapError, match=told):
        open_map(small_map)


def test_replacing_needs_the_word_and_a_map(small_map: Path, tmp_path: Path) -> None:
    with pytest.raises(MapError, match="already exists"):
        build(small_map, raw_descriptors(5))
    build(small_map, raw_descriptors(5), replace=True)
    assert open_map(small_map).header.places == 5
    (tmp_path / "letters").mkdir()
    with pytest.raises(MapError, match="not a map"):
        build(tmp_path / "letters", raw_descriptors(5), replace=True)


def test_a_build_that_fails_leaves_the_old_map_and_nothing_else(small_map: Path) -> None:
    with pytest.raises(RuntimeError), MapBuilder(small_map, MODEL, REGIONS, SamplingConfig(), replace=True) as builder:
        builder.begin_segment("x", "rear")
        builder.add(raw_descriptors(1)[0], Place(row=0))
        raise RuntimeError
    with pytest.raises(MapError, match="at least 2 places"):
        build(small_map, raw_descriptors(1), replace=True)
    assert open_map(small_map, every_file=True).header.places == 12
    assert [path.name for path in small_map.parent.iterdir()] == ["small.map"]


def test_positions_between_and_beyond_places(small_map: Path) -> None:
    route = Route(MapSet.of(open_map(small_map)))
    at_rest, ahead, beyond = route.position(2, 0.0), route.position(2, 3.0), route.position(2, 500.0)
    assert at_rest and ahead and beyond
    assert (ahead.lat_deg - at_rest.lat_deg) * 110_800 == pytest.approx(3.0, abs=0.01)
    assert (beyond.lat_deg - at_rest.lat_deg) * 110_800 == pytest.approx(6.0, abs=0.01)  # its drive ends at 10 m
    meters = MapSet.of(open_map(small_map)).east_north_m([(0, 12)])
    assert np.hypot(*(meters[5] - meters[0])) == pytest.approx(10.0, abs=0.05)


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    with full_disk(20_000), pytest.raises(MapError, match=r"big\.map: cannot write the map: File too large"):
        build(tmp_path / "big.map", raw_descriptors(2000))
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_builder_has_left_is_cleared_and_what_is_being_built_is_not(tmp_path: Path) -> None:
    (tmp_path / ".small.map.x.building").mkdir()
    (tmp_path / ".small.map.x.building/raw.f16").write_bytes(b"half")
    with MapBuilder(tmp_path / "small.map", MODEL, REGIONS, SamplingConfig()):
        with MapBuilder(tmp_path / "small.map", MODEL, REGIONS, SamplingConfig()):
            assert len([path for path in tmp_path.iterdir() if path.name.endswith(".building")]) == 2
        build(tmp_path / "small.map", raw_descriptors(4))
    assert [path.name for path in tmp_path.iterdir()] == ["small.map"]
