"""What is known of the autopilot's own position, and of GPS: what bounds it, and for how long."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from msgspec import convert, structs, to_builtins

from edge.config import GatesConfig
from edge.geodesy import east_north_of
from edge.localization import (
    Discontinuity,
    Fix,
    FixFeedback,
    FixRequest,
    ImageProcessed,
    MapUpdate,
    Odometry,
    ProtectionLevel,
    ScaleFactor,
)
from edge.localization.position_estimator import EstimatorState
from edge.sequence import PlaceMatch
from tests.localization.events_of import LENGTH, Road, Vehicle, nothing, settings
from tests.localization.route_course import HOME, SPACING_M, Stretch


def known(one: Vehicle, **own: Any) -> EstimatorState:
    """After what the autopilot reports."""
    one.own(**own)
    return one.drive.state


def test_uncertainty_grows_with_the_distance_since_it_was_bound(road: Road) -> None:
    one = Vehicle(road)
    assert not known(one).is_bounded and known(one).own_sigma_m is None
    assert known(one, gps_sigma_m=3.0, driven_m=100.0).own_sigma_m == 3.0
    assert known(one, driven_m=180.0).own_sigma_m == pytest.approx(5.0)
    assert known(one, driven_m=180.0, accuracy_m=9.0).own_sigma_m == 9.0, "the larger one"
    assert known(one, driven_m=None).own_sigma_m is None


def test_it_grows_by_what_the_velocity_was_found_wrong_by(road: Road) -> None:
    one = Vehicle(road)
    one.go(60, gps=True)
    one.odometer = 0.9
    one.go(240)
    one.off_m = -24.0  # as its odometer says
    one.own()
    assert one.place is not None and one.place.velocity_error > 0.07
    assert one.drive.state.own_sigma_m == pytest.approx(math.hypot(3.0, one.place.velocity_error * 216.0), abs=0.01)


def shown(road: Road, **changes: Any) -> tuple[Vehicle, float]:
    """A vehicle that has lost GPS 100 m ago, which had shown its odometer; and the uncertainty of its position."""
    one = Vehicle(road)
    one.go(60, gps=True)
    one.reports = {"scale": ScaleFactor(0.0, 0.02), **changes}
    one.go(100, lambda _: None)
    own_sigma_m = one.drive.state.own_sigma_m
    assert own_sigma_m is not None
    return one, own_sigma_m


def test_the_uncertainty_grows_by_what_gps_has_shown_of_the_odometer(road: Road) -> None:
    """And only where GPS is lost, not where it has just gone."""
    assert math.hypot(3.0, 0.01 * 100.0) < shown(road)[1] < math.hypot(3.0, 0.03 * 100.0)
    assert shown(road, scale=None)[1] == shown(road, gps="unknown")[1] == pytest.approx(math.hypot(3.0, 5.0))


@pytest.mark.parametrize(("mean", "expected"), [(0.05, math.radians(2.0)), (0.12, 0.1)])
def test_wheels_are_as_wrong_as_usual_unless_gps_contradicts_that(mean: float, expected: float, road: Road) -> None:
    """Of 5 % that GPS shows to 3 %, half is its own error, and the heading's is more; of 12 %, nearly all is theirs."""
    assert shown(road, scale=ScaleFactor(mean, 0.03))[1] == pytest.approx(math.hypot(3.0, expected * 100.0), rel=0.1)


def test_a_wheel_that_spins_takes_back_what_was_shown(road: Road) -> None:
    one, _ = shown(road)
    one.motion = structs.replace(one.motion, doubtful_north_m=1.0)
    one.go(2, lambda _: None)
    assert one.drive.state.own_sigma_m == pytest.approx(math.hypot(3.0, 0.05 * 102.0))


@pytest.mark.parametrize(("further_m", "holds"), [(2.0, True), (40.0, False)])
def test_places_elsewhere_than_expected_take_back_what_was_shown(further_m: float, holds: bool, road: Road) -> None:
    """40 m after 240 m: too many for an odometer as it was shown."""
    one, _ = shown(road)
    one.go(100, nothing)
    one.go(60, lambda at_m: one.road.match(at_m + further_m))
    assert one.drive.state.own_sigma_m is not None
    assert (one.drive.state.own_sigma_m < math.hypot(3.0, 0.05 * 260.0)) == holds


def test_what_was_shown_outlives_a_time_of_which_no_match_counts(road: Road) -> None:
    """As after turning around, where the estimate begins anew."""
    sigmas = []
    for has_shown in (True, False):
        one, _ = shown(road, **({} if has_shown else {"scale": None}))
        one.drive.update(one.t_ns, Discontinuity("blind"))
        one.go(60)
        assert one.place is not None
        sigmas.append(one.place.sigma_along_m)
    assert sigmas[0] < sigmas[1]


def test_a_position_that_has_run_away_is_as_uncertain_as_it_is_far_off(road: Road) -> None:
    one = Vehicle(road)
    reports: list[dict[str, Any]] = [{"gps_sigma_m": 3.0}, {"is_aided": False}]
    assert [known(one, **own).own_sigma_m for own in reports] == [3.0, None]
    one.off_m = 50.0
    assert known(one).own_sigma_m == pytest.approx(math.hypot(3.0, 50.0), abs=0.1)


