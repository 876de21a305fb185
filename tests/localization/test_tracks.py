"""Positions that are lost or disputed: which matches the route filter uses, and what it begins from."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from edge.config import RigConfig
from edge.geodesy import VehiclePosition
from edge.localization.route_filter import RouteFilter
from edge.sequence import PlaceMatch
from tests.localization.straight_road import (
    FRAME_NS,
    LAT_DEG,
    LENGTH,
    METRE_DEG,
    SPACING_M,
    Drive,
    S,
    beside_m,
    match,
    regions,
    warm,
)


def match_further(by: int, place: int) -> PlaceMatch:
    return match(place + by)


def test_a_lost_position_goes_on_only_where_the_next_match_agrees(open_filter: Callable[..., RouteFilter]) -> None:
    """A vehicle 2 m beside the map's drive, which only its regions have shown; then 60 m without a match."""
    for further, expected_m in ((0, 2.0), (40, 0.0)):
        drive = Drive(open_filter(RigConfig(parallax=2.4, sigma_across_m=4.0)), 40)
        drive.go(LENGTH, lambda _: None)
        drive.go(30, lambda place: match(place, order="same", parallax=regions(0.0, 2.0)))
        drive.go(30, lambda _: None)
        assert drive.filter.at_exposure() is None
        drive.go(1, partial(match_further, further))
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
    for _ in range(20):
        drive.east_m += 1.3
        drive.go(1, lambda _: None)
    drive.go(LENGTH, lambda _: None)
    drive.go(4, partial(match, order="same", parallax=regions(0.0, -21.0)))
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


def test_false_matches_a_kilometer_away_do_not_move_where_gps_had_the_vehicle(
    open_filter: Callable[..., RouteFilter],
) -> None:
    """So far away, local meters get another origin. This vehicle drives 2 m beside where the map expects it."""
    drive = Drive(open_filter(RigConfig(sigma_across_m=4.0)), 40)
    drive.go(LENGTH, lambda _: None)
    lat_deg = LAT_DEG + drive.place * SPACING_M * METRE_DEG
    drive.filter.bind(VehiclePosition(drive.stamp_ns, lat_deg, 153.0 - 2.0 / 99_255, 0.0, 0.0, 10.0), 1.0)
    drive.go(3, partial(match_further, 230))
    far = drive.filter.at_exposure()
    assert far is not None and far.disputed
    assert drive.north_m(far) == pytest.approx(1000 + (drive.place + 30) * SPACING_M, abs=1.0)
    drive.go(30, lambda _: None)
    drive.go(1)
    found = drive.filter.at_exposure()
    assert found is not None and not found.disputed
    assert beside_m(found) == pytest.approx(2.0, abs=0.5)


def test_gps_that_disagrees_with_the_matches_begins_no_track(open_filter: Callable[..., RouteFilter]) -> None:
    drive = Drive(open_filter(), 40)
    drive.go(LENGTH, lambda _: None)
    far = VehiclePosition(drive.stamp_ns, LAT_DEG + 200.0 * METRE_DEG, 153.0, 0.0, 0.0, 10.0)
    drive.filter.bind(far, 1.0)
    drive.go(3)
    assert drive.north_m(drive.filter.at_exposure()) == pytest.approx(drive.place * SPACING_M, abs=0.05)


def test_a_wrong_scale_is_found_and_disputes_nothing(open_filter: Callable[..., RouteFilter]) -> None:
    """The odometer reads 8 % too little."""
    drive = Drive(open_filter(), 10)
    drive.scale = 0.92
    drive.go(2 * LENGTH, lambda _: None)
    drive.go(130)
    fix = drive.filter.at_exposure()
    assert fix is not None
    assert drive.north_m(fix) == pytest.approx(drive.place * SPACING_M, abs=2.0)
    assert fix.velocity_error == pytest.approx(0.087, abs=0.03)
    assert not fix.disputed


def test_one_false_match_changes_nothing(open_filter: Callable[..., RouteFilter]) -> None:
    drive = warm(open_filter())
    drive.go(1, lambda _: match(300))
    drive.go(2)
    fix = drive.filter.at_exposure()
    assert drive.north_m(fix) == pytest.approx(drive.place * SPACING_M, abs=0.05)
    assert fix is not None
    assert fix.matches == 32


def test_matches_that_disagree_in_a_row_dispute_the_position(open_filter: Callable[..., RouteFilter]) -> None:
    """By [tracking] lost_after_m another one begins where they are, and is disputed for a correlation length."""
    drive, fixes = warm(open_filter(lost_after_m=20.0)), []
    for _ in range(44):
        drive.go(1, lambda place: match(place + 200 + 20))
        fix = drive.filter.at_exposure()
        assert fix is not None
        fixes.append(fix)
    disputed = [fix.disputed for fix in fixes]
    assert disputed.index(True) == 2
    assert disputed.index(False, 2) * SPACING_M == pytest.approx(20.0 + 60.0, abs=4.0)
    assert drive.north_m(fixes[-1]) == pytest.approx(1000.0 + (drive.place + 20) * SPACING_M, abs=0.1)
    assert fixes[-1].matches < 45


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


@pytest.mark.parametrize(("further", "agrees"), [(3, True), (5, False)])
def test_a_match_beyond_three_sigma_of_the_estimate_corrects_nothing(
    open_filter: Callable[..., RouteFilter], further: int, agrees: bool
) -> None:
    """Its place is 6 or 10 m ahead; a match alone is known to 3 m."""
    drive = warm(open_filter())
    drive.go(1, partial(match_further, further))
    later = drive.filter.at(drive.stamp_ns, drive.displacement())
    assert later is not None and (later.matches == 31) == agrees
