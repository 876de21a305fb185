"""Which part of a position is sent: along the way and across it, the better of it and the autopilot's own."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.journal.records import PlaceFix
from edge.localization import AGREE_SIGMAS, AutopilotState, Fix, ProtectionLevel
from edge.localization.autopilot_covariance import AutopilotCovariance, Drift, PropagatedCovariance
from edge.localization.integrity import BESIDE_M, GROWS, OFF_SIGMAS, FixCandidate, better_of, is_correction
from tests.common import S
from tests.localization.events_of import Road, Vehicle
from tests.localization.route_course import HOME, Stretch

FIX = PlaceFix(
    S, 1, *HOME, 90.0, sigma_along_m=4.0, sigma_cross_track_m=3.0, direction="forward", order="same", uniqueness=1.2
)


def own(east_m: float, north_m: float, *, drives_itself: bool | None = None) -> AutopilotState:
    lat_deg, lon_deg = moved(*HOME, east_m, north_m)
    return AutopilotState(
        position=VehiclePosition(S, lat_deg, lon_deg, 0.0, None, 0.0, 0.0, 0.0), drives_itself=drives_itself
    )


def placed(place: PlaceFix) -> tuple[float, float]:
    assert place.lat_deg is not None and place.lon_deg is not None
    return east_north_of(place.lat_deg, place.lon_deg, HOME)


@pytest.mark.parametrize(
    ("axes_m", "by_lane", "keeps", "place_m"),
    [
        ((9.0, 9.0), False, (False, False), (0.0, 0.0)),
        ((9.0, 1.0), False, (False, True), (0.0, 5.0)),
        ((1.0, 9.0), False, (True, False), (7.0, 0.0)),
        ((9.0, 0.99 * BESIDE_M), True, (False, True), (0.0, 5.0)),
        ((9.0, 1.01 * BESIDE_M), True, (False, False), (0.0, 0.0)),
    ],
)
def test_in_each_direction_the_better_of_both_is_sent(
    axes_m: tuple[float, float], by_lane: bool, keeps: tuple[bool, bool], place_m: tuple[float, float]
) -> None:
    """The road leads east; the autopilot has the vehicle 7 m further along it and 5 m to the left."""
    found = better_of(replace(FIX, by_lane=by_lane), own(7.0, 5.0), axes_m, by_gps=False)
    assert found is not None and found.held_axes == keeps
    assert placed(found.place) == pytest.approx(place_m, abs=0.01)
    sigmas_m = found.place.sigma_along_m, found.place.sigma_cross_track_m
    expected_m = [one_m if keep else fix_m for one_m, keep, fix_m in zip(axes_m, keeps, (4.0, 3.0), strict=True)]
    assert sigmas_m == pytest.approx(expected_m, abs=0.01)


def test_an_autopilot_that_steers_itself_keeps_its_own_across_where_only_the_lane_says_otherwise() -> None:
    """Its own position is on the lane anyway; where regions have measured, or a person steers, the position counts."""
    far_m = 9.0, 3.0 * BESIDE_M
    for by_lane, drives_itself, keeps in [(True, True, True), (False, True, False), (True, False, False)]:
        found = better_of(replace(FIX, by_lane=by_lane), own(7.0, 5.0, drives_itself=drives_itself), far_m, by_gps=True)
        assert found is not None and found.held_axes == (False, keeps)


def test_a_position_that_is_better_in_neither_direction_is_none() -> None:
    """One after another may be less certain by a fifth; one after GPS may not."""
    barely_m = 4.0 / (0.99 * GROWS), 3.0 / (0.99 * GROWS)
    assert better_of(FIX, own(0.0, 0.0), barely_m, by_gps=False) is not None
    assert better_of(FIX, own(0.0, 0.0), barely_m, by_gps=True) is None


@pytest.mark.parametrize(("axes_m", "is_kept"), [((3.0, 1.0), False), ((9.0, 1.0), True)])
def test_nothing_is_kept_of_an_autopilot_that_a_certain_position_contradicts(
    axes_m: tuple[float, float], is_kept: bool
) -> None:
    """20 m along, as after a GPS that was dragged and then jammed: what bounds it is wrong, in both directions."""
    found = better_of(FIX, own(20.0, 0.0), axes_m, by_gps=True)
    assert found is not None and found.held_axes == (False, is_kept)


@pytest.mark.parametrize("far_m", [0.99, 1.01])
@pytest.mark.parametrize("by_lane", [False, True])
@pytest.mark.parametrize("sigma_m", [0.5, 4.0])
def test_a_reset_corrects_an_autopilot_that_is_beyond_doubt_off(far_m: float, sigma_m: float, by_lane: bool) -> None:
    """Along the road, which leads east; in the other direction the position is the autopilot's own."""
    times = AGREE_SIGMAS if by_lane else OFF_SIGMAS
    off_m, fix = far_m * max(3.0, times * sigma_m), replace(FIX, sigma_along_m=sigma_m, by_lane=by_lane)
    for keeps, is_needed in (((False, False), far_m > 1), ((False, True), far_m > 1), ((True, False), False)):
        assert is_correction(FixCandidate(fix, keeps), own(-off_m, 0.0), 3.0) is is_needed


