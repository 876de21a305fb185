"""The route filter on drives along a small map whose every position is known: 2 m a place, due north."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from edge.config import Config, RigConfig, SamplingConfig, SequenceConfig, TrackingConfig
from edge.descriptor.normalize import normalize
from edge.geodesy import VehiclePosition
from edge.localization import Displacement, PlaceFix
from edge.localization.route_filter import RouteFilter
from edge.reference_map.builder import MapBuilder, Place
from edge.reference_map.map_set import MapSet
from edge.reference_map.route import Route
from edge.reference_map.store import ModelKey, RegionsKey, open_map
from edge.sequence import Parallax, PlaceMatch

S = 1_000_000_000
LENGTH, SPACING_M, FRAME_NS = 20, 2.0, S // 5
LAT_DEG, METRE_DEG = -27.0, 1 / 110_773  # of a meridian there


@pytest.fixture(scope="module")
def map_set(tmp_path_factory: pytest.TempPathFactory) -> MapSet:
    """Two drives of 200 places, the second 1 km further north."""
    path = tmp_path_factory.mktemp("tracking") / "map"
    raw = np.random.default_rng(1).random((200, 2, 8), np.float32)
    with MapBuilder(
        path, ModelKey("test", "0" * 64, "fc6", 8), RegionsKey("left-right", 0.4, "set"), SamplingConfig()
    ) as b:
        for drive_m in (0.0, 1000.0):
            b.begin_segment("drive", "rear")
            for row in range(200):
                lat_deg = LAT_DEG + (drive_m + row * SPACING_M) * METRE_DEG
                known = row, lat_deg, 153.0, 0.0, 0.0, row * SPACING_M
                b.add(raw[row], Place(*known, position_sigma_m=1.0, position_source="gps"))
        b.finish(normalize, "test")
    return MapSet.of(open_map(path))


@pytest.fixture(scope="module")
def route(map_set: MapSet) -> Route:
    return Route(map_set)


def settings(rig: RigConfig, **tracking: Any) -> Config:
    return Config(rig=rig, tracking=TrackingConfig(**tracking), sequence=SequenceConfig(length=LENGTH))


@pytest.fixture
def open_filter(route: Route) -> Callable[..., RouteFilter]:
    def open_one(rig: RigConfig = RigConfig(), **tracking: Any) -> RouteFilter:  # noqa: B008  # frozen
        return RouteFilter(route, settings(rig, **tracking))

    return open_one


def match(place: int, direction: Any = "forward", **changes: Any) -> PlaceMatch:
    fields: dict[str, Any] = {
        "place_index": place,
        "place": place,
        "direction": direction,
        "order": "swapped",
        "slope": 1.0,
        "distance": 0.5,
        "uniqueness": 1.2,
        "accepted": True,
    }
    return PlaceMatch(**{**fields, **changes})


class Drive:
    """A vehicle that sees what it should: one frame each 2 m, a fifth of a second apart."""

    def __init__(self, one: RouteFilter, start_place: int, direction: Any = "forward") -> None:
        self.filter, self.direction = one, direction
        self.sign = 1 if direction == "forward" else -1
        self.place, self.frames, self.stamp_ns = start_place, 0, 100 * S

    def displacement(self, further_m: float = 0.0, leg: int = 1) -> Displacement:
        return Displacement(leg, 0.0, self.sign * (self.frames * SPACING_M + further_m))

    def go(self, frames: int, sees: Callable[[int], PlaceMatch | None] | None = None, missed: int = 0) -> None:
        for _ in range(frames):
            self.frames += 1
            self.stamp_ns += FRAME_NS
            self.place += self.sign
            seen = sees(self.place) if sees else match(self.place, self.direction)
            self.filter.update(seen, self.stamp_ns, self.displacement(), missed)

    def north_m(self, tracked: PlaceFix | None) -> float:
        assert tracked is not None
        return (tracked.lat_deg - LAT_DEG) / METRE_DEG


def warm(one: RouteFilter, place: int = 60, direction: Any = "forward", frames: int = 30) -> Drive:
    drive = Drive(one, place, direction)
    drive.go(LENGTH, lambda _: None)
    drive.go(frames)
    return drive


@pytest.mark.parametrize(("direction", "heading_deg"), [("forward", 0.0), ("reverse", 180.0)])
def test_a_vehicle_is_followed(open_filter: Callable[..., RouteFilter], direction: str, heading_deg: float) -> None:
    drive = warm(open_filter(), 100, direction)
    fix = drive.filter.at_exposure()
    assert drive.north_m(fix) == pytest.approx(drive.place * SPACING_M, abs=0.05)
    assert fix is not None
    assert (fix.heading_deg, fix.matches, fix.stamp_ns) == (heading_deg, 30, drive.stamp_ns)
    assert fix.lon_deg == pytest.approx(153.0, abs=1e-7)


def test_places_passed_unseen_are_part_of_the_line(open_filter: Callable[..., RouteFilter]) -> None:
    drive = warm(open_filter())
    drive.frames += 5
    drive.place += 5
    drive.go(1, missed=5)
    assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)
    drive.go(6)
    assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)


def test_it_is_moved_on_by_the_velocity_also_backwards_and_to_the_side(
    open_filter: Callable[..., RouteFilter],
) -> None:
    drive = warm(open_filter())
    before, later_ns = drive.filter.at_exposure(), drive.stamp_ns + S
    ahead = drive.filter.at(later_ns, drive.displacement(9.0))
    back = drive.filter.at(later_ns, drive.displacement(-9.0))
    east = drive.filter.at(later_ns, replace(drive.displacement(), east_m=9.0))
    assert before is not None and ahead is not None and back is not None and east is not None
    assert drive.north_m(ahead) - drive.north_m(before) == pytest.approx(9.0, abs=0.02)
    assert drive.north_m(back) - drive.north_m(before) == pytest.approx(-9.0, abs=0.02)
    assert (east.lon_deg - 153.0) * 99_255 == pytest.approx(9.0, abs=0.02)
    assert ahead.stamp_ns == later_ns
    assert ahead.sigma_m > before.sigma_m


def test_what_is_seen_lies_ahead_and_the_other_lane_to_the_left(open_filter: Callable[..., RouteFilter]) -> None:
    drive = warm(open_filter(RigConfig(ahead_forward_swapped_m=26.0, left_forward_m=3.5)))
    fix = drive.filter.at_exposure()
    assert drive.north_m(fix) == pytest.approx(drive.place * SPACING_M - 26.0, abs=0.05)
    assert fix is not None
    assert (153.0 - fix.lon_deg) * 99_255 == pytest.approx(3.5, abs=0.01), "left of north is west"


def beside_m(fix: PlaceFix | None) -> float:
    """Meters to the left of the map's drive, for a vehicle that drives north."""
    assert fix is not None and fix.lon_deg is not None
    return (153.0 - fix.lon_deg) * 99_255