def test_an_autopilot_is_as_uncertain_as_it_is_far_from_the_position_that_was_sent(road: Road) -> None:
    one = Vehicle(road, settings(gates=GatesConfig(risk=1.0)))
    one.go(100)
    fix = one.ask()
    assert isinstance(fix, Fix)
    assert not one.drive.state.is_bounded and not one.drive.state.rests_on_fixes
    one.use(fix)
    sigma_m = max(fix.place.sigma_along_m, fix.place.sigma_cross_track_m)
    assert one.drive.state.own_sigma_m == pytest.approx(sigma_m, abs=0.1) and one.drive.state.rests_on_fixes
    one.off_m = 40.0
    assert known(one).own_sigma_m == pytest.approx(math.hypot(sigma_m, 40.0), abs=1.0)
    assert known(one, is_aided=False).own_sigma_m is None, "of one that nothing aids, nobody knows"


def test_a_position_that_was_sent_is_in_the_autopilots_own_for_10_s_of_gps(road: Road) -> None:
    """A filter that weighs both forgets ours only gradually; until then its position is no evidence for a map."""
    one, rests = Vehicle(road, settings(gates=GatesConfig(risk=1.0))), []
    one.go(100)
    fix = one.ask()
    assert isinstance(fix, Fix)
    one.use(fix)
    for _ in range(2):
        one.go(80, gps=True)
        rests.append(one.drive.state.rests_on_fixes)
    assert rests == [True, False], "after 8 and 16 s"


def test_after_a_reboot_nothing_bounds_the_autopilot_and_gps_had_the_vehicle_where_it_was(road: Road) -> None:
    one = Vehicle(road)
    one.go(100, gps=True)
    one.drive.update(one.t_ns, Discontinuity("reboot"))
    assert one.drive.state.own_sigma_m is None and not one.drive.state.is_bounded
    one.off_m = -100.0  # at its origin
    assert one.go(20)[-1] is None, "a place is confirmed by where GPS had the vehicle, moved on by its velocity"


@pytest.mark.parametrize("kind", ["blind", "carried"])
def test_no_position_rests_on_frames_from_before_a_blindness(kind: Any, road: Road) -> None:
    one = Vehicle(road)
    one.go(250, gps=True)
    one.drive.update(one.t_ns, Discontinuity(kind))
    assert one.place is None and one.drive.state.gps.state == "consistent" and one.drive.state.is_bounded
    reasons = one.go(2 * LENGTH + 2)
    assert reasons.index(None) == LENGTH - 1, "a line of new frames"


def test_maps_that_grow_change_nothing_and_others_begin_anew(road: Road) -> None:
    one = Vehicle(road)
    one.go(250, gps=True)
    place = one.place
    one.drive.update(one.t_ns, MapUpdate(road.maps, has_grown=True))
    assert place is not None and one.place == place
    one.drive.update(one.t_ns, MapUpdate(road.maps))
    assert one.place is None and one.drive.state.gps.state == "consistent"


def test_a_match_that_turns_where_the_vehicle_goes_on_says_nothing_of_gps(road: Road) -> None:
    """A drive that turned round is in the map; matches follow it back for a while, and GPS goes on with the vehicle."""
    one, turns_m, states = Vehicle(road), 220.0, []
    one.frame = {}
    one.go(turns_m, gps=True)
    assert one.drive.state.gps.state == "consistent"
    for _ in range(40):
        one.go(2, lambda at_m: one.road.match(2 * turns_m - at_m, "reverse"), gps=True)
        states.append(one.drive.state.gps.state)
    assert not {"map faulty", "faulty"} & set(states)


@pytest.mark.parametrize("acts", ["report", "send"])
def test_the_error_of_a_gps_that_is_wrong_is_not_believed_of_the_autopilot_that_followed_it(
    acts: Any, road: Road
) -> None:
    """It is spoofed 40 m off; the places have the vehicle where it is, and bound the autopilot where GPS is ignored."""
    one = Vehicle(road, settings(gates=GatesConfig(doubted_gps=acts)))
    one.go(140, gps=True)
    while one.drive.state.gps.state != "faulty":
        one.off_m += 1.0
        one.go(2, gps=True)
    verdict, ignores = one.drive.state.gps, acts == "send"
    assert verdict.off_m is not None and verdict.off_m[1] == pytest.approx(one.off_m, abs=12.0)
    assert one.drive.state.ignores_gps is ignores
    answer = one.answers(2, gps=True)[0]
    assert isinstance(answer, Fix) is ignores


