"""A folder of maps is searched as one, and does without those that cannot be used."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from edge.config import AcceptanceConfig, Config, MapConfig, SequenceConfig
from edge.errors import MapError
from edge.reference_map import MapSet, Route, open_map, open_map_set
from edge.reference_map.store import DESCRIPTORS, PLACES, STATISTICS
from edge.sequence import PlaceMatch, SearchRegion
from edge.sequence.lane import NO_LAGS, Lanes
from edge.sequence.submap import SLICE_SHARE, GlobalSearch
from edge_plugins.mapping.builder import Place
from sim.maps.tiles import split_map
from tests.map_of import map_of
from tests.sequence.test_place_search import Seeker, views_of

PLACES_OF_ALL, LENGTH, LIMIT, SPACING_M, APART_M = 6000, 10, 800, 2.0, 1000.0
DEGREES_A_METRE = 1 / 110_800
CONFIG = Config(
    map=MapConfig(places_per_frame=LIMIT),
    sequence=SequenceConfig(length=LENGTH),
    acceptance=AcceptanceConfig(uniqueness_min=2.0, window_m=40.0, window_places=20),
)
View = Callable[[int], np.ndarray]


def build(
    path: Path, seed: int, places: int, *, known: bool = True, lat_deg: float = 0.0, lon_deg: float = 0.0
) -> None:
    """Drives of 2500 places going north, side by side, each neighbor a little alike."""
    rng = np.random.default_rng(seed)
    raw = rng.normal(size=(places + 2, 2, 48))
    raw = np.maximum(raw[:-2] + raw[1:-1] + raw[2:], 0).astype(np.float32)
    of_map = []
    for row in range(places):
        drive, along = divmod(row, 2500)
        place = Place(row, route_m=along * SPACING_M, thumbnail=str(row).encode())
        if known:
            north_deg, east_deg = along * SPACING_M * DEGREES_A_METRE, drive * APART_M * DEGREES_A_METRE
            place = replace(place, lat_deg=lat_deg + north_deg, lon_deg=lon_deg + east_deg, heading_deg=0.0)
        of_map.append(place)
    map_of(path, raw, of_map, starts=range(0, places, 2500))


@pytest.fixture(scope="module", params=[True, False], ids=["positions", "no positions"])
def known(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


@pytest.fixture(scope="module")
def city(known: bool, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of 6000 places, and tiles of it of 300."""
    folder = tmp_path_factory.mktemp("city")
    build(folder / "whole.map", 3, PLACES_OF_ALL, known=known)
    split_map(open_map(folder / "whole.map"), folder / "tiles", 300)
    return folder


@pytest.fixture(scope="module")
def view(city: Path) -> View:
    return views_of(open_map(city / "whole.map"))


def is_unique(match: PlaceMatch) -> bool:
    """Stands for the place belief, which needs more frames than these drives have."""
    return match.uniqueness >= CONFIG.acceptance.uniqueness_min


def drive_on(maps: MapSet, view: View, config: Config = CONFIG) -> Seeker:
    return Seeker(maps, view, config)


def close_to(place: int, radius_m: float = 60.0, east_m: float = 0.0) -> SearchRegion:
    drive, along = divmod(place, 2500)
    return SearchRegion(along * SPACING_M * DEGREES_A_METRE, (drive * APART_M + east_m) * DEGREES_A_METRE, radius_m)