def regions(beyond_m: float, left_m: float) -> Parallax:
    """Lines that are clearly so far beyond that of both regions, of a vehicle so far to the left of the map's drive."""
    steps_m = SPACING_M * np.arange(-20, 21)
    away_m = [steps_m - beyond_m - side * 2.4 * left_m for side in (-0.5, 0.5)]
    rows = [np.tile(1 - 0.3 / (1 + (one / 4) ** 2), (LENGTH, 1)) for one in away_m]
    return Parallax(np.arange(LENGTH), np.array(rows))


@pytest.mark.parametrize("direction", ["forward", "reverse"])
@pytest.mark.parametrize("left_m", [5.0, 8.0, 0.0])
def test_parallax_says_how_far_a_vehicle_is_beside_the_maps_drive(
    open_filter: Callable[..., RouteFilter], direction: str, left_m: float
) -> None:
    """The lane is 3.5 m to the left; this vehicle is somewhere else, and each meter shows as 2.4 m of lag."""
    rig = RigConfig(left_forward_m=3.5, left_reverse_m=3.5, parallax=2.4)

    def sees(place: int) -> PlaceMatch:
        return match(place, direction, order="same", parallax=regions(0.0, left_m))

    filters = {}
    for name, one in (("measured", rig), ("not measured", msgspec.structs.replace(rig, parallax=0.0))):
        drive = Drive(open_filter(one), 120 if direction == "reverse" else 40, direction)
        drive.go(LENGTH, lambda _: None)
        drive.go(40, sees)
        filters[name] = drive.filter.at_exposure()
    left = 1 if direction == "forward" else -1
    assert left * beside_m(filters["measured"]) == pytest.approx(left_m, abs=0.5)
    assert left * beside_m(filters["not measured"]) == pytest.approx(3.5, abs=0.01)
    found, guessed = filters["measured"], filters["not measured"]
    assert found is not None and guessed is not None
    assert found.sigma_across_m < guessed.sigma_across_m