@pytest.mark.parametrize(("confidence", "off_m", "waits_m"), [(0.93, 40.0, 60.0), (0.93, 0.0, 60.0), (0.999, 0.0, 0.0)])
def test_after_a_long_way_without_places_a_doubtful_one_waits_for_others(
    confidence: float, off_m: float, waits_m: float, tmp_path: Path
) -> None:
    """Reckoning agrees with any place within 90 m by then; one that is hardly believed waits for 60 m of others."""
    road = Road(tmp_path, Stretch(0.0, 200.0), Stretch(700.0, 1000.0))
    one = Vehicle(road)
    one.go(150.0, gps=True)
    one.go(580.0, lambda at_m: road.match(at_m) if at_m <= 190.0 else None)
    reasons = one.go(200.0, lambda at_m: road.match(at_m + off_m, confidence=confidence))
    assert reasons.count("the innovation test fails") * SPACING_M == waits_m
    assert reasons[-1] is None


def reckoned_m(one: Vehicle) -> tuple[float, float] | None:
    """Meters north of HOME that GPS and motion alone have the vehicle, and one standard deviation."""
    found = one.drive.dead_reckoning_position(one.motion)
    return None if found is None else (east_north_of(found.lat_deg, found.lon_deg, HOME)[1], found.sigma_m)


@pytest.mark.parametrize(("kind", "is_reckoned"), [("blind", True), ("carried", False)])
def test_nothing_is_reckoned_of_a_vehicle_that_was_carried_until_gps_has_it_again(
    kind: Any, is_reckoned: bool, road: Road
) -> None:
    one = Vehicle(road)
    one.go(20, gps=True)
    one.go(10, gps=False)
    one.drive.update(one.t_ns, Discontinuity(kind))
    one.go(2, gps=False)
    assert (reckoned_m(one) is not None) == is_reckoned
    one.go(2, gps=True)
    assert reckoned_m(one) is not None


def test_the_vehicle_is_reckoned_by_gps_and_its_motion_and_by_no_place(road: Road) -> None:
    one = Vehicle(road, settings(gates=GatesConfig(risk=1.0)))
    assert reckoned_m(one) is None
    one.go(100, gps=True)
    assert reckoned_m(one) == pytest.approx((100.0, 3.0), abs=0.01)
    one.off_m = 30.0  # a position of ours moves the autopilot by so much, and bounds it
    one.go(80)
    fix = one.ask()
    assert isinstance(fix, Fix)
    one.use(fix)
    assert reckoned_m(one) == pytest.approx((180.0, 5.0), abs=0.3)
    one.own(has_gps=True)
    assert reckoned_m(one) == pytest.approx((180.0, 5.0), abs=0.3), "what is left of ours may be in it"
    one.own(is_aided=False)
    assert reckoned_m(one) is None, "its velocity runs away"


def test_nothing_is_reckoned_by_a_gps_that_places_speak_against(road: Road) -> None:
    one = Vehicle(road)
    one.go(140, gps=True)
    while one.drive.state.gps.state not in ("suspect", "inconsistent", "faulty"):
        one.off_m += 1.0
        one.go(2, gps=True)
        assert one.off_m < 60.0
    one.go(2, gps=True)
    assert reckoned_m(one) is None
    one.go(20)
    assert reckoned_m(one) is None, "nor once it is lost"


def by_gps_alone(match: PlaceMatch | None) -> PlaceMatch | None:
    """A place that is believed because the vehicle is reckoned there, to which the votes alone give even odds."""
    assert match is not None
    return replace(match, confidence=0.95, by_votes=replace(match, confidence=0.5, accepted=False))


def test_a_place_that_gps_helped_to_believe_is_no_evidence_and_does_not_vouch_for_gps(road: Road) -> None:
    one = Vehicle(road)
    reasons = one.go(250, lambda at_m: by_gps_alone(road.match(at_m)), gps=True)
    assert one.place is not None, "but the vehicle is followed"
    assert one.drive.state.gps.state == "cannot say"
    reasons = one.go(100, lambda at_m: by_gps_alone(road.match(at_m)))
    assert None not in reasons
    assert None in one.go(100)


def test_gps_is_judged_by_what_the_votes_alone_say_of_another_place(road: Road) -> None:
    """GPS that is spoofed ahead makes the places there more probable; the pictures show where the vehicle is."""
    one = Vehicle(road)
    one.go(140, gps=True)

    def by_gps(at_m: float) -> PlaceMatch | None:
        ahead = road.match(at_m + 60.0)
        return ahead and replace(ahead, accepted=False, by_votes=road.match(at_m))

    for _ in range(60):
        one.off_m += 1.0
        one.go(2, by_gps, gps=True)
    assert one.drive.state.gps.state == "faulty"


def test_the_list_of_a_drive_has_the_words_of_earlier_versions() -> None:
    """So that theirs are read, and ours by them."""
    assert {"type": "Frame", "undated_s": 0.5}.items() <= to_builtins(ImageProcessed(0, timestamp_sigma_s=0.5)).items()
    assert to_builtins(Odometry(3, 1.0, 2.0))["leg"] == 3
    assert to_builtins(ProtectionLevel(1.0, 2.0)) == {"along_m": 1.0, "across_m": 2.0}
    assert to_builtins(FixFeedback(None)) == {"type": "Used", "fix": None}
    assert convert({"type": "Limits", "at": "now"}, FixRequest).at == "now"
