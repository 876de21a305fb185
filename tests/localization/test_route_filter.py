"""Where the vehicle is by matches that agree: by lines and reckoning."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from edge.config import RigConfig
from edge.journal.records import PlaceFix
from edge.localization import MapUpdate
from edge.localization.filter import Filter
from edge.localization.hypotheses import BEGUN, FilterBank
from edge.sequence import PlaceMatch
from tests.common import S
from tests.localization.events_of import (
    LENGTH,
    LINE_M,
    Direction,
    Road,
    Sees,
    Vehicle,
    left_m,
    north_m,
    nothing,
    settings,
    warm,
)
from tests.localization.route_course import SPACING_M


def shown(road: Road, further_m: float = 0.0, direction: Direction = "forward", **changes: Any) -> Sees:
    """Frames that show the place so many meters further, with something else of the match."""
    return lambda at_m: road.match(at_m + further_m, direction, **changes)


def placed(one: Vehicle) -> PlaceFix:
    """The position, where there is one."""
    assert one.place is not None
    return one.place


@pytest.mark.parametrize(("direction", "heading_deg"), [("forward", 0.0), ("reverse", 180.0)])
def test_a_vehicle_is_followed(road: Road, direction: Direction, heading_deg: float) -> None:
    one = warm(road, north_m=200.0, direction=direction)
    fix = placed(one)
    assert (north_m(fix), left_m(fix)) == pytest.approx((one.north_m, 0.0), abs=0.05)
    assert (fix.heading_deg, fix.matches, fix.stamp_ns) == (heading_deg, 30, one.t_ns)


def test_places_passed_unseen_are_part_of_the_line(road: Road) -> None:
    one = warm(road)
    for _ in range(5):
        one.move()
    for frames in range(7):
        one.frame = {"missed": 0 if frames else 5}
        one.go(2, shown(road, passed=(*range(frames + 1), *range(frames + 6, LENGTH + 5))))
        assert north_m(one.place) == pytest.approx(one.north_m, abs=0.05)


def test_it_is_moved_on_by_the_velocity_also_backwards_and_to_the_side(road: Road) -> None:
    one = warm(road)
    before = placed(one)
    ahead, back, east = one.place_at(S, 9.0), one.place_at(S, -9.0), one.place_at(S, east_m=9.0)
    assert [north_m(at) - north_m(before) for at in (ahead, back)] == pytest.approx([9.0, -9.0], abs=0.02)
    assert left_m(east) == pytest.approx(-9.0, abs=0.02)
    assert ahead is not None and (ahead.stamp_ns, ahead.sigma_m > before.sigma_m) == (one.t_ns + S, True)


def test_where_the_time_of_exposure_is_uncertain_the_position_is_so_along_the_road(road: Road) -> None:
    dated, undated = warm(road), warm(road, timestamp_sigma_s=0.4)
    known, unknown = placed(dated), placed(undated)
    assert unknown.sigma_along_m == pytest.approx(math.hypot(known.sigma_along_m, 4.0), abs=0.02), "at 10 m/s"
    assert unknown.sigma_cross_track_m == pytest.approx(known.sigma_cross_track_m)
    later = undated.place_at(S, 8.0)
    assert later is not None and later.sigma_along_m >= unknown.sigma_along_m
    assert north_m(known) == pytest.approx(north_m(unknown))


def test_what_is_seen_lies_ahead_and_the_other_lane_to_the_left(road: Road) -> None:
    one = warm(road, settings(RigConfig(ahead_forward_same_m=26.0, left_forward_m=3.5)))
    assert north_m(one.place) == pytest.approx(one.north_m - 26.0, abs=0.05)
    assert left_m(one.place) == pytest.approx(3.5, abs=0.01), "left of north is west"


@pytest.mark.parametrize(("direction", "turned_deg"), [("forward", 0.0), ("reverse", 180.0)])
def test_its_heading_is_that_of_the_road_where_it_is_not_where_the_camera_points(
    road: Road, direction: Direction, turned_deg: float
) -> None:
    """On a road that turns by a tenth of a degree with each place; the camera sees 13 places ahead."""
    config = settings(RigConfig(ahead_forward_same_m=26.0, ahead_reverse_same_m=26.0))
    one = warm(road, config, 200.0, direction, meters=0)
    places = road.maps.places.copy()
    places["heading_deg"] = 0.1 * (np.arange(len(places)) % 200)
    one.drive.update(one.t_ns, MapUpdate(replace(road.maps, places=places)))
    one.go(2 * LINE_M)
    expected = turned_deg + 0.1 * (one.north_m / SPACING_M - one.sign * 13)
    assert placed(one).heading_deg == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize(("direction", "heading_deg"), [("forward", 0.0), ("reverse", 180.0)])
def test_where_the_map_knows_no_heading_it_is_that_of_the_drive(
    road: Road, direction: Direction, heading_deg: float
) -> None:
    one = warm(road, settings(RigConfig(left_forward_m=3.5, left_reverse_m=-3.5)), 200.0, direction, meters=0)
    places = road.maps.places.copy()
    places["heading_deg"] = np.nan
    one.drive.update(one.t_ns, MapUpdate(replace(road.maps, places=places)))
    one.go(2 * LINE_M)
    assert math.remainder((placed(one).heading_deg or 0.0) - heading_deg, 360.0) == pytest.approx(0.0, abs=1e-3)
    assert left_m(one.place) == pytest.approx(3.5, abs=0.01), "west, both ways"


@pytest.mark.parametrize("seen", [{"accepted": False}, {"uniqueness": 0.98}])
def test_a_match_that_is_not_believed_or_not_the_best_changes_nothing(road: Road, seen: dict[str, Any]) -> None:
    """It shows a vehicle that is 4 m further."""
    one = warm(road, None, 80.0, meters=40.0)
    matches = placed(one).matches
    one.go(16, shown(road, 4.0, **seen))
    found = one.place_at()
    assert north_m(found) == pytest.approx(one.north_m, abs=0.1)
    assert found is not None and found.matches == matches
    one.go(6, shown(road, **seen))
    assert one.place_at() is None, "20 m without a believed match"


def test_a_line_too_steep_counts_by_its_middle(road: Road) -> None:
    """At slope 1.1 over 19 steps of 2 m it ends 1.9 m too far, as this vehicle's matches do."""
    one = warm(road, sees=shown(road, 2.0, slope=1 + 2 / 19))
    assert north_m(one.place) == pytest.approx(one.north_m, abs=0.05)