def test_the_regions_say_where_a_vehicle_is_along_however_far_off_the_line_of_both_is(
    open_filter: Callable[..., RouteFilter],
) -> None:
    """The line of both together is that of one of them, 4 m ahead."""
    drive = Drive(open_filter(RigConfig(parallax=2.4)), 40)
    drive.go(LENGTH, lambda _: None)
    drive.go(60, lambda place: match(place + 2, order="same", parallax=regions(-4.0, 0.0)))
    assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.5)


def test_a_match_that_is_not_believed_corrects_within_what_is_expected_and_confirms_nothing(
    open_filter: Callable[..., RouteFilter],
) -> None:
    """It shows a vehicle that is 1 m further left, or 30 m further ahead; or another place fits the frame better."""
    for beyond_m, uniqueness, expected_m in ((0.0, 1.02, 1.0), (30.0, 1.02, 0.0), (0.0, 0.98, 0.0)):
        drive = Drive(open_filter(RigConfig(parallax=2.4)), 40)
        drive.go(LENGTH, lambda _: None)
        drive.go(20, lambda place: match(place, order="same", parallax=regions(0.0, 0.0)))
        last = drive.filter.at_exposure()
        fields = {"order": "same", "parallax": regions(beyond_m, 1.0), "accepted": False, "uniqueness": uniqueness}
        drive.go(8, lambda place, fields=fields: match(place, **fields))
        found = drive.filter.at(drive.stamp_ns, drive.displacement())
        assert beside_m(found) == pytest.approx(expected_m, abs=0.5)
        assert drive.north_m(found) == pytest.approx(drive.place * SPACING_M, abs=0.7)
        assert found is not None and last is not None
        assert found.matches == last.matches
        drive.go(3, lambda place, fields=fields: match(place, **fields))
        assert drive.filter.at(drive.stamp_ns, drive.displacement()) is None, "20 m without a believed match"


def test_a_lost_position_goes_on_only_where_the_next_match_agrees(open_filter: Callable[..., RouteFilter]) -> None:
    """A vehicle 2 m beside the map's drive, which only its regions have shown; then 60 m without a match."""
    for further, expected_m in ((0, 2.0), (40, 0.0)):
        drive = Drive(open_filter(RigConfig(parallax=2.4, sigma_across_m=4.0)), 40)
        drive.go(LENGTH, lambda _: None)
        drive.go(30, lambda place: match(place, order="same", parallax=regions(0.0, 2.0)))
        drive.go(30, lambda _: None)
        assert drive.filter.at_exposure() is None
        drive.go(1, lambda place, further=further: match(place + further))
        found = drive.filter.at_exposure()
        assert drive.north_m(found) == pytest.approx((drive.place + further) * SPACING_M, abs=1.0)
        assert beside_m(found) == pytest.approx(expected_m, abs=0.5)


@pytest.mark.parametrize(("frames", "stays"), [(20, False), (40, True)])
def test_matches_elsewhere_than_reckoning_are_disputed_until_they_have_agreed_for_long(
    open_filter: Callable[..., RouteFilter], frames: int, stays: bool
) -> None:
    """A track that is lost before that is nothing from which the next one could begin."""
    drive, further = warm(open_filter(), 20), 60
    drive.go(30, lambda _: None)
    disputed = []
    for _ in range(frames):
        drive.go(1, lambda place: match(place + further))
        fix = drive.filter.at_exposure()
        assert fix is not None
        disputed.append(fix.disputed)
    assert all(disputed[:29])
    assert disputed[-1] is not stays
    drive.go(30, lambda _: None)
    drive.go(1)
    found = drive.filter.at_exposure()
    assert drive.north_m(found) == pytest.approx(drive.place * SPACING_M, abs=1.0)
    assert found is not None
    assert found.disputed is stays


def test_far_beside_the_road_no_match_corrects_a_position(open_filter: Callable[..., RouteFilter]) -> None:
    """By its own reckoning the vehicle goes 26 m to the side; its regions would have it at 21 m there."""
    drive = warm(open_filter(RigConfig(parallax=2.4, sigma_across_m=4.0), lost_after_m=1000.0, lost_after_s=60.0))
    aside_m = 0.0
    drive.displacement = lambda: Displacement(1, aside_m, drive.frames * SPACING_M)  # type: ignore[method-assign]
    for _ in range(20):
        aside_m += 1.3
        drive.go(1, lambda _: None)
    drive.go(LENGTH, lambda _: None)
    for believed in (True, False):
        drive.go(4, lambda place, ok=believed: match(place, order="same", parallax=regions(0.0, -21.0), accepted=ok))
        later = drive.filter.at(drive.stamp_ns, drive.displacement())
        assert beside_m(later) == pytest.approx(-26.0, abs=1.0)
        assert later is not None
        assert later.matches == 30, "none has agreed since"