@pytest.mark.parametrize(("left_m", "along_m"), [(3.0, 4.0), (6.0, 6.0)])
def test_a_position_bounds_the_autopilot_in_the_directions_that_it_measures(left_m: float, along_m: float) -> None:
    """Whether it was sent, or the autopilot agrees with it: by as much as they differ, and at least its own sigma."""
    bound, reported = AutopilotCovariance(drift=0.05), AutopilotState(driven_m=0.0)
    bound.bind(10.0, reported)
    bound.bind_by_fix(Fix(FIX, ProtectionLevel(math.inf, math.inf), held_axes=(False, True)), left_m, reported)
    assert bound.axes_m(reported, FIX, 0.0) == pytest.approx((along_m, 10.0))


def test_what_is_kept_grows_with_the_distance_and_not_with_its_root() -> None:
    """A hundred positions in a row that keep the autopilot's own across, on the way to the east."""
    fix = Fix(FIX, ProtectionLevel(math.inf, math.inf), held_axes=(False, True))
    for drift, share in ((Drift(0.0, 0.0, 0.04), 0.04), (Drift(0.01, 0.02, 0.0), 0.02)):
        errors = PropagatedCovariance(9.0 * np.eye(2))
        for _ in range(100):
            errors = errors.moved(8.0, 0.0, 8.0, 0.0).bound_by(fix, 0.0)
        cross_track_m = math.hypot(3.0, share * 800.0)
        assert errors.along_and_across_m(90.0, drift) == pytest.approx((4.0, cross_track_m))
        assert errors.along_and_across_m(0.0, drift) == pytest.approx((cross_track_m, 4.0)), "after a bend"


def test_an_error_of_the_scale_is_along_the_way_and_one_of_the_heading_across() -> None:
    """To the east, and then to the north as far."""
    errors, shown = PropagatedCovariance(np.zeros((2, 2))), Drift(0.03, 0.01, 0.0)
    errors = errors.moved(100.0, 0.0, 100.0, 0.0)
    assert errors.along_and_across_m(90.0, shown) == pytest.approx((3.0, 1.0))
    errors = errors.moved(0.0, 100.0, 100.0, 0.0)
    assert errors.along_and_across_m(45.0, shown) == pytest.approx((3.0 * math.sqrt(2), math.sqrt(2)))
    assert errors.moved(-100.0, -100.0, 141.4, 0.0).along_and_across_m(0.0, shown) == pytest.approx((0.0, 0.0))


def test_where_only_the_lane_says_how_far_across_the_autopilots_own_across_is_sent(tmp_path: Path) -> None:
    """Without a look: the lane would make every position say that the vehicle is on it."""
    one = Vehicle(Road(tmp_path, Stretch(0.0, 1200.0)))
    one.go(150, gps=True)
    one.go(100)
    one.off_m = 12.0
    one.own()
    answer = one.ask(is_reset=True)
    assert isinstance(answer, Fix) and answer.held_axes == (False, True)
    assert answer.place.by_lane and answer.place.sigma_cross_track_m > answer.place.sigma_along_m