@pytest.mark.parametrize(
    ("direction", "sideways_m", "is_used"),
    [("forward", 0.0, True), ("forward", 2.0, True), ("forward", 4.0, False), ("reverse", 0.0, False)],
)
def test_a_line_that_leads_another_way_than_the_vehicle_went_is_not_used(
    road: Road, direction: Direction, sideways_m: float, is_used: bool
) -> None:
    """aside_m: to the east, for each 2 m that it goes north."""
    one = Vehicle(road, north_m=120.0)
    one.sideways_m = sideways_m
    one.go(LINE_M, nothing)
    one.go(8, shown(road, direction=direction))
    assert (one.place is not None) == is_used


@pytest.mark.parametrize(("sharpness", "is_used"), [(0.04, False), (0.06, True)])
def test_a_line_that_is_not_sharp_is_not_used(road: Road, sharpness: float, is_used: bool) -> None:
    assert (warm(road, sees=shown(road, sharpness=sharpness)).place is not None) == is_used


def test_the_fainter_a_line_the_less_certain_the_position(road: Road) -> None:
    def seen_at(sharpness: float) -> float:
        return placed(warm(road, sees=shown(road, sharpness=sharpness), meters=20.0)).sigma_along_m

    faint, clear, clearer = (seen_at(sharpness) for sharpness in (0.06, 0.2, 0.3))
    assert faint > 1.5 * clear
    assert clear == pytest.approx(clearer)


@pytest.mark.parametrize(("ends_m", "is_used"), [(40, False), (46, True), (392, True), (396, False)])
def test_a_line_at_an_end_of_a_drive_may_have_been_pushed_there(road: Road, ends_m: float, is_used: bool) -> None:
    one = Vehicle(road, north_m=ends_m - LINE_M)
    one.go(LINE_M - 2, nothing)
    one.go(2)
    assert (one.place is not None) == is_used


def test_without_a_displacement_there_is_no_position(road: Road) -> None:
    one = warm(road)
    assert one.place_at(S, odometry_epoch=2) is None, "of another leg"
    assert one.place is not None
    one.frame = {"motion": None}
    one.go(2)
    assert one.place is None