def test_the_first_match_without_gps_corrects_a_position_that_gps_bounded(
    open_filter: Callable[..., RouteFilter],
) -> None:
    """This vehicle drives 2 m beside where the map expects it; only GPS has said so."""
    rig = RigConfig(sigma_across_m=4.0)
    with_gps, without = Drive(open_filter(rig), 40), Drive(open_filter(rig), 40)
    for drive in (with_gps, without):
        drive.go(LENGTH, lambda _: None)
        lat_deg = LAT_DEG + drive.place * SPACING_M * METRE_DEG
        if drive is with_gps:
            own = VehiclePosition(drive.stamp_ns, lat_deg, 153.0 - 2.0 / 99_255, 0.0, 0.0, 10.0)
            drive.filter.bind(own, 1.0)
        drive.go(3)
    assert beside_m(with_gps.filter.at_exposure()) == pytest.approx(2.0, abs=0.5)
    assert beside_m(without.filter.at_exposure()) == pytest.approx(0.0, abs=0.01)


def test_gps_that_disagrees_with_the_matches_begins_no_track(open_filter: Callable[..., RouteFilter]) -> None:
    drive = Drive(open_filter(), 40)
    drive.go(LENGTH, lambda _: None)
    far = VehiclePosition(drive.stamp_ns, LAT_DEG + 200.0 * METRE_DEG, 153.0, 0.0, 0.0, 10.0)
    drive.filter.bind(far, 1.0)
    drive.go(3)
    assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)


@pytest.mark.parametrize(("direction", "heading_deg"), [("forward", 0.0), ("reverse", 180.0)])
def test_where_the_map_knows_no_heading_it_is_that_of_the_drive(
    map_set: MapSet, direction: str, heading_deg: float
) -> None:
    places = map_set.places.copy()
    places["heading_deg"] = np.nan
    rig = RigConfig(left_forward_m=3.5, left_reverse_m=-3.5)
    route = Route(replace(map_set, places=places))
    fix = warm(RouteFilter(route, settings(rig)), 100, direction).filter.at_exposure()
    assert fix is not None
    assert fix.heading_deg == pytest.approx(heading_deg, abs=1e-3)
    assert (153.0 - fix.lon_deg) * 99_255 == pytest.approx(3.5, abs=0.01), "west, both ways"


def test_a_line_too_steep_counts_by_its_middle(open_filter: Callable[..., RouteFilter]) -> None:
    """At slope 1.1 over 19 steps of 2 m it ends 1.9 m too far, as this vehicle's matches do."""
    drive = Drive(open_filter(), 60)
    drive.go(LENGTH, lambda _: None)
    drive.go(30, lambda place: match(place + 1, slope=1 + 2 / 19))  # 2 m too far
    assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)


@pytest.mark.parametrize("seen", [{"slope": 0.6}, {"slope": 1.5}, {"direction": "reverse"}])
def test_a_line_that_did_not_move_as_the_vehicle_is_not_used(
    open_filter: Callable[..., RouteFilter], seen: dict[str, Any]
) -> None:
    drive = Drive(open_filter(), 60)
    drive.go(LENGTH, lambda _: None)
    drive.go(30, lambda place: match(place, **{"direction": "forward", **seen}))
    assert drive.filter.at_exposure() is None


@pytest.mark.parametrize(("start", "used"), [(0, False), (3, True), (196, True), (198, False)])
def test_a_line_at_an_end_of_a_drive_may_have_been_pushed_there(
    open_filter: Callable[..., RouteFilter], start: int, used: bool
) -> None:
    drive = Drive(open_filter(), start - LENGTH if start > 100 else start)
    drive.go(LENGTH - 1, lambda _: None)
    drive.go(1)
    assert (drive.filter.at_exposure() is not None) == used


def test_without_a_displacement_there_is_no_position(open_filter: Callable[..., RouteFilter]) -> None:
    drive = warm(open_filter())
    assert drive.filter.at(drive.stamp_ns + S, None) is None
    assert drive.filter.at(drive.stamp_ns + S, drive.displacement(leg=2)) is None, "of another leg"
    assert drive.filter.at_exposure() is not None
    drive.filter.update(match(drive.place), drive.stamp_ns + S, None)
    assert drive.filter.at_exposure() is None


