"""A folder of maps is searched as one, opened where it is searched, and does without those that cannot be used."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from edge.config import AcceptanceConfig, Config, MapConfig, SamplingConfig, SequenceConfig
from edge.descriptor import NormalizedRows
from edge.descriptor.normalize import normalize
from edge.errors import MapError
from edge.reference_map.builder import MapBuilder, Place
from edge.reference_map.map_set import SPARE, MapSet, open_map_set
from edge.reference_map.route import Route
from edge.reference_map.store import DESCRIPTORS, PLACES, ModelKey, RegionsKey, open_map
from edge.reference_map.tiles import split_map
from edge.sequence import PlaceMatch
from edge.sequence.place_search import MOST_MAPS, OPENED_A_FRAME, Near, PlaceSearch

PLACES_OF_ALL, LENGTH, LIMIT, SPACING_M, APART_M = 6000, 10, 800, 2.0, 1000.0
DEGREES_A_METRE = 1 / 110_800
KEY = ModelKey("test", "0" * 64, "fc6", 48)
CONFIG = Config(
    map=MapConfig(places_per_frame=LIMIT),
    sequence=SequenceConfig(length=LENGTH),
    acceptance=AcceptanceConfig(uniqueness_min=2.0, window_m=40.0, window_places=20),
)
Look = Callable[[int], np.ndarray]


def build(
    path: Path, seed: int, places: int, *, known: bool = True, lat_deg: float = 0.0, lon_deg: float = 0.0
) -> None:
    """Drives of 2500 places going north, side by side, each neighbour a little alike."""
    rng = np.random.default_rng(seed)
    raw = rng.normal(size=(places + 2, 2, 48))
    raw = np.maximum(raw[:-2] + raw[1:-1] + raw[2:], 0).astype(np.float32)
    with MapBuilder(path, KEY, RegionsKey("left-right", 0.4, "set"), SamplingConfig()) as builder:
        for index in range(places):
            drive, along = divmod(index, 2500)
            if along == 0:
                builder.begin_segment(f"drive {drive}", "front")
            position = (
                {
                    "lat_deg": lat_deg + along * SPACING_M * DEGREES_A_METRE,
                    "lon_deg": lon_deg + drive * APART_M * DEGREES_A_METRE,
                    "heading_deg": 0.0,
                }
                if known
                else {}
            )
            thumbnail = str(index).encode()
            builder.add(raw[index], Place(row=index, route_m=along * SPACING_M, thumbnail=thumbnail, **position))
        builder.finish(normalize, "test")


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
def look(city: Path) -> Look:
    return look_at(city / "whole.map")


def look_at(path: Path) -> Look:
    """What a normalised query shows at a place of a map: the place on another day."""
    rng = np.random.default_rng(5)
    half_sum, half_difference = open_map(path).descriptors.astype(np.float32)
    rows = np.stack([half_sum + half_difference, half_sum - half_difference], axis=1)
    noise = rng.normal(size=rows.shape).astype(np.float32) * rows.std() * 0.7
    return lambda place: rows[place] + noise[place]


class Drive:
    """Feeds a search with one place after another, as the recogniser does."""

    def __init__(self, atlas: MapSet, look: Look, config: Config = CONFIG) -> None:
        self.atlas = atlas
        self.search = PlaceSearch(atlas, config)
        self._look = look
        self._ring: list[np.ndarray] = []
        self.most_open = 0

    def see(self, place: int, near: Near | None = None) -> PlaceMatch | None:
        self._ring = [*self._ring, self._look(place)][-LENGTH:]
        change = NormalizedRows(self._ring[-1][np.newaxis], replaces_ring=False)
        match = self.search.push(change, lambda: np.stack(self._ring), near)
        self.most_open = max(self.most_open, self.atlas.open_count)
        return match

    def go(self, places: range, near: Callable[[int], Near | None] = lambda place: None) -> list[PlaceMatch | None]:
        return [self.see(place, near(place)) for place in places]


def close_to(place: int, radius_m: float = 60.0, east_m: float = 0.0) -> Near:
    drive, along = divmod(place, 2500)
    return Near(along * SPACING_M * DEGREES_A_METRE, (drive * APART_M + east_m) * DEGREES_A_METRE, radius_m)


def test_tiles_have_every_byte_of_their_map(city: Path) -> None:
    whole, atlas = open_map(city / "whole.map"), open_map_set(city / "tiles")
    tiles = [open_map(folder, every_file=True) for folder in atlas.folders]
    assert atlas.numbering.places == PLACES_OF_ALL
    assert max(len(tile.places) for tile in tiles) <= 300 + 63
    assert min(len(tile.places) for tile in tiles) >= 300 - 64
    assert atlas.numbering.starts[:-1] == [tile.header.tile.start for tile in tiles if tile.header.tile]
    np.testing.assert_array_equal(np.concatenate([tile.descriptors for tile in tiles], axis=1), whole.descriptors)
    np.testing.assert_array_equal(np.concatenate([tile.raw() for tile in tiles]), whole.raw())
    for field in set(whole.places.dtype.names or ()) - {"thumbnail_at"}:
        np.testing.assert_array_equal(np.concatenate([tile.places[field] for tile in tiles]), whole.places[field])
    assert [atlas.thumbnail(place) for place in (0, 299, 300, 5999)] == [b"0", b"299", b"300", b"5999"]
    assert [atlas.numbering.segment(number) for number in range(3)] == [(0, 2500), (2500, 5000), (5000, 6000)]
    atlas.opened([(0, PLACES_OF_ALL)])
    somewhere = [(1500, 1900)]
    metres = MapSet.of(whole).east_north_m(somewhere)
    np.testing.assert_array_equal(atlas.east_north_m(somewhere), metres)
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
    city: Path, look: Look, start: int, frames: int, backwards: bool, tells: str, radius_m: float, limit: int
) -> None:
    """To the bit, but for the frames that go by until the tiles around a position are open."""
    config = Config(map=MapConfig(places_per_frame=limit), sequence=CONFIG.sequence, acceptance=CONFIG.acceptance)
    places = range(start, start + frames)
    if backwards:
        places = places[::-1]
    off_m = 3000.0 if tells == "wrong" else 0.0

    def near(place: int) -> Near | None:
        return None if tells == "nothing" else close_to(place, radius_m, off_m)

    atlas = open_map_set(city / "tiles")
    # All bounds known and all tiles open, so that not even that differs.
    atlas.opened([(0, PLACES_OF_ALL)])
    whole = Drive(MapSet.of(open_map(city / "whole.map")), look, config)
    tiles = Drive(atlas, look, config)
    atlas.opened([(0, PLACES_OF_ALL)])
    for place in places:
        found, expected = tiles.see(place, near(place)), whole.see(place, near(place))
        assert found == expected
        atlas.opened([(0, PLACES_OF_ALL)])
    atlas.close()


@settings(max_examples=100, deadline=None)
@given(place=st.integers(0, PLACES_OF_ALL - 1), offset_m=st.floats(-600, 600))
def test_a_position_along_a_drive_crosses_borders(city: Path, place: int, offset_m: float) -> None:
    whole, tiles = Route(MapSet.of(open_map(city / "whole.map"))), Route(open_map_set(city / "tiles"))
    assert tiles.position(place, offset_m) == whole.position(place, offset_m)
    along_m = whole.route_m(place) + offset_m
    assert tiles.reaches(place, along_m) == whole.reaches(place, along_m)
    drive, of_whole = tiles.drive(place), whole.drive(place)
    assert drive is not None
    assert of_whole is not None
    assert (drive.segment, drive.spacing_m) == (of_whole.segment, of_whole.spacing_m)


def test_a_drive_across_borders_has_no_hole(city: Path, known: bool, look: Look) -> None:
    """With a position, and without once the place is found: tiles are opened ahead, and closed behind."""
    drive = Drive(open_map_set(city / "tiles"), look)
    passed = range(200, 2300)
    matches = drive.go(passed, close_to if known else lambda place: None)
    first = next(at for at, match in enumerate(matches) if match and match.accepted)
    assert first < (2 * LENGTH if known else LENGTH + PLACES_OF_ALL // (LIMIT // 8))
    for place, match in zip(passed[first:], matches[first:], strict=True):
        assert match is not None, place
        assert match.accepted, place
        assert abs(match.place - place) <= 1 or place - passed[0] < 2 * first
    # A part of 800 places, two that are opened for the next one, and the spare ones.
    assert drive.most_open <= LIMIT // 236 + 2 + OPENED_A_FRAME + SPARE


def test_only_headers_are_read_at_the_start(city: Path, known: bool, look: Look, tmp_path: Path) -> None:
    """All other files are missing, but for those of the tiles where the vehicle is."""
    shutil.copytree(city / "tiles", tmp_path / "tiles")
    told: list[str] = []
    atlas = open_map_set(tmp_path / "tiles", lambda name, why: told.append(name))
    driven = range(1200, 1240)
    places = open_map(city / "whole.map").places
    for index, folder in enumerate(atlas.folders):
        tile = places[atlas.numbering.starts[index] : atlas.numbering.starts[index + 1]]
        south_m, north_m = tile["lat_deg"].min() / DEGREES_A_METRE, tile["lat_deg"].max() / DEGREES_A_METRE
        # A part reaches 330 m, and a sequence 40 m beyond.
        near = tile["lon_deg"].min() == 0 and south_m < 2 * driven[-1] + 380 and north_m > 2 * driven[0] - 380
        if not near:
            for file in folder.iterdir():
                if file.name != "map.json":
                    file.unlink()
    drive = Drive(atlas, look)
    assert atlas.open_count == 0
    if not known:
        return
    matches = drive.go(driven, lambda place: close_to(place, 20.0))
    assert matches[-1] is not None
    assert matches[-1].accepted
    assert told == []


def test_a_scan_opens_few_at_a_time(city: Path, look: Look) -> None:
    drive = Drive(open_map_set(city / "tiles"), look)
    first = drive.go(range(4100, 4100 + LENGTH + PLACES_OF_ALL // (LIMIT // 8)))
    assert any(match and match.accepted for match in first)
    assert drive.most_open <= SPARE + 2


def test_no_frame_opens_many(city: Path, known: bool, look: Look, tmp_path: Path) -> None:
    """A wide position is worth many tiles, and they come a few at a time; until then nothing is searched there."""
    if not known:
        pytest.skip("needs positions")
    config = msgspec.structs.replace(CONFIG, map=MapConfig(places_per_frame=2400))
    split_map(open_map(city / "whole.map"), tmp_path / "small", 64)
    atlas = open_map_set(tmp_path / "small")
    drive = Drive(atlas, look, config)
    opened = []
    for place in range(1250, 1250 + LENGTH + 30):
        match = drive.see(place, close_to(place, 900.0))
        opened.append(atlas.open_count)
        assert match is None or (drive.search.part is not None and len(drive.search.part.places) > 1000)
    # Some to see where their places are, which may be closed again until all are open for the part.
    assert max(np.diff([0, *opened])) <= 2 * OPENED_A_FRAME
    assert max(opened) > 2 * SPARE
    assert match is not None
    assert match.accepted
    huge = Drive(open_map_set(city / "tiles"), look, config)
    huge.see(1250, close_to(1250, 90_000.0))
    assert huge.atlas.open_count == 0  # too many for a frame, as the headers say


@pytest.mark.parametrize("file", [PLACES, DESCRIPTORS, "map.json"])
def test_a_damaged_tile_is_left_out_with_one_line(
    city: Path, known: bool, look: Look, tmp_path: Path, file: str
) -> None:
    """The damage is told once, nothing is told of that tile, and the others work."""
    if not known:
        pytest.skip("needs positions")
    shutil.copytree(city / "tiles", tmp_path / "tiles")
    damaged = sorted((tmp_path / "tiles").iterdir())[3]
    data = bytearray((damaged / file).read_bytes())
    data[len(data) // 2] ^= 1
    (damaged / file).write_bytes(data)
    told: list[tuple[str, str]] = []
    atlas = open_map_set(tmp_path / "tiles", lambda name, why: told.append((name, why)))
    first, last = open_map_set(city / "tiles").numbering.starts[3:5]
    missing = last - first if file == "map.json" else 0  # a tile without a header is not counted
    drive = Drive(atlas, look)
    believed = []
    for place in range(700, 1700):
        match = drive.see(place, close_to(place))
        before = len(atlas.left_out)
        while not atlas.verify(1 << 20):
            pass
        if match and match.accepted and len(atlas.left_out) == before:
            believed.append((place, match.place))
    assert len(told) == 1
    assert told[0][0] == damaged.name
    assert f"{damaged / file}" in told[0][1]
    assert not [place for place, _ in believed if first + LENGTH <= place < last]
    assert {place for place, _ in believed} >= {*range(700 + LENGTH, first), *range(last + 3 * LENGTH, 1700)}
    # Where the tile begins and ends, a sequence is partly on it, and its end looks like what is left.
    clear = [(place, match) for place, match in believed if not first <= place < last + 3 * LENGTH]
    assert all(match - place == (-missing if place >= last else 0) for place, match in clear)


def test_a_map_that_was_replaced_meanwhile_is_left_out(city: Path, look: Look, tmp_path: Path) -> None:
    """What model, cut and signature were asked of at the start is what is opened."""
    shutil.copytree(city / "tiles", tmp_path / "tiles")
    told: list[str] = []
    atlas = open_map_set(tmp_path / "tiles", lambda name, why: told.append(why))
    shutil.rmtree(tmp_path / "tiles" / "04")
    (tmp_path / "tiles" / "05").rename(tmp_path / "tiles" / "04")
    start, _, end, _ = atlas.numbering.starts[3:7]
    assert atlas.opened([(start, end + 10)]) == [(start, atlas.numbering.starts[4])]
    assert [why.partition(": ")[2] for why in told] == [
        "another map than at the start; start again to use it",
        f"no such map; make one with `lookback map build FEED -o {tmp_path / 'tiles' / '05'}`",
    ]


def test_a_name_that_is_no_text_is_told_all_the_same(city: Path, tmp_path: Path) -> None:
    name = os.fsdecode(b"\xff1")
    for folder in (name, "2"):
        shutil.copytree(city / "tiles" / "03", tmp_path / "maps" / folder)
    told: list[tuple[str, str]] = []
    atlas = open_map_set(tmp_path / "maps", lambda *what: told.append(what))
    assert {atlas.locate(place)[0] for place in (0, 300)} == {"2", "?1"}
    (tmp_path / "maps" / name / PLACES).unlink()
    atlas.opened([(0, atlas.numbering.places)])
    assert told[0][0] == "?1"
    assert msgspec.json.encode(told)


def test_very_many_tiny_maps_do_not_use_up_the_open_files(city: Path, known: bool, look: Look, tmp_path: Path) -> None:
    """All of them would fit into a frame, but each open map is an open file."""
    split_map(open_map(city / "whole.map"), tmp_path / "small", 64)
    tile = tmp_path / "small" / "00"
    for number in range(MOST_MAPS + 1):
        shutil.copytree(tile, tmp_path / "many" / f"{number:03}")
    atlas = open_map_set(tmp_path / "many")
    drive = Drive(atlas, look, msgspec.structs.replace(CONFIG, map=MapConfig(places_per_frame=20_000)))
    drive.go(range(0, MOST_MAPS + 50), lambda place: close_to(0) if known else None)
    assert drive.most_open <= MOST_MAPS


def test_nothing_left_to_use_is_an_error(city: Path, look: Look, tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    for number in range(2):
        shutil.copytree(city / "tiles" / "03", tmp_path / "maps" / str(number))
        (tmp_path / "maps" / str(number) / PLACES).unlink()
    told: list[str] = []
    with pytest.raises(MapError, match="none of its 2 maps can be used"):
        PlaceSearch(open_map_set(tmp_path / "maps", lambda name, why: told.append(name)), CONFIG)
    assert told == ["0", "1"]
    for number in range(2):
        (tmp_path / "maps" / str(number) / "map.json").write_bytes(b"{}")
    with pytest.raises(MapError, match="none of its 2 maps can be used"):
        open_map_set(tmp_path / "maps", lambda name, why: None)


def test_maps_of_places_far_apart(tmp_path: Path) -> None:
    """Each is searched in its own metres; a position near one opens that one alone."""
    build(tmp_path / "maps" / "home", 1, 1500)
    build(tmp_path / "maps" / "there", 2, 1500, lat_deg=51.0, lon_deg=179.999)
    build(tmp_path / "maps" / "unknown", 3, 1500, known=False)
    atlas = open_map_set(tmp_path / "maps")
    assert [atlas.locate(place) for place in (0, 1499, 1500, 4499)] == [
        ("home", 0),
        ("home", 1499),
        ("there", 0),
        ("unknown", 1499),
    ]
    there = look_at(tmp_path / "maps" / "there")
    drive = Drive(atlas, lambda place: there(place - 1500))

    def near(place: int) -> Near:
        # The same meridian, told from the other side.
        return Near(51.0 + (place - 1500) * SPACING_M * DEGREES_A_METRE, 179.999 - 360, 60.0)

    matches = drive.go(range(1600, 1700), near)
    assert drive.most_open == 1
    assert [match.place for match in matches if match and match.accepted] == list(range(1600 + LENGTH - 1, 1700))
    assert drive.search.part is not None
    metres = atlas.east_north_m(drive.search.part.ranges)
    steps_m = np.hypot(*np.diff(metres, axis=0).T)
    np.testing.assert_allclose(steps_m, SPACING_M, rtol=0.01)
    # On a map without positions only a scan finds the vehicle, and then it is followed there, whatever is told.
    unknown = look_at(tmp_path / "maps" / "unknown")
    lost = Drive(open_map_set(tmp_path / "maps"), lambda place: unknown(place - 3000))
    answers = lost.go(range(3200, 3400), lambda place: close_to(0))
    believed = [
        (match.place, place)
        for match, place in zip(answers, range(3200, 3400), strict=True)
        if match and match.accepted
    ]
    assert len(believed) > 60
    assert all(abs(match - place) <= 1 for match, place in believed[-50:])