def test_a_frame_that_no_line_leads_through_moves_none(road: Road) -> None:
    """As one whose distance is not known, after which a gap of seven places follows."""
    expected, one = (warm(road, settings(scale_error_percent=5.0)) for _ in range(2))
    for number in range(4):
        one.frame = {"in_line": False, "motion": one.moved(2.0 * number)}
        one.show(None)
    one.frame = {}
    for vehicle in (expected, one):
        for _ in range(7):
            vehicle.move()
        vehicle.go(LINE_M / 2)
    assert north_m(one.place) == pytest.approx(north_m(expected.place), abs=0.01)


def test_many_matches_are_hardly_better_than_one(road: Road) -> None:
    few, many = (placed(warm(road, meters=meters)) for meters in (2.0, 60.0))
    assert 3.0 <= many.sigma_along_m < few.sigma_along_m < 1.5 * many.sigma_along_m


def test_a_position_is_less_certain_by_what_the_odometer_may_be_wrong_over_a_whole_line(road: Road) -> None:
    """A line of 38 m; one vehicle's odometer is wrong by 20 %, the other's by no more than what is always allowed."""
    rig = RigConfig(sigma_along_m=0.5)
    unknown, known = (placed(warm(road, settings(rig, scale_error_percent=one), meters=2.0)) for one in (20.0, 1.5))
    assert unknown.sigma_along_m == pytest.approx(math.hypot(known.sigma_along_m, 0.2 * 38.0), rel=0.05)


# Lost or disputed: which matches are used, and what a position begins from.


@pytest.mark.parametrize(("further_m", "expected_m"), [(0.0, 2.0), (80.0, 0.0)])
def test_a_lost_position_goes_on_only_where_the_next_match_agrees(
    road: Road, further_m: float, expected_m: float
) -> None:
    """A vehicle 2 m beside the map's drive, which only GPS has shown; then 60 m without a match."""
    one = bounded_beside(road)
    one.go(60)
    one.go(60, nothing)
    assert one.place is None
    one.go(6, shown(road, further_m))
    assert north_m(one.place) == pytest.approx(one.north_m + further_m, abs=1.0)
    assert left_m(one.place) == pytest.approx(expected_m, abs=0.7)


@pytest.mark.parametrize(("meters", "stays"), [(40, False), (80, True)])
def test_matches_elsewhere_than_reckoning_are_disputed_until_they_have_agreed_for_long(
    road: Road, meters: float, stays: bool
) -> None:
    """A track that is lost before that is nothing from which the next one could begin."""
    one, disputed = warm(road, north_m=40.0), []
    one.go(60, nothing)
    for _ in range(round(meters / SPACING_M)):
        one.go(2, shown(road, 120.0))
        disputed.append(one.place is None or one.place.disputed)
    assert all(disputed[:29])
    assert disputed[-1] is not stays
    one.go(60, nothing)
    one.go(6)
    assert north_m(one.place) == pytest.approx(one.north_m, abs=1.0)
    assert placed(one).disputed is stays


def test_far_beside_the_road_no_match_corrects_a_position(road: Road) -> None:
    """By its own reckoning the vehicle goes 26 m to the side."""
    config = settings(RigConfig(sigma_cross_track_m=4.0), lost_after_m=1000.0, lost_after_s=60.0)
    one = warm(road, config)
    one.sideways_m = 1.3
    one.go(40, nothing)
    one.sideways_m = 0.0
    one.go(LINE_M, nothing)
    one.go(8)
    later = one.place_at()
    assert left_m(later) == pytest.approx(-26.0, abs=1.0)
    assert later is not None and later.matches == 30, "none has agreed since"


def bounded_beside(road: Road) -> Vehicle:
    """A vehicle 2 m beside where the map expects it, as only GPS has said."""
    one = Vehicle(road, settings(RigConfig(sigma_cross_track_m=4.0)), 80.0)
    one.go(LINE_M - 2, nothing)
    one.move()
    where = replace(one.position, lon_deg=one.position.lon_deg - 2.0 / 99_255)
    one.own(position=where, gps_sigma_m=1.0)
    one.show(None)
    return one


def test_the_first_match_without_gps_corrects_a_position_that_gps_bounded(road: Road) -> None:
    with_gps, without = bounded_beside(road), warm(road, settings(RigConfig(sigma_cross_track_m=4.0)), 80.0, meters=0)
    for one, expected_m in ((with_gps, 2.0), (without, 0.0)):
        one.go(6)
        assert left_m(one.place) == pytest.approx(expected_m, abs=0.5)


