"""Where the route filter has a vehicle that its matches agree with: by lines, regions and reckoning."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import msgspec
import numpy as np
import pytest

from edge.config import RigConfig
from edge.localization.route_filter import RouteFilter
from edge.reference_map.map_set import MapSet
from edge.reference_map.route import Route
from edge.sequence import PlaceMatch
from tests.localization.straight_road import (
    LENGTH,
    SPACING_M,
    Drive,
    S,
    beside_m,
    match,
    regions,
    settings,
    warm,
)


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
    for frames in range(7):
        passed = (*range(frames + 1), *range(frames + 6, LENGTH + 5))
        drive.go(1, partial(match, passed=passed), missed=0 if frames else 5)
        assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)
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
    assert beside_m(east) == pytest.approx(-9.0, abs=0.02)
    assert ahead.stamp_ns == later_ns
    assert ahead.sigma_m > before.sigma_m


def test_where_the_time_of_exposure_is_uncertain_the_position_is_so_along_the_road(
    open_filter: Callable[..., RouteFilter],
) -> None:
    (dated, known), (undated, unknown) = (
        (drive, drive.filter.at_exposure()) for drive in (warm(open_filter()), warm(open_filter(), undated_m=4.0))
    )
    assert known is not None and unknown is not None
    assert unknown.sigma_along_m == pytest.approx(math.hypot(known.sigma_along_m, 4.0), abs=0.02)
    assert unknown.sigma_across_m == known.sigma_across_m
    later = undated.filter.at(undated.stamp_ns + S, undated.displacement(8.0))
    assert later is not None and later.sigma_along_m >= unknown.sigma_along_m
    assert dated.north_m(known) == undated.north_m(unknown)


def test_what_is_seen_lies_ahead_and_the_other_lane_to_the_left(open_filter: Callable[..., RouteFilter]) -> None:
    drive = warm(open_filter(RigConfig(ahead_forward_swapped_m=26.0, left_forward_m=3.5)))
    fix = drive.filter.at_exposure()
    assert drive.north_m(fix) == pytest.approx(drive.place * SPACING_M - 26.0, abs=0.05)
    assert beside_m(fix) == pytest.approx(3.5, abs=0.01), "left of north is west"


@pytest.mark.parametrize(("direction", "turned_deg"), [("forward", 0.0), ("reverse", 180.0)])
def test_its_heading_is_that_of_the_road_where_it_is_not_where_it_looks(
    map_set: MapSet, direction: str, turned_deg: float
) -> None:
    """On a road that turns by a tenth of a degree with each place; the camera sees 13 places ahead."""
    places = map_set.places.copy()
    places["heading_deg"] = 0.1 * (np.arange(len(places)) % 200)
    rig = RigConfig(ahead_forward_swapped_m=26.0, ahead_reverse_swapped_m=26.0)
    drive = warm(RouteFilter(Route(replace(map_set, places=places)), settings(rig)), 100, direction)
    fix = drive.filter.at_exposure()
    assert fix is not None and fix.heading_deg is not None
    assert fix.heading_deg == pytest.approx(turned_deg + 0.1 * (drive.place - drive.sign * 13), abs=0.05)


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


@pytest.mark.parametrize("seen", [{"accepted": False}, {"uniqueness": 0.98}])
def test_a_match_that_is_not_believed_or_not_the_best_changes_nothing(
    open_filter: Callable[..., RouteFilter], seen: dict[str, Any]
) -> None:
    """It shows a vehicle that is 1 m further left."""
    drive = Drive(open_filter(RigConfig(parallax=2.4)), 40)
    drive.go(LENGTH, lambda _: None)
    drive.go(20, partial(match, order="same", parallax=regions(0.0, 0.0)))
    last = drive.filter.at_exposure()
    drive.go(8, partial(match, order="same", parallax=regions(0.0, 1.0), **seen))
    found = drive.filter.at(drive.stamp_ns, drive.displacement())
    assert beside_m(found) == pytest.approx(0.0, abs=0.5)
    assert found is not None and last is not None
    assert found.matches == last.matches
    drive.go(3, partial(match, **seen))
    assert drive.filter.at(drive.stamp_ns, drive.displacement()) is None, "20 m without a believed match"


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
    assert beside_m(fix) == pytest.approx(3.5, abs=0.01), "west, both ways"


def test_a_line_too_steep_counts_by_its_middle(open_filter: Callable[..., RouteFilter]) -> None:
    """At slope 1.1 over 19 steps of 2 m it ends 1.9 m too far, as this vehicle's matches do."""
    drive = Drive(open_filter(), 60)
    drive.go(LENGTH, lambda _: None)
    drive.go(30, lambda place: match(place + 1, slope=1 + 2 / 19))  # 2 m too far
    assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)