def test_tiles_have_every_byte_of_their_map(city: Path) -> None:
    whole, maps = open_map(city / "whole.map"), open_map_set(city / "tiles", every_file=True)
    tiles = maps.maps
    assert not maps.excluded
    assert maps.index.places == PLACES_OF_ALL
    assert max(len(tile.places) for tile in tiles) <= 300 + 63
    assert min(len(tile.places) for tile in tiles) >= 300 - 64
    assert maps.index.starts[:-1] == [tile.header.tile.start for tile in tiles if tile.header.tile]
    np.testing.assert_array_equal(np.concatenate([tile.descriptors for tile in tiles], axis=1), whole.descriptors)
    np.testing.assert_array_equal(np.concatenate([tile.raw() for tile in tiles]), whole.raw())
    assert [maps.thumbnail(place) for place in (0, 299, 300, 5999)] == [b"0", b"299", b"300", b"5999"]
    assert [maps.index.segment(number) for number in range(3)] == [(0, 2500), (2500, 5000), (5000, 6000)]
    for field in set(whole.places.dtype.names or ()) - {"thumbnail_at"}:
        np.testing.assert_array_equal(maps.places[field], whole.places[field])
    somewhere = [(1500, 1900)]
    meters = MapSet.of(whole).east_north_m(somewhere)
    np.testing.assert_array_equal(maps.east_north_m(somewhere), meters)
    for tile in tiles:
        assert (tile.path / "statistics.f64").read_bytes() == (city / "whole.map/statistics.f64").read_bytes()
        bounds = tile.header.bounds
        if bounds is not None:
            assert bounds.south == tile.places["lat_deg"].min()
            assert bounds.east == tile.places["lon_deg"].max()


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    start=st.integers(0, PLACES_OF_ALL - 200),
    frames=st.integers(LENGTH, 150),
    backwards=st.booleans(),
    tells=st.sampled_from(["position", "nothing", "wrong"]),
    radius_m=st.floats(20, 400),
    limit=st.sampled_from([300, LIMIT, PLACES_OF_ALL]),
)
def test_tiles_give_the_same_matches_as_their_map(
    city: Path, view: View, start: int, frames: int, backwards: bool, tells: str, radius_m: float, limit: int
) -> None:
    """To the bit."""
    config = Config(map=MapConfig(places_per_frame=limit), sequence=CONFIG.sequence, acceptance=CONFIG.acceptance)
    places = range(start, start + frames)
    if backwards:
        places = places[::-1]
    off_m = 3000.0 if tells == "wrong" else 0.0

    def near(place: int) -> SearchRegion | None:
        return None if tells == "nothing" else close_to(place, radius_m, off_m)

    maps = open_map_set(city / "tiles")
    whole = drive_on(MapSet.of(open_map(city / "whole.map")), view, config)
    tiles = drive_on(maps, view, config)
    for place in places:
        found, expected = tiles.see(place, near(place)), whole.see(place, near(place))
        if found is not None:
            assert (found.map, found.place) == maps.locate(found.place_index)
            found = replace(found, map=None, place=found.place_index)
        assert found == expected


@settings(max_examples=100, deadline=None)
@given(place=st.integers(0, PLACES_OF_ALL - 1), offset_m=st.floats(-600, 600))
def test_a_position_along_a_drive_crosses_borders(city: Path, place: int, offset_m: float) -> None:
    whole, tiles = Route(MapSet.of(open_map(city / "whole.map"))), Route(open_map_set(city / "tiles"))
    assert tiles.position(place, offset_m) == whole.position(place, offset_m)
    along_m = whole.route_m(place) + offset_m
    assert tiles.reaches(place, along_m) == whole.reaches(place, along_m)
    drive, of_whole = tiles.drive(place), whole.drive(place)
    assert (drive.segment, drive.spacing_m) == (of_whole.segment, of_whole.spacing_m)