def test_many_matches_are_hardly_better_than_one(open_filter: Callable[..., RouteFilter]) -> None:
    few, many = (warm(open_filter(), frames=frames).filter.at_exposure() for frames in (1, 30))
    assert few is not None and many is not None
    assert 3.0 <= many.sigma_along_m < few.sigma_along_m < 1.5 * many.sigma_along_m


def test_a_wrong_scale_is_found_and_remembered(open_filter: Callable[..., RouteFilter]) -> None:
    """The odometer reads 8 % too little."""
    drive = Drive(open_filter(), 10)
    drive.displacement = lambda: Displacement(1, 0.0, 0.92 * drive.frames * SPACING_M)  # type: ignore[method-assign]
    drive.go(2 * LENGTH, lambda _: None)
    drive.go(130)
    fix = drive.filter.at_exposure()
    assert fix is not None
    assert drive.north_m(fix) == pytest.approx(drive.place * SPACING_M, abs=2.0)
    assert fix.velocity_error == pytest.approx(0.087, abs=0.03)
    assert fix.disputed, "by more than drift_percent allows: what else is wrong, nobody knows"
    drive.go(30, lambda _: None)
    assert drive.filter.at_exposure() is None
    drive.go(40, lambda place: match(place - 90))
    later = drive.filter.at_exposure()
    assert later is not None
    assert later.disputed


def test_one_false_match_changes_nothing(open_filter: Callable[..., RouteFilter]) -> None:
    drive = warm(open_filter())
    drive.go(1, lambda _: match(300))
    drive.go(2)
    fix = drive.filter.at_exposure()
    assert drive.north_m(fix) == pytest.approx(drive.place * SPACING_M, abs=0.05)
    assert fix is not None
    assert fix.matches == 32


def test_matches_that_agree_with_each_other_dispute_the_position_and_replace_it(
    open_filter: Callable[..., RouteFilter],
) -> None:
    """The position that they replace it by counts its matches anew, and is not disputed any more."""
    drive = warm(open_filter(lost_after_m=1000.0, lost_after_s=60.0))
    disputed = []
    for _ in range(40):
        drive.go(1, lambda place: match(place + 200 + 20))
        fix = drive.filter.at_exposure()
        assert fix is not None
        disputed.append(fix.disputed)
    assert disputed.index(True) == 2
    replaced = len(disputed) - disputed[::-1].index(True)
    assert not any(disputed[replaced:])
    assert replaced * SPACING_M <= 70.0
    assert drive.north_m(fix) == pytest.approx(1000.0 + (drive.place + 20) * SPACING_M, abs=0.1)
    assert fix.matches < 45


@pytest.mark.parametrize("unseen", [None, match(5, accepted=False)])
def test_off_the_map_it_is_lost_after_some_meters(
    open_filter: Callable[..., RouteFilter], unseen: PlaceMatch | None
) -> None:
    drive = warm(open_filter(lost_after_m=20.0))
    drive.go(10, lambda _: unseen)
    assert drive.filter.at_exposure() is not None
    drive.go(1, lambda _: unseen)
    assert drive.filter.at_exposure() is None
    assert drive.filter.at(drive.stamp_ns, drive.displacement()) is None


def test_after_a_silence_it_is_lost(open_filter: Callable[..., RouteFilter]) -> None:
    drive = warm(open_filter(lost_after_s=2.0))
    assert drive.filter.at(drive.stamp_ns + 2 * S, drive.displacement()) is not None
    assert drive.filter.at(drive.stamp_ns + 2 * S + 1, drive.displacement()) is None


def test_it_is_not_moved_on_further_than_it_may_go_unseen(open_filter: Callable[..., RouteFilter]) -> None:
    """A camera that stalls leaves the odometer running."""
    drive = warm(open_filter(lost_after_m=20.0))
    assert drive.filter.at(drive.stamp_ns + S, drive.displacement(19.9)) is not None
    assert drive.filter.at(drive.stamp_ns + S, drive.displacement(20.1)) is None


def test_an_odometer_that_counts_anew_begins_a_new_track(open_filter: Callable[..., RouteFilter]) -> None:
    drive = warm(open_filter())
    drive.filter.update(match(drive.place), drive.stamp_ns + FRAME_NS, drive.displacement(leg=2))
    assert drive.filter.at_exposure() is None
