"""The tracker on drives along a small map whose every position is known: 2 m a place, due north."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from edge.config import RigConfig, SamplingConfig, TrackingConfig
from edge.descriptor.normalize import normalize
from edge.localization import PlaceFix
from edge.localization.route_tracker import RouteTracker
from edge.reference_map.builder import MapBuilder, Place
from edge.reference_map.map_set import MapSet
from edge.reference_map.route import Route
from edge.reference_map.store import ModelKey, RegionsKey, open_map
from edge.sequence import PlaceMatch

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
                b.add(raw[row], Place(row, lat_deg, 153.0, 0.0, 0.0, route_m=row * SPACING_M))
        b.finish(normalize, "test")
    return MapSet.of(open_map(path))


@pytest.fixture(scope="module")
def route(map_set: MapSet) -> Route:
    return Route(map_set)


@pytest.fixture
def open_tracker(route: Route) -> Callable[..., RouteTracker]:
    def open_one(rig: RigConfig = RigConfig(), **tracking: Any) -> RouteTracker:  # noqa: B008  # frozen
        return RouteTracker(route, TrackingConfig(**tracking), rig, LENGTH)

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

    def __init__(
        self, tracker: RouteTracker, start_place: int, direction: Any = "forward", odometer: bool = True
    ) -> None:
        self.tracker, self.direction, self.odometer = tracker, direction, odometer
        self.sign = 1 if direction == "forward" else -1
        self.place, self.frames, self.stamp_ns = start_place, 0, 100 * S

    @property
    def driven_m(self) -> float | None:
        return self.frames * SPACING_M if self.odometer else None

    def go(self, frames: int, sees: Callable[[int], PlaceMatch | None] | None = None, missed: int = 0) -> None:
        for _ in range(frames):
            self.frames += 1
            self.stamp_ns += FRAME_NS
            self.place += self.sign
            seen = sees(self.place) if sees else match(self.place, self.direction)
            self.tracker.update(seen, self.stamp_ns, self.driven_m, missed)

    def north_m(self, tracked: PlaceFix | None) -> float:
        assert tracked is not None
        return (tracked.lat_deg - LAT_DEG) / METRE_DEG


def warm(tracker: RouteTracker, place: int = 60, direction: Any = "forward", frames: int = 30, **options: Any) -> Drive:
    drive = Drive(tracker, place, direction, **options)
    drive.go(LENGTH, lambda _: None)
    drive.go(frames)
    return drive


@pytest.mark.parametrize(("direction", "heading_deg"), [("forward", 0.0), ("reverse", 180.0)])
def test_a_vehicle_is_followed(open_tracker: Callable[..., RouteTracker], direction: str, heading_deg: float) -> None:
    drive = warm(open_tracker(), 100, direction)
    tracked = drive.tracker.at_exposure()
    assert drive.north_m(tracked) == pytest.approx(drive.place * SPACING_M, abs=0.05)
    assert tracked is not None
    assert (tracked.heading_deg, tracked.matches, tracked.stamp_ns) == (heading_deg, 30, drive.stamp_ns)
    assert tracked.lon_deg == pytest.approx(153.0, abs=1e-7)


def test_places_passed_unseen_are_part_of_the_line(open_tracker: Callable[..., RouteTracker]) -> None:
    drive = warm(open_tracker())
    drive.frames += 5
    drive.place += 5
    drive.go(1, missed=5)
    assert drive.north_m(drive.tracker.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)
    drive.go(6)
    assert drive.north_m(drive.tracker.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)


def test_it_is_moved_on_by_what_was_driven_since_and_is_then_less_certain(
    open_tracker: Callable[..., RouteTracker],
) -> None:
    drive = warm(open_tracker(drift_percent=10.0))
    before, later_ns = drive.tracker.at_exposure(), drive.stamp_ns + S
    after = drive.tracker.at(later_ns, (drive.driven_m or 0.0) + 9.0)
    assert before is not None and after is not None
    assert drive.north_m(after) - drive.north_m(before) == pytest.approx(9.0, abs=0.02)
    assert after.stamp_ns == later_ns
    assert after.sigma_along_m == pytest.approx(np.hypot(before.sigma_along_m, 0.9), abs=0.01)


def test_what_is_seen_lies_ahead_and_the_other_lane_to_the_left(open_tracker: Callable[..., RouteTracker]) -> None:
    rig = RigConfig(ahead_forward_swapped_m=26.0, left_forward_m=3.5, sigma_along_m=4.0, sigma_across_m=1.5)
    drive = warm(open_tracker(rig))
    tracked = drive.tracker.at_exposure()
    assert drive.north_m(tracked) == pytest.approx(drive.place * SPACING_M - 26.0, abs=0.05)
    assert tracked is not None
    assert (153.0 - tracked.lon_deg) * 99_255 == pytest.approx(3.5, abs=0.01), "left of north is west"
    assert tracked.sigma_across_m == 1.5
    assert 4.0 <= tracked.sigma_along_m < 5.0


@pytest.mark.parametrize(("direction", "heading_deg"), [("forward", 0.0), ("reverse", 180.0)])
def test_where_the_map_knows_no_heading_it_is_that_of_the_drive(
    map_set: MapSet, direction: str, heading_deg: float
) -> None:
    places = map_set.places.copy()
    places["heading_deg"] = np.nan
    rig = RigConfig(left_forward_m=3.5, left_reverse_m=-3.5)
    route = Route(replace(map_set, places=places))
    tracked = warm(RouteTracker(route, TrackingConfig(), rig, LENGTH), 100, direction).tracker.at_exposure()
    assert tracked is not None
    assert tracked.heading_deg == pytest.approx(heading_deg, abs=1e-3)
    assert (153.0 - tracked.lon_deg) * 99_255 == pytest.approx(3.5, abs=0.01), "west, both ways"


def test_a_line_too_steep_is_turned_about_its_middle(open_tracker: Callable[..., RouteTracker]) -> None:
    """At slope 1.1 over 19 steps of 2 m it ends 1.9 m too far, as this vehicle's matches do."""
    tracker = open_tracker()
    drive = Drive(tracker, 60)
    drive.go(LENGTH, lambda _: None)
    drive.go(30, lambda place: match(place + 1, slope=1 + 2 / 19))  # 2 m too far
    assert drive.north_m(tracker.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)