def test_a_drive_across_borders_has_no_hole(city: Path, known: bool, view: View) -> None:
    """With a position, and without once the place is found."""
    drive = drive_on(open_map_set(city / "tiles"), view)
    passed = range(200, 2300)
    matches = drive.go(passed, close_to if known else lambda place: None)
    first = next(at for at, match in enumerate(matches) if match and is_unique(match))
    assert first < (2 * LENGTH if known else LENGTH + PLACES_OF_ALL // (LIMIT // 8))
    for place, match in zip(passed[first:], matches[first:], strict=True):
        assert match is not None, place
        assert is_unique(match), place
        assert abs(match.place_index - place) <= 1 or place - passed[0] < 2 * first


def test_a_name_that_is_no_text_can_be_written_all_the_same(city: Path, tmp_path: Path) -> None:
    name = os.fsdecode(b"\xff1")
    for folder in (name, "2"):
        shutil.copytree(city / "tiles" / "03", tmp_path / "maps" / folder)
    assert {open_map_set(tmp_path / "maps").locate(place)[0] for place in (0, 300)} == {"2", "?1"}
    (tmp_path / "maps" / name / PLACES).unlink()
    (excluded,) = open_map_set(tmp_path / "maps").excluded
    assert excluded.name == "?1"
    assert msgspec.json.encode([excluded.name, excluded.why])


def test_very_many_maps_raise_the_limit_of_open_files_or_say_that_it_is_too_low(city: Path, tmp_path: Path) -> None:
    split_map(open_map(city / "whole.map"), tmp_path / "small", 64)
    for number in range(200):
        shutil.copytree(tmp_path / "small" / "00", tmp_path / "many" / f"{number:03}")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
    try:
        maps = open_map_set(tmp_path / "many")
        assert len(maps.maps) == 200
        assert not maps.excluded
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    command = f"ulimit -n 300; exec {sys.executable} -m edge map info {tmp_path / 'many'}"
    info = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert info.returncode == 78
    assert "200 maps need 656 open files, and this process may have 300" in info.stderr
    assert len(info.stderr.splitlines()) == 1


def resident_bytes(folder: Path) -> int:
    """Of the descriptors below a folder, as mapped into this process."""
    lines = iter(Path("/proc/self/smaps").read_text(encoding="utf-8").splitlines())
    found = 0
    for line in lines:
        if line.endswith(DESCRIPTORS) and str(folder) in line:
            found += next(int(one.split()[1]) * 1024 for one in lines if one.startswith("Rss:"))
    return found


def test_a_pass_through_all_maps_keeps_no_descriptors_in_memory(city: Path, view: View) -> None:
    maps = open_map_set(city / "tiles")
    ring = np.stack([view(place) for place in range(LENGTH)])
    maps.costs(ring, [(0, PLACES_OF_ALL)])
    everything = resident_bytes(city / "tiles")
    assert everything > 10 * 300 * 2 * 48
    scan = GlobalSearch(CONFIG)
    for _ in range(PLACES_OF_ALL):
        if scan.step(maps, ring, LENGTH, Lanes(NO_LAGS, "front", range(LENGTH))) is not None:
            break
    assert resident_bytes(city / "tiles") < everything / 10


@pytest.mark.parametrize("end", [203, 220])
def test_a_pass_is_as_unique_at_the_edge_of_a_slice_as_one_search_of_all(city: Path, view: View, end: int) -> None:
    """The slice beside it finds the same place, or the last of its own that is like it: that is not elsewhere."""
    maps, found = open_map_set(city / "tiles"), []
    ring = np.stack([view(place) for place in range(end + 1 - LENGTH, end + 1)])
    for most in (LIMIT, SLICE_SHARE * PLACES_OF_ALL):
        scan = GlobalSearch(msgspec.structs.replace(CONFIG, map=MapConfig(places_per_frame=most)))
        steps = (scan.step(maps, ring, LENGTH, Lanes(NO_LAGS, "front", range(LENGTH))) for _ in range(PLACES_OF_ALL))
        found.append(next(match for match in steps if match is not None))
    assert found[0].place_index == found[1].place_index == end
    assert found[0].uniqueness == pytest.approx(found[1].uniqueness, rel=0.05)


def test_maps_of_places_far_apart(tmp_path: Path) -> None:
    """Each is searched in its own meters, and a position near one searches that one alone."""
    build(tmp_path / "maps" / "home", 1, 1500)
    build(tmp_path / "maps" / "there", 2, 1500, lat_deg=51.0, lon_deg=179.999)
    build(tmp_path / "maps" / "unknown", 3, 1500, known=False)
    maps = open_map_set(tmp_path / "maps")
    assert [maps.locate(place) for place in (0, 1499, 1500, 4499)] == [
        ("home", 0),
        ("home", 1499),
        ("there", 0),
        ("unknown", 1499),
    ]
    there = views_of(open_map(tmp_path / "maps" / "there"))
    drive = drive_on(maps, lambda place: there(place - 1500))

    def near(place: int) -> SearchRegion:
        # The same meridian, told from the other side.
        return SearchRegion(51.0 + (place - 1500) * SPACING_M * DEGREES_A_METRE, 179.999 - 360, 60.0)

    matches = drive.go(range(1600, 1700), near)
    assert drive.search.folders_in_use == [tmp_path / "maps" / "there"]
    assert [match.place_index for match in matches if match and is_unique(match)] == list(
        range(1600 + LENGTH - 1, 1700)
    )
    assert drive.search.part is not None
    meters = maps.east_north_m(drive.search.part.ranges)
    steps_m = np.hypot(*np.diff(meters, axis=0).T)
    np.testing.assert_allclose(steps_m, SPACING_M, rtol=0.01)
    # On a map without positions only a scan finds the vehicle, and then it is followed there, whatever is told.
    unknown = views_of(open_map(tmp_path / "maps" / "unknown"))
    lost = drive_on(open_map_set(tmp_path / "maps"), lambda place: unknown(place - 3000))
    answers = lost.go(range(3200, 3400), lambda place: close_to(0))
    believed = [
        (match.place_index, place)
        for match, place in zip(answers, range(3200, 3400), strict=True)
        if match and is_unique(match)
    ]
    assert len(believed) > 60
    assert all(abs(match - place) <= 1 for match, place in believed[-50:])


def test_the_statistics_of_a_damaged_map_are_not_used(city: Path, tmp_path: Path) -> None:
    whole = open_map_set(city / "tiles").statistics()
    for number in ("00", "01"):
        shutil.copytree(city / "tiles" / number, tmp_path / "tiles" / number)
    maps = open_map_set(tmp_path / "tiles")
    np.full(maps.maps[0].header.files[STATISTICS].bytes // 8, np.nan).tofile(tmp_path / "tiles" / "00" / STATISTICS)
    np.testing.assert_allclose(maps.statistics(), whole, rtol=1e-12)
    (tmp_path / "tiles" / "01" / STATISTICS).unlink()
    with pytest.raises(MapError, match=f"{STATISTICS}: cannot read it"):
        maps.statistics()
    with pytest.raises(MapError, match="not a number"):
        MapSet.of(maps.maps[0]).statistics()
