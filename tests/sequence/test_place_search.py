"""A map too large for one frame: around a position, slice by slice, and following what was found."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest

from edge.config import AcceptanceConfig, Config, MapConfig, SequenceConfig
from edge.descriptor import NormalizedRows
from edge.reference_map.map_set import MapSet
from edge.reference_map.store import ReferenceMap
from edge.sequence import MotionPrior, PlaceMatch, SearchRegion
from edge.sequence.place_search import PlaceSearch, is_regular
from edge.sequence.submap import SLICE_SHARE
from edge_plugins.mapping.builder import Place
from tests.map_of import map_of

PLACES, LENGTH, LIMIT = 6000, 10, 800
DEGREES_A_METRE = 1 / 110_800
CONFIG = Config(
    map=MapConfig(places_per_frame=LIMIT),
    sequence=SequenceConfig(length=LENGTH),
    acceptance=AcceptanceConfig(uniqueness_min=1.2, window_m=40.0, window_places=20),
)


@pytest.fixture(scope="module")
def long_map(tmp_path_factory: pytest.TempPathFactory) -> ReferenceMap:
    """12 km of places 2 m apart going north in two segments, each neighbor a little alike."""
    return build(tmp_path_factory.mktemp("maps") / "long.map", raw_descriptors(), has_positions=True)


def raw_descriptors() -> np.ndarray:
    raw = np.random.default_rng(3).normal(size=(PLACES + 2, 2, 48))
    return np.maximum(raw[:-2] + raw[1:-1] + raw[2:], 0).astype(np.float32)


def build(path: Path, raw: np.ndarray, *, has_positions: bool) -> ReferenceMap:
    north_deg, lon_deg = (2 * DEGREES_A_METRE, 0.0) if has_positions else (np.nan, np.nan)
    places = [Place(row, row * north_deg, lon_deg, route_m=row * 2.0) for row in range(PLACES)]
    return map_of(path, raw, places, starts=(0, 3000))


@pytest.fixture(scope="module")
def view(long_map: ReferenceMap) -> Callable[[int], np.ndarray]:
    return views_of(long_map)


def views_of(long_map: ReferenceMap) -> Callable[[int], np.ndarray]:
    """What a normalized query shows at a place: the place on another day."""
    rng = np.random.default_rng(5)
    half_sum, half_difference = long_map.descriptors.astype(np.float32)
    rows = np.stack([half_sum + half_difference, half_sum - half_difference], axis=1)
    noise = rng.normal(size=rows.shape).astype(np.float32) * rows.std() * 0.7
    return lambda place: rows[place] + noise[place]


def is_unique(match: PlaceMatch) -> bool:
    """Stands for the place belief, which needs more frames than these drives have."""
    return match.uniqueness >= CONFIG.acceptance.uniqueness_min


class Seeker:
    """Feeds a search with one place after another, as the recognizer does, and counts what each frame matched."""

    def __init__(
        self,
        maps: MapSet,
        view: Callable[[int], np.ndarray],
        config: Config = CONFIG,
        believed_after: int = 1,
    ) -> None:
        """believed_after: unique matches in a row, from which the place is believed."""
        self.search = PlaceSearch(maps, config)
        self._uniqueness_min = config.acceptance.uniqueness_min
        self._believed_after, self._unique = believed_after, 0
        self._view = view
        self._ring: list[np.ndarray] = []

    def see(self, place: int, near: SearchRegion | None = None) -> PlaceMatch | None:
        self._ring = [*self._ring, self._view(place)][-LENGTH:]
        change = NormalizedRows(self._ring[-1][np.newaxis])
        match = self.search.push(change, lambda: np.stack(self._ring), MotionPrior(search_region=near))
        self._unique = self._unique + 1 if match and match.uniqueness >= self._uniqueness_min else 0
        self.search.follow(match.place_index if match and self._unique >= self._believed_after else None)
        return match

    def go(
        self, places: range, near: Callable[[int], SearchRegion | None] = lambda place: None
    ) -> list[PlaceMatch | None]:
        return [self.see(place, near(place)) for place in places]


def close_to(place: int, off_m: float = 0.0, radius_m: float = 60.0) -> SearchRegion:
    return SearchRegion((place * 2 + off_m) * DEGREES_A_METRE, 0.0, radius_m)


def test_around_a_position_the_answers_are_those_of_the_whole_map(
    long_map: ReferenceMap, view: Callable[[int], np.ndarray]
) -> None:
    part = Seeker(MapSet.of(long_map), view)
    whole = Seeker(MapSet.of(long_map), view, msgspec.structs.replace(CONFIG, map=MapConfig(places_per_frame=PLACES)))
    drive = range(1400, 2000)  # longer than a part reaches, so that it moves several times
    parts_used: dict[int, object] = {}
    for place in drive:
        found, expected = part.see(place, close_to(place)), whole.see(place)
        assert (found is None) == (expected is None)
        if found and expected:
            assert (found.place, found.direction, found.order) == (expected.place, expected.direction, expected.order)
            assert (found.distance, found.slope) == pytest.approx((expected.distance, expected.slope))
            # With fewer places elsewhere, the best of them can only be worse.
            assert found.uniqueness >= expected.uniqueness
        assert part.search.part is not None
        assert len(part.search.part.places) <= LIMIT
        parts_used[id(part.search.part)] = part.search.part  # kept, so that no other gets its id
    assert len(parts_used) >= 3


@pytest.mark.parametrize("off_m", [-199.0, 199.0])
def test_a_place_is_searched_wherever_a_position_may_be_wrong(
    long_map: ReferenceMap, view: Callable[[int], np.ndarray], off_m: float
) -> None:
    drive = range(1400, 2000)
    matches = Seeker(MapSet.of(long_map), view).go(drive, lambda place: close_to(place, off_m, 200.0))
    found = zip(matches[LENGTH:], drive[LENGTH:], strict=True)
    assert all(match is not None and abs(match.place - place) <= 1 for match, place in found)


@pytest.mark.parametrize("has_positions", [True, False])
def test_without_a_position_the_map_is_gone_through_and_then_followed(
    long_map: ReferenceMap, view: Callable[[int], np.ndarray], has_positions: bool, tmp_path: Path
) -> None:
    """Also on a map that has none either."""
    maps = long_map if has_positions else build(tmp_path / "long.map", raw_descriptors(), has_positions=False)
    drive = Seeker(MapSet.of(maps), view)
    start = 4100
    slices = math.ceil(PLACES / (LIMIT // SLICE_SHARE))
    first = drive.go(range(start, start + LENGTH - 1 + slices))
    assert first[:-1] == [None] * (len(first) - 1)
    found = first[-1]
    assert found is not None
    assert is_unique(found)
    # Its slice was seen some frames ago.
    assert start + LENGTH - 1 <= found.place <= start + LENGTH - 1 + slices
    onward = drive.go(range(start + LENGTH - 1 + slices, start + 900))
    assert all(match is not None and is_unique(match) for match in onward)
    errors = [
        abs(match.place - place)
        for match, place in zip(onward, range(start + LENGTH - 1 + slices, start + 900), strict=True)
        if match
    ]
    assert max(errors) <= 1
    assert drive.search.part is not None
    assert len(drive.search.part.places) <= LIMIT


def test_of_two_stretches_that_look_alike_neither_is_found_wherever_the_slices_are(tmp_path: Path) -> None:
    raw = raw_descriptors()
    raw[4000:4300] = raw[1000:1300]
    twice = build(tmp_path / "twice.map", raw, has_positions=False)
    drive = Seeker(MapSet.of(twice), views_of(twice))
    assert set(drive.go(range(1050, 1050 + LENGTH + 2 * math.ceil(PLACES / (LIMIT // SLICE_SHARE))))) == {None}
    assert drive.search.part is None


@pytest.mark.parametrize("radius_m", [60.0, 5000.0])
def test_a_wrong_position_is_found_out(
    long_map: ReferenceMap, view: Callable[[int], np.ndarray], radius_m: float
) -> None:
    """What a scan has found goes on to be searched, beside the position or, if that may be anywhere, in its place."""
    drive = Seeker(MapSet.of(long_map), view)
    frames = 2 * LENGTH + LENGTH + 2 * math.ceil(PLACES / (LIMIT // SLICE_SHARE))
    drive.go(range(500, 500 + frames), lambda place: close_to(place, 6000.0, radius_m))
    places = range(500 + frames, 900)
    matches = drive.go(places, lambda place: close_to(place, 6000.0, radius_m))
    assert all(
        match is not None and is_unique(match) and abs(match.place - place) <= 3
        for place, match in zip(places, matches, strict=True)
    )


def test_what_was_found_is_followed_before_it_can_be_believed(
    long_map: ReferenceMap, view: Callable[[int], np.ndarray]
) -> None:
    """The map has been gone through in ten frames, and what a second time would find is as old as that."""
    config = msgspec.structs.replace(CONFIG, map=MapConfig(places_per_frame=PLACES * SLICE_SHARE // 10))
    drive = range(1000, 1050)
    matches = Seeker(MapSet.of(long_map), view, config, believed_after=15).go(drive)
    found = [(place, match) for place, match in zip(drive, matches, strict=True) if match is not None]
    assert len(found) == len(drive) - (LENGTH - 1) - 9
    assert all(abs(match.place - place) <= 1 for place, match in found[1:])


def test_lost_again_after_the_end_of_what_is_known(long_map: ReferenceMap, view: Callable[[int], np.ndarray]) -> None:
    drive = Seeker(MapSet.of(long_map), view)
    drive.go(range(2500, 2700))
    # A jump, as if the vehicle were carried: after a while the whole map is gone through again.
    after = drive.go(range(5000, 5100))
    last = after[-1]
    assert last is not None
    assert is_unique(last)
    assert abs(last.place - 5099) <= 1


@pytest.mark.parametrize("broken", [0.0, math.nan, math.inf])
def test_a_frame_that_says_nothing_is_as_good_as_none(
    long_map: ReferenceMap, view: Callable[[int], np.ndarray], broken: float
) -> None:
    def view_or_fail(place: int) -> np.ndarray:
        return np.full((2, 48), broken, dtype=np.float32) if place in (1020, 1021) else view(place)

    whole = msgspec.structs.replace(CONFIG, map=MapConfig(places_per_frame=PLACES))
    matches = Seeker(MapSet.of(long_map), view_or_fail, whole).go(range(1000, 1060))
    assert all(
        match is not None and is_unique(match) and abs(match.place - place) <= 1
        for match, place in zip(matches[LENGTH:], range(1000 + LENGTH, 1060), strict=True)
    )


def test_after_a_gap_nothing_is_known(long_map: ReferenceMap, view: Callable[[int], np.ndarray]) -> None:
    drive = Seeker(MapSet.of(long_map), view)
    drive.go(range(2500, 2600))
    assert drive.search.part is not None
    drive.search.clear()
    assert drive.search.part is None


def test_after_a_gap_a_place_that_is_believed_by_keyframes_is_searched_around(
    long_map: ReferenceMap, view: Callable[[int], np.ndarray]
) -> None:
    """Also where the last one was near it."""
    drive = Seeker(MapSet.of(long_map), view)
    drive.go(range(2500, 2600))
    drive.search.clear()
    drive.search.follow(2600)
    assert drive.search.part is not None
    assert 2600 in drive.search.part.places


def test_after_a_gap_the_position_is_searched_around_again(
    long_map: ReferenceMap, view: Callable[[int], np.ndarray]
) -> None:
    drive = Seeker(MapSet.of(long_map), view)
    drive.go(range(2500, 2530), close_to)
    drive.search.clear()
    drive._ring.clear()
    matches = drive.go(range(2540, 2540 + LENGTH), close_to)
    assert drive.search.part is not None
    assert matches[-1] is not None
    assert matches[-1].place == 2540 + LENGTH - 1


@pytest.mark.parametrize(
    ("route_m", "expected"),
    [
        (2.0 * np.arange(400), True),
        # Frames come when they come: single steps vary, and lines over forty of them are still straight.
        (2.0 * np.arange(400) + np.random.default_rng(1).uniform(-0.9, 0.9, 400), True),
        (np.cumsum(np.random.default_rng(2).uniform(1.0, 5.0, 400)), False),
    ],
)
def test_places_are_regular_by_their_stretches(route_m: np.ndarray, expected: bool, tmp_path: Path) -> None:
    assert is_regular(MapSet.of(random_map(tmp_path / "map", route_m)), 40) == expected


@pytest.mark.parametrize(("stretches_m", "slope"), [((2.0, 2.0), 0.905), ((1.4, 2.8), 0.82)])
def test_an_odometer_narrows_the_slopes_only_where_places_are_regular(
    stretches_m: tuple[float, float], slope: float, tmp_path: Path
) -> None:
    """Frames pass 0.82 places each; by the odometer and the usual distance between places it would be one."""
    one = random_map(tmp_path / "map", np.cumsum(np.repeat(np.tile(stretches_m, 2), 100)))
    half_sum, half_difference = one.descriptors.astype(np.float32)
    rows = np.stack([half_sum + half_difference, half_sum - half_difference], axis=1)
    search, ring, match = PlaceSearch(MapSet.of(one), Config()), list[np.ndarray](), None
    for frame in range(50):
        ring = [*ring, rows[100 + round(0.82 * frame)]][-40:]
        change = NormalizedRows(ring[-1][np.newaxis])
        match = search.push(change, partial(np.stack, ring), is_measured=True)
    assert match is not None
    assert match.slope == pytest.approx(slope, abs=0.02)


def random_map(path: Path, route_m: np.ndarray) -> ReferenceMap:
    """Places with nothing in common, at some meters along a road."""
    rng = np.random.default_rng(3)
    places = [Place(row, route_m=float(along_m)) for row, along_m in enumerate(route_m)]
    return map_of(path, rng.normal(size=(len(places), 2, 8)), places)