def test_false_matches_a_kilometer_away_do_not_move_where_gps_had_the_vehicle(road: Road) -> None:
    """So far away, local meters get another origin."""
    one = bounded_beside(road)
    one.go(6, shown(road, 1060.0))
    assert placed(one).disputed
    assert north_m(one.place) == pytest.approx(one.north_m + 1060.0, abs=1.0)
    one.go(60, nothing)
    one.go(6)
    assert not placed(one).disputed
    assert left_m(one.place) == pytest.approx(2.0, abs=0.5)


def test_gps_that_disagrees_with_the_matches_begins_no_track(road: Road) -> None:
    one = Vehicle(road, north_m=80.0)
    one.off_m = 120.0
    one.go(LINE_M, nothing, gps=True)
    one.go(6)
    assert north_m(one.place) == pytest.approx(one.north_m, abs=0.05)


def test_a_wrong_scale_is_found_and_disputes_nothing(road: Road) -> None:
    """The odometer reads 8 % too little."""
    one = Vehicle(road, north_m=20.0)
    one.odometer = 0.92
    one.go(2 * LINE_M, nothing)
    one.go(260)
    assert north_m(one.place) == pytest.approx(one.north_m, abs=2.0)
    assert placed(one).velocity_error == pytest.approx(0.087, abs=0.03)
    assert not placed(one).disputed


def test_one_false_match_changes_nothing(road: Road) -> None:
    one = warm(road)
    one.go(2, lambda at_m: road.match(1200.0))
    one.go(4)
    assert north_m(one.place) == pytest.approx(one.north_m, abs=0.05)
    assert placed(one).matches == 32


def test_matches_that_disagree_in_a_row_dispute_the_position(road: Road) -> None:
    """By [tracking] lost_after_m another one begins where they are, and is disputed for a correlation length."""
    one, disputed = warm(road), []
    for _ in range(44):
        one.go(2, shown(road, 1040.0))
        disputed.append(placed(one).disputed)
    assert disputed.index(True) in (1, 2)
    assert disputed.index(False, 2) * SPACING_M == pytest.approx(70.0, abs=14.0)
    assert north_m(one.place) == pytest.approx(one.north_m + 1040.0, abs=0.1)
    assert placed(one).matches < 45


@pytest.mark.parametrize("unseen", [{}, {"accepted": False}])
def test_off_the_map_it_is_lost_after_some_meters(road: Road, unseen: dict[str, Any]) -> None:
    sees: Callable[[float], PlaceMatch | None] = shown(road, **unseen) if unseen else nothing
    one = warm(road)
    one.go(20, sees)
    assert one.place is not None
    one.go(2, sees)
    assert one.place is None
    assert one.place_at() is None


def test_it_is_lost_after_a_silence_and_not_moved_on_further_than_it_may_go_unseen(road: Road) -> None:
    """A camera that stalls leaves the odometer running."""
    one = warm(road, settings(lost_after_s=2.0))
    assert one.place_at(2 * S) is not None and one.place_at(2 * S + 1) is None
    assert one.place_at(S, 19.9) is not None and one.place_at(S, 20.1) is None


def test_an_odometer_that_counts_anew_begins_a_new_track(road: Road) -> None:
    one = warm(road)
    one.motion = one.moved(odometry_epoch=2)
    one.go(2)
    assert one.place is None


@pytest.mark.parametrize(("further_m", "agrees"), [(6.0, True), (10.0, False)])
def test_a_match_beyond_three_sigma_of_the_estimate_corrects_nothing(
    road: Road, further_m: float, agrees: bool
) -> None:
    """A match alone is known to 3 m."""
    one = warm(road)
    one.go(2, shown(road, further_m))
    later = one.place_at()
    assert later is not None and (later.matches == 31) == agrees


def test_a_hypothesis_is_run_while_its_question_is_asked_and_as_long_as_beginnings_are_kept() -> None:
    """40 s with GPS, and 40 s without it. Of those asked for only with GPS one creeps, of the others one of three."""
    bank, counts = FilterBank(Filter(0.03, 0.06)), []
    for second in range(80):
        bank.judge(float(second), has_gps=second < 40)
        counts.append(len(bank.names))
    always = 1 + 2 + BEGUN  # right, two that jump, one that creeps
    assert counts[39] == always + 1 + BEGUN and counts[-1] == always + 2 + BEGUN
    assert counts[55] == always + 3 + 2 * BEGUN, "a GPS that comes and goes begins none anew"