@pytest.mark.parametrize("seen", [{"slope": 0.7}, {"slope": 1.4}])
def test_a_line_nowhere_near_the_odometers_slope_is_no_sighting(
    open_tracker: Callable[..., RouteTracker], seen: dict[str, Any]
) -> None:
    tracker = open_tracker()
    drive = Drive(tracker, 60)
    drive.go(LENGTH, lambda _: None)
    drive.go(30, lambda place: match(place, **seen))
    assert tracker.at_exposure() is None


def test_a_line_that_begins_at_the_end_of_a_drive_may_have_been_pushed_there(
    open_tracker: Callable[..., RouteTracker],
) -> None:
    tracker = open_tracker()
    drive = Drive(tracker, 0)
    drive.go(LENGTH, lambda _: None)  # ends at place 20, a line of 19 steps behind it
    drive.go(1)
    assert tracker.at_exposure() is None
    drive.go(3)
    tracked = tracker.at_exposure()
    assert tracked is not None
    assert tracked.matches == 3


def test_without_an_odometer_the_lines_end_between_places_and_their_slope_counts(
    open_tracker: Callable[..., RouteTracker],
) -> None:
    tracker = open_tracker()
    drive = Drive(tracker, 60, odometer=False)
    drive.go(30, lambda place: match(place, offset_places=0.4))
    tracked = tracker.at_exposure()
    assert drive.north_m(tracked) == pytest.approx((drive.place + 0.4) * SPACING_M, abs=0.05)
    assert tracked is not None
    assert tracked.matches >= 25
    assert tracker.at(drive.stamp_ns + S, None) is None, "nobody can say where it is by now"


def test_a_wide_match_is_less_certain(open_tracker: Callable[..., RouteTracker]) -> None:
    sigmas_m = []
    for width in (1.0, 10.0):
        tracker = open_tracker()
        drive = Drive(tracker, 60, odometer=False)
        drive.go(30, lambda place, width=width: match(place, half_width_places=width))  # type: ignore[misc]  # bound now
        tracked = tracker.at_exposure()
        assert tracked is not None
        sigmas_m.append(tracked.sigma_along_m)
    assert sigmas_m[1] > 2 * sigmas_m[0]


