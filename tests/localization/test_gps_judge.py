"""A vehicle that GPS keeps on the map's drive, and that is not recognized there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from edge.localization.report import Report

from edge.config import RigConfig
from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.localization import GpsFix, GpsVerdict
from edge.localization.gps_judge import FIRM, UNSEEN_M, GpsJudge, UnseenRoad
from edge.localization.position_estimator import PositionEstimator
from edge.reference_map import MapSet, Route
from edge.sequence import PlaceMatch
from tests.localization.straight_road import LAT_DEG, SPACING_M, match, settings

FROM, FRAMES = 100, round(1.2 * UNSEEN_M / SPACING_M)
"""The first place that is not recognized, and how many frames follow."""


def gps_at(north_m: float, east_m: float = 0.0) -> GpsFix:
    return GpsFix(*moved(LAT_DEG, 153.0, east_m, north_m), 3.0)


def seen(place: int, **changes: Any) -> PlaceMatch:
    return match(place, **{"confidence": 0.999, **changes})


def unseen(place: int, **changes: Any) -> PlaceMatch:
    return match(place, **{"confidence": 0.1, "accepted": False, **changes})


def recognized(route: Route, to: int = FROM, **changes: Any) -> UnseenRoad:
    """After 80 m of the drive on which each place was recognized; no rig is configured, so places are where it is."""
    one = UnseenRoad(route, RigConfig())
    assert not any(one.update(seen(place, **changes), gps_at(place * SPACING_M)) for place in range(to - 40, to))
    return one


def warned_m(one: UnseenRoad, gps: Callable[[int], GpsFix | None], **changes: Any) -> float | None:
    """Meters driven after the last recognized place until it says so, None if it never does."""
    for frame in range(FRAMES):
        if one.update(unseen(FROM + frame, **changes), gps(frame)):
            return (frame + 1) * SPACING_M
    return None


def on_the_road(frame: int) -> GpsFix:
    return gps_at((FROM + frame) * SPACING_M)


def test_what_is_not_recognized_on_the_map_s_drive_is_said(route: Route) -> None:
    assert warned_m(recognized(route), on_the_road) == pytest.approx(UNSEEN_M, abs=SPACING_M)


def test_gps_beside_its_lane_by_its_usual_error_is_on_the_road(route: Route) -> None:
    assert warned_m(recognized(route), lambda frame: gps_at((FROM + frame) * SPACING_M, 5.0)) is not None


def test_it_ends_where_a_place_is_recognized_again(route: Route) -> None:
    one = recognized(route)
    assert warned_m(one, on_the_road) is not None
    assert not one.update(seen(FROM + FRAMES), gps_at((FROM + FRAMES) * SPACING_M))


@pytest.mark.parametrize(
    "gps",
    [
        pytest.param(lambda frame: gps_at((FROM + frame) * SPACING_M, 2.0 * frame), id="turns off"),
        pytest.param(lambda frame: gps_at((FROM + frame) * SPACING_M, 10.0), id="beside the road"),  # by 2.5 sigmas
        pytest.param(lambda frame: gps_at((FROM + frame) * SPACING_M, 30.0), id="another road"),
        pytest.param(lambda frame: gps_at((FROM - frame) * SPACING_M), id="comes back"),
        pytest.param(lambda frame: gps_at(FROM * SPACING_M), id="creeps"),
        pytest.param(lambda frame: None, id="no GPS"),
        pytest.param(lambda frame: gps_at((FROM + frame // 20 * 20) * SPACING_M), id="few frames"),
    ],
)
def test_an_honest_gps_that_does_not_go_on_along_the_drive_is_not_warned_of(
    route: Route, gps: Callable[[int], GpsFix | None]
) -> None:
    assert warned_m(recognized(route), gps) is None


def test_nothing_is_said_beyond_the_end_of_the_map(route: Route) -> None:
    one, end = recognized(route, 195), 200
    for place in range(195, end + FRAMES):
        assert not one.update(unseen(min(place, end - 1)), gps_at(place * SPACING_M))


def test_a_short_stretch_that_is_not_recognized_is_no_warning(route: Route) -> None:
    one, most = recognized(route), round(0.8 * UNSEEN_M / SPACING_M)
    for frame in range(FRAMES):
        answer = seen(FROM + frame) if frame % most == most - 1 else unseen(FROM + frame)
        assert not one.update(answer, on_the_road(frame))


def test_nothing_is_said_after_a_recognition_that_was_not_firm(route: Route) -> None:
    assert warned_m(recognized(route, confidence=FIRM - 0.02), on_the_road) is None


@pytest.mark.parametrize(("weak", "is_warned"), [(5, True), (40, False)])
def test_a_recognition_stays_firm_through_a_few_weak_frames(route: Route, weak: int, is_warned: bool) -> None:
    one = recognized(route, FROM - weak)
    for place in range(FROM - weak, FROM):
        one.update(seen(place, confidence=0.94), gps_at(place * SPACING_M))
    assert (warned_m(one, on_the_road) is not None) == is_warned


def test_one_weak_frame_does_not_hide_what_was_not_recognized(route: Route) -> None:
    one, gap = recognized(route, FROM - 36), 35
    for place in range(FROM - 36, FROM - 36 + gap):
        one.update(unseen(place), gps_at(place * SPACING_M))
    one.update(seen(FROM - 1, confidence=0.94), gps_at((FROM - 1) * SPACING_M))
    left_m = UNSEEN_M - (gap - 1) * SPACING_M
    assert warned_m(one, on_the_road) == pytest.approx(left_m, abs=2 * SPACING_M)


def test_one_firm_frame_ends_what_was_not_recognized(route: Route) -> None:
    one = recognized(route, FROM - 36)
    for place in range(FROM - 36, FROM - 1):
        one.update(unseen(place), gps_at(place * SPACING_M))
    one.update(seen(FROM - 1), gps_at((FROM - 1) * SPACING_M))
    assert warned_m(one, on_the_road) is None


@pytest.mark.parametrize("doubt", [0.5, 1.0])
def test_where_gps_was_doubtful_less_must_be_unrecognized(route: Route, doubt: float) -> None:
    one = recognized(route, FROM - 40)
    for place in range(FROM - 40, FROM):
        assert not one.update(seen(place, confidence=0.94), gps_at(place * SPACING_M), doubt)
    assert warned_m(one, on_the_road) == pytest.approx((1 - doubt / 2) * UNSEEN_M, abs=SPACING_M)


def test_a_sequence_that_begins_anew_is_not_unrecognized(route: Route) -> None:
    one = recognized(route)
    one.update(None, gps_at(FROM * SPACING_M))
    assert warned_m(one, on_the_road) is None


def test_it_is_a_state_of_the_verdict_and_the_position_stays_as_it_is(map_set: MapSet) -> None:
    estimator = PositionEstimator(settings(RigConfig()))
    estimator.use_maps(map_set)

    def verdict(answer: PlaceMatch, place: int) -> str:
        return estimator.update(answer, 0, None, Report(0), gps_at(place * SPACING_M)).state

    states = [verdict(seen(place) if place < FROM else unseen(place), place) for place in range(20, FROM + FRAMES)]
    assert states[FROM - 21] == "agrees"
    assert states[-1] == "not recognized"
    estimator.reset()
    assert verdict(unseen(FROM), FROM) != "not recognized"


def test_gps_that_was_called_wrong_stays_wrong_where_nothing_is_recognized(map_set: MapSet) -> None:
    judge = GpsJudge(settings(RigConfig()))
    judge.use_route(Route(map_set))

    def state(answer: PlaceMatch, gps: GpsFix) -> str:
        judge.update(answer, gps, None, Report(0), None, 0)
        return judge.verdict.state

    agreed = [state(seen(place), gps_at(place * SPACING_M)) for place in range(20, FROM - 20)]
    called = [state(seen(place), gps_at(place * SPACING_M, 200.0)) for place in range(FROM - 20, FROM)]
    after = [state(unseen(FROM + frame), on_the_road(frame)) for frame in range(FRAMES)]
    assert agreed[-1] == "agrees" and called[-1] == "wrong"
    assert set(after) == {"wrong"}


@pytest.mark.parametrize(("undated_m", "state"), [(0.0, "wrong"), (15.0, "agrees")])
def test_gps_is_not_called_wrong_for_pictures_whose_time_is_uncertain(
    map_set: MapSet, undated_m: float, state: str
) -> None:
    """Pictures that are 3 s late put a vehicle at 10 m/s 30 m behind where GPS has it."""
    judge = GpsJudge(settings(RigConfig(sigma_along_m=3.0)))
    judge.use_route(Route(map_set))
    for place in range(20, 140):
        ahead_m = 0.0 if place < 80 else 30.0
        judge.update(seen(place), gps_at(place * SPACING_M + ahead_m), None, Report(0), None, 0, undated_m)
    assert judge.verdict.state == state


def test_the_error_of_a_gps_that_is_wrong_is_not_believed_of_the_autopilot_that_followed_it() -> None:
    def report(east_m: float, north_m: float, gps_sigma_m: float | None = 3.0) -> Report:
        at = moved(LAT_DEG, 153.0, east_m, north_m)
        return Report(0, "healthy", gps_sigma_m, VehiclePosition(0, *at, 0.0, None, 0.0, 0.0, 0.0))

    def believed_m(judge: GpsJudge, reported: Report) -> tuple[float, float]:
        own = judge.believed(reported).position
        assert own is not None
        return east_north_of(own.lat_deg, own.lon_deg, (LAT_DEG, 153.0))

    judge = GpsJudge(settings(RigConfig()))
    judge.use(GpsVerdict("wrong", 30.0, -20.0, 1.0), report(30.0, -20.0))
    assert believed_m(judge, report(30.0, 80.0)) == pytest.approx((0.0, 100.0), abs=0.05)
    judge.bound()
    assert believed_m(judge, report(30.0, 80.0)) == pytest.approx((30.0, 80.0), abs=0.05), "a position has moved it"