@pytest.mark.parametrize(
    ("direction", "aside_m", "used"),
    [("forward", 0.0, True), ("forward", 2.0, True), ("forward", 4.0, False), ("reverse", 0.0, False)],
)
def test_a_line_that_leads_another_way_than_the_vehicle_went_is_not_used(
    open_filter: Callable[..., RouteFilter], direction: str, aside_m: float, used: bool
) -> None:
    """aside_m: to the east, for each 2 m that it goes north."""
    drive = Drive(open_filter(), 60)
    for frame in range(LENGTH + 20):
        drive.east_m += aside_m
        drive.go(1, partial(match, direction=direction) if frame >= LENGTH else lambda _: None)
    assert (drive.filter.at_exposure() is not None) == used


@pytest.mark.parametrize(("sharpness", "used"), [(0.04, False), (0.06, True)])
def test_a_line_that_is_not_sharp_is_not_used(
    open_filter: Callable[..., RouteFilter], sharpness: float, used: bool
) -> None:
    drive = Drive(open_filter(), 60)
    drive.go(LENGTH, lambda _: None)
    drive.go(10, lambda place: match(place, sharpness=sharpness))
    assert (drive.filter.at_exposure() is not None) == used


def test_the_fainter_a_line_the_less_certain_the_position(open_filter: Callable[..., RouteFilter]) -> None:
    def seen_at(sharpness: float, **seen: Any) -> tuple[float, float]:
        drive = Drive(open_filter(rig=RigConfig(parallax=2.4)), 60)
        drive.go(LENGTH, lambda _: None)
        drive.go(10, partial(match, sharpness=sharpness, **seen))
        fix = drive.filter.at_exposure()
        assert fix is not None
        return fix.sigma_along_m, fix.sigma_across_m

    both: dict[str, Any] = {"order": "same", "parallax": regions(0.0, 0.0)}
    assert seen_at(0.06)[0] > 1.5 * seen_at(0.2)[0] and seen_at(0.2) == seen_at(0.3)
    assert all(faint > 1.2 * sharp for faint, sharp in zip(seen_at(0.06, **both), seen_at(0.2, **both), strict=True))


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


def test_a_frame_that_no_line_leads_through_moves_none(open_filter: Callable[..., RouteFilter]) -> None:
    """As one whose distance is not known, after which a gap of seven places follows."""
    expected, drive = (warm(open_filter(scale_error_percent=5.0)) for _ in range(2))
    for number in range(4):
        drive.filter.update(None, drive.stamp_ns + number, drive.displacement(2.0 * number), in_line=False)
    for one in (expected, drive):
        one.place, one.frames = one.place + 7, one.frames + 7
        one.go(LENGTH // 2)
    at_m = expected.north_m(expected.filter.at_exposure())
    assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(at_m, abs=0.001)


def test_a_position_is_less_certain_where_matches_are_further_off_than_calibrated(
    open_filter: Callable[..., RouteFilter],
) -> None:
    """Each 60 m, faint matches are as far ahead as the last ones were behind, as in light that is unlike the map's."""

    def after(apart_places: int) -> tuple[float, float]:
        drive = Drive(open_filter(), 40)
        for _ in range(4):
            drive.go(25, lambda _: None)
            drive.place += apart_places
            drive.go(5, partial(match, sharpness=0.06))
            drive.place -= apart_places
            apart_places = -apart_places
        fix = drive.filter.at_exposure()
        assert fix is not None
        return drive.north_m(fix) - drive.place * SPACING_M, fix.sigma_along_m

    (_, usual_m), (off_m, sigma_m) = after(1), after(6)
    assert sigma_m > 1.15 * usual_m
    assert abs(off_m) < sigma_m


def test_many_matches_are_hardly_better_than_one(open_filter: Callable[..., RouteFilter]) -> None:
    few, many = (warm(open_filter(), frames=frames).filter.at_exposure() for frames in (1, 30))
    assert few is not None and many is not None
    assert 3.0 <= many.sigma_along_m < few.sigma_along_m < 1.5 * many.sigma_along_m


def test_a_position_is_less_certain_by_what_the_odometer_may_be_wrong_over_a_whole_line(
    open_filter: Callable[..., RouteFilter],
) -> None:
    """A line of 38 m; one vehicle's odometer is wrong by 20 %, the other's by no more than what is always allowed."""
    rig = RigConfig(sigma_along_m=0.5)
    unknown, known = (
        warm(open_filter(rig, scale_error_percent=one), frames=1).filter.at_exposure() for one in (20.0, 1.5)
    )
    assert unknown is not None and known is not None
    assert unknown.sigma_along_m == pytest.approx(math.hypot(known.sigma_along_m, 0.2 * 38.0), rel=0.05)