def test_matches_that_wander_make_it_less_certain(open_tracker: Callable[..., RouteTracker]) -> None:
    steady = warm(open_tracker()).tracker.at_exposure()
    tracker = open_tracker()
    drive = Drive(tracker, 60)
    drive.go(LENGTH, lambda _: None)
    drive.go(30, lambda place: match(place + 3 * (place % 2)))
    wandering = tracker.at_exposure()
    assert steady is not None and wandering is not None
    assert wandering.sigma_along_m > 1.2 * steady.sigma_along_m


def test_one_false_match_changes_nothing(open_tracker: Callable[..., RouteTracker]) -> None:
    drive = warm(open_tracker())
    drive.go(1, lambda _: match(300))
    drive.go(2)
    tracked = drive.tracker.at_exposure()
    assert drive.north_m(tracked) == pytest.approx(drive.place * SPACING_M, abs=0.05)
    assert tracked is not None
    assert tracked.matches == 32


def test_matches_that_agree_with_each_other_take_over_and_count_anew(
    open_tracker: Callable[..., RouteTracker],
) -> None:
    drive = warm(open_tracker())
    drive.go(3, lambda place: match(place + 200))
    tracked = drive.tracker.at_exposure()
    assert drive.north_m(tracked) == pytest.approx(1000.0 + drive.place * SPACING_M, abs=0.05)
    assert tracked is not None
    assert tracked.matches == 3


def test_the_way_back_is_not_the_way_out(open_tracker: Callable[..., RouteTracker]) -> None:
    drive = warm(open_tracker())
    drive.go(1, lambda place: match(place, "reverse"))
    drive.go(1)
    tracked = drive.tracker.at_exposure()
    assert tracked is not None
    assert (tracked.direction, tracked.matches) == ("forward", 31)


@pytest.mark.parametrize("unseen", [None, match(5, accepted=False)])
def test_off_the_map_it_is_lost_after_some_meters(
    open_tracker: Callable[..., RouteTracker], unseen: PlaceMatch | None
) -> None:
    drive = warm(open_tracker(lost_after_m=20.0))
    drive.go(10, lambda _: unseen)
    assert drive.tracker.at_exposure() is not None
    drive.go(1, lambda _: unseen)
    assert drive.tracker.at_exposure() is None
    assert drive.tracker.at(drive.stamp_ns, drive.driven_m) is None


def test_after_a_silence_it_is_lost(open_tracker: Callable[..., RouteTracker]) -> None:
    drive = warm(open_tracker(lost_after_s=2.0))
    assert drive.tracker.at(drive.stamp_ns + 2 * S, drive.driven_m) is not None
    assert drive.tracker.at(drive.stamp_ns + 2 * S + 1, drive.driven_m) is None


def test_it_is_not_moved_on_further_than_it_may_go_unseen(open_tracker: Callable[..., RouteTracker]) -> None:
    """A camera that stalls leaves the odometer running."""
    drive = warm(open_tracker(lost_after_m=20.0))
    driven_m = drive.driven_m or 0.0
    assert drive.tracker.at(drive.stamp_ns + S, driven_m + 20.0) is not None
    assert drive.tracker.at(drive.stamp_ns + S, driven_m + 20.1) is None


def test_beyond_the_end_of_the_drive_nothing_is_known(open_tracker: Callable[..., RouteTracker]) -> None:
    drive = warm(open_tracker(), place=145)
    assert drive.place == 195
    assert drive.tracker.at(drive.stamp_ns + S, (drive.driven_m or 0.0) + 7.0) is not None
    assert drive.tracker.at(drive.stamp_ns + S, (drive.driven_m or 0.0) + 9.0) is None


def test_an_odometer_that_counts_anew_begins_a_new_track(open_tracker: Callable[..., RouteTracker]) -> None:
    drive = warm(open_tracker())
    drive.frames = 0
    drive.go(1)
    assert drive.tracker.at_exposure() is None or drive.tracker.at_exposure().matches == 1  # type: ignore[union-attr]
    drive.go(LENGTH)
    assert drive.north_m(drive.tracker.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)
