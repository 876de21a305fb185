"""Which positions are published: each rule, and the argument from the probability of being of another place.

All by what happens to a vehicle on a straight road to the north (`events_of`), and what is answered then.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.config import Config, GatesConfig, RigConfig
from edge.geodesy import VehiclePosition, moved
from edge.journal.records import PlaceFix
from edge.localization import AGREE_SIGMAS, AutopilotState, Discontinuity, Fix, FixRequest, NoFix
from edge.localization.decide import NOT_NEEDED, RULES
from edge.localization.integrity import UNNOTICED_M, distance_from, is_off, wrong_probability
from edge.sequence import KeyframeMatch, PlaceMatch
from tests.common import S
from tests.localization.events_of import Road, Vehicle, gps_at, north_m, nothing, settings
from tests.localization.route_course import HOME, SPACING_M, Stretch

MakeRoad = Callable[..., Road]
UNCONFIRMED, ALERT = "not confirmed by another place yet", "its protection level is above the alert limit"


def exact(**gates: Any) -> Config:
    """Of a rig and an odometer that are exact: what is not certain of a position, is so of the map."""
    return settings(
        RigConfig(sigma_along_m=0.1, sigma_cross_track_m=0.3), GatesConfig(**gates), scale_error_percent=0.5
    )


def part(begins_m: float, ends_m: float, off_m: float = 0.0, recording: str = "", **stated: Any) -> Stretch:
    """A stretch of the map whose positions are wrong by so many meters to the north, and known to 3 m."""
    return Stretch(begins_m, ends_m, 0.0, off_m, 3.0, recording=recording, **stated)


def since_gps(road: Road, meters: float = 20.0, **gates: Any) -> Vehicle:
    """A vehicle that had GPS for 80 m, and has none since."""
    return _since_gps(road, meters, **gates).copy()


@cache
def _since_gps(road: Road, meters: float, **gates: Any) -> Vehicle:
    one = Vehicle(road, exact(**gates))
    one.go(80, gps=True)
    one.go(meters)
    return one


def reason(answer: Fix | NoFix) -> str | None:
    return answer.reason if isinstance(answer, NoFix) else None


def first_m(reasons: list[str | None]) -> float:
    """Meters until the first position."""
    return 2.0 * reasons.index(None) + 2.0


def reported(**own: Any) -> Callable[[Vehicle], Fix | NoFix]:
    def ask(one: Vehicle) -> Fix | NoFix:
        one.own(**own)
        return one.ask()

    return ask


def asked(later_ns: int = 0, **limits: Any) -> Callable[[Vehicle], Fix | NoFix]:
    return lambda one: one.ask(later_ns, **limits)


def further(road: Road, off_m: float, at_m: float) -> PlaceMatch | None:
    return road.match(at_m + off_m, sharpness=0.06)


def elsewhere(one: Vehicle) -> Fix | NoFix:
    return one.answers(6, lambda at_m: one.road.match(at_m + 30.0))[-1]


def reckoned_off(one: Vehicle, off_m: float) -> None:
    """GPS has the vehicle too far north for a moment, from where dead reckoning goes on."""
    one.off_m = off_m
    one.own(has_gps=True)


def far_off(one: Vehicle) -> Fix | NoFix:
    reckoned_off(one, 205.0)
    return one.answers(2)[-1]


def never_bounded(one: Vehicle) -> Fix | NoFix:
    return since_boot(one.road).answers(2)[-1]


def since_boot(road: Road, config: Config | None = None) -> Vehicle:
    """A vehicle that has had no GPS since its autopilot's boot."""
    one = Vehicle(road, config or exact())
    one.go(80)
    return one


SITUATIONS: dict[str, tuple[Callable[[Vehicle], Fix | NoFix], ...]] = {
    "two autopilots have the same ids": (reported(is_doubled=True),),
    "the autopilot's clock is not known": (reported(is_clock_known=False),),
    "nothing is recognized now": (asked(unable="the picture is dark"),),
    "recognized, but not exactly": (
        lambda one: one.answers(24, lambda at_m: one.road.match(at_m, sharpness=0.04))[-1],
    ),
    "the places do not agree yet": (
        lambda one: Vehicle(one.road).ask(),
        lambda one: one.answers(24, nothing)[-1],
        asked(at="now", later_ns=S),  # where nothing has moved on since
    ),
    "too old": (asked(5 * S + 1), asked(-1)),
    "GPS is healthy": (reported(gps="healthy"),),
    "GPS is unknown": (reported(gps="unknown"),),
    "the speed is not known": (reported(speed_mps=None), reported(speed_mps=math.nan)),
    "standing": (reported(speed_mps=0.2),),
    "the innovation test fails": (elsewhere,),
    "impossibly far": (far_off,),
    UNCONFIRMED: (never_bounded,),
    ALERT: (lambda one: since_gps(one.road, 200.0, alert_limit_m=40.0).ask(),),
    NOT_NEEDED: (asked(is_reset=True),),
}


@pytest.fixture(scope="module")
def long_road(tmp_path_factory: pytest.TempPathFactory) -> Road:
    """Of one recording."""
    return Road(tmp_path_factory.mktemp("long road"), part(0, 1400))


def test_a_good_position_is_published(long_road: Road) -> None:
    one = since_gps(long_road, 100.0)
    one.off_m = 8.0
    one.own()
    assert isinstance(one.ask(is_reset=True), Fix)


@pytest.mark.parametrize(("off_m", "is_needed"), [(2.0, False), (8.0, True)])
def test_an_autopilot_is_reset_where_it_is_beyond_doubt_off(off_m: float, is_needed: bool, long_road: Road) -> None:
    """One that weighs what it gets, and everybody else, gets the position all the same."""
    one = since_gps(long_road, 100.0)
    one.off_m = off_m
    one.own()
    reset, other = one.ask(is_reset=True), one.ask()
    assert isinstance(reset, Fix) is is_needed and isinstance(other, Fix)
    assert reason(reset) in (None, NOT_NEEDED)


@pytest.mark.parametrize("far_m", [0.99, 1.01])
@pytest.mark.parametrize("sigma_m", [0.5, 4.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_doubt_is_three_standard_deviations_on_one_axis(far_m: float, sigma_m: float, axis: int) -> None:
    """The road leads east; on the other axis the position is far less certain."""
    sigmas_m = (sigma_m, 9.0) if axis == 0 else (9.0, sigma_m)
    place = PlaceFix(S, 1, *HOME, 90.0, *sigmas_m, "forward", "same", 1.2)
    off_m = far_m * max(3.0, AGREE_SIGMAS * sigma_m)
    lat_deg, lon_deg = moved(*HOME, *((off_m, 2.0) if axis == 0 else (2.0, off_m)))
    own = AutopilotState(position=VehiclePosition(S, lat_deg, lon_deg, 0.0, None, 0.0, 0.0, 0.0))
    assert is_off(own, place, 3.0) is (far_m > 1)


@pytest.mark.parametrize("why", SITUATIONS)
def test_situations_in_which_nothing_is_published(why: str, long_road: Road) -> None:
    for happens in SITUATIONS[why]:
        answer = happens(since_gps(long_road))
        assert isinstance(answer, NoFix)
        assert answer.reason == why


def test_the_pages_have_each_rule_and_each_has_its_test() -> None:
    assert list(SITUATIONS) == [rule.reason for rule in RULES]
    root = Path(__file__).parents[2]
    tests = "".join(path.read_text(encoding="utf-8") for path in root.glob("tests/**/test_*.py"))
    argument, page = ((root / "docs" / name).read_text(encoding="utf-8") for name in ("hazards.csv", "positions.md"))
    named = set(re.findall(r"\btest_\w+", argument))
    assert {name for name in named if f"def {name}(" not in tests} == set()
    explained = page.partition("<!-- refusals: begin -->")[2].partition("<!-- refusals: end -->")[0]
    assert re.findall(r"^- \*\*(.+?)\*\*: ", explained, re.MULTILINE) == list(SITUATIONS)


def test_a_reason_comes_with_what_else_is_known_of_it(long_road: Road) -> None:
    one = since_gps(long_road)
    assert str(one.ask(unable="the picture is dark")) == "nothing is recognized now: the picture is dark"
    one.own(gps="unknown", gps_why="a receiver is silent")
    assert str(one.ask()) == "GPS is unknown: a receiver is silent"
    far = far_off(one)
    assert isinstance(far, NoFix) and far.distance_m == pytest.approx(205.0, abs=0.5) and far.fix == one.place


def test_positions_are_published_with_gps_where_that_is_wanted(long_road: Road) -> None:
    one = since_gps(long_road, with_gps=True)
    assert one.go(2, gps=True) == [None]


@pytest.mark.parametrize("own", [{"gps": "healthy"}, {"gps": "unknown"}, {"is_clock_known": False}])
def test_what_only_matters_to_an_autopilot_withholds_no_position_from_others(
    own: dict[str, Any], long_road: Road
) -> None:
    one = since_gps(long_road)
    one.own(**own)
    assert isinstance(one.ask(), NoFix)
    assert isinstance(one.ask(moves_autopilot=False), Fix)


def test_asking_changes_nothing(long_road: Road) -> None:
    one, other = since_gps(long_road), since_gps(long_road)
    for limits in (
        FixRequest(at="now"),
        FixRequest(oldest_s=0.0),
        FixRequest(is_reset=True),
        FixRequest(unable="it is dark"),
    ):
        one.drive.fix(one.t_ns + 45 * S, limits)
    assert (one.ask(), one.drive.state) == (other.ask(), other.drive.state)
    assert one.answers(100) == other.answers(100)


@pytest.mark.parametrize("own", [{}, {"position": None}])
@pytest.mark.parametrize("off_m", [0.0, 300.0])
def test_where_nothing_bounds_the_autopilot_one_stretch_is_never_enough(
    own: dict[str, Any], off_m: float, mapped: MakeRoad
) -> None:
    """Its position may be the mere origin: it is no yardstick for a second stretch, beyond `max_move_m` either."""
    one = Vehicle(mapped(part(0, 490), part(500, 600)), exact())
    one.reports, one.off_m = own, off_m
    assert None not in one.go(490)
    assert one.go(110)[-1] is None, "another one confirms it"


@pytest.mark.parametrize("drift_m", [0.0, 40.0])
def test_dead_reckoning_that_drifts_onto_a_shifted_map_does_not_confirm_it(drift_m: float, mapped: MakeRoad) -> None:
    """All of the map is 40 m off; by its odometer, the vehicle is there after 1.2 km."""
    one = Vehicle(mapped(part(100, 1300, off_m=40.0)), exact())
    one.go(100, gps=True)
    one.odometer = 1 + drift_m / 1200
    assert None not in one.go(1200)


def test_a_long_drive_confirms_itself_after_500_meters(long_road: Road) -> None:
    """The better the odometer, the longer positions become more certain, and the later the second stretch begins."""
    for percent in (0.5, 6.0):
        one = Vehicle(long_road, settings(scale_error_percent=percent))
        assert 560 < first_m(one.go(660)) < 660


@pytest.mark.parametrize("gap_m", [24, 60])
def test_two_segments_of_one_recording_do_not_confirm_each_other(gap_m: int, mapped: MakeRoad) -> None:
    """Their map is 150 m wrong over 410 m, with a gap; another recording on other ground would confirm it."""
    ends_m = 410 + gap_m
    out = part(0, 205, 150.0, "out"), part(205 + gap_m, ends_m, 150.0, "out")
    one = Vehicle(mapped(*out, part(ends_m, 600, 150.0, "another")), exact())
    assert None not in one.go(ends_m)
    assert one.go(600 - ends_m)[-1] is None


@pytest.mark.parametrize(
    ("has_odometer", "length_m", "confirmed_m"), [(False, 800, 584), (True, 500, 0), (True, 800, 224)]
)
def test_a_drive_that_moved_as_its_vehicle_is_wrong_as_a_whole_or_not(
    has_odometer: bool, length_m: float, confirmed_m: float, mapped: MakeRoad
) -> None:
    """A part of it that is too short to confirm itself cannot be wrong alone; a short drive may be wrong as a whole."""
    reasons = Vehicle(mapped(part(0, length_m, has_odometer=has_odometer)), exact()).go(length_m - 10)
    assert (first_m(reasons) if None in reasons else 0) == pytest.approx(confirmed_m, abs=20.0)


def test_two_recordings_of_one_road_share_what_it_looks_like(mapped: MakeRoad) -> None:
    """Another road resembles it for 128 m (measured), and both recordings know it."""
    one = Vehicle(mapped(part(0, 170), part(0, 170)), exact())
    for number in range(16):
        assert None not in one.go(10, partial(one.road.match, part=number % 2))


def test_matches_count_as_evidence_while_gps_is_healthy(long_road: Road) -> None:
    """When GPS fails, the first position is published with a finite level, and not by one stretch."""
    one = Vehicle(long_road, exact())
    one.go(800, gps=True)
    answer = one.answers(2)[0]
    assert isinstance(answer, Fix)
    assert answer.level.is_within(25.0)


def test_a_false_stretch_is_outvoted_by_two_true_ones_and_not_by_one(mapped: MakeRoad) -> None:
    one = Vehicle(mapped(part(0, 400, 150.0), part(500, 640), part(740, 880)), exact())
    assert None not in one.go(740)
    assert None in one.go(140)


def test_a_bound_by_a_position_needs_one_stretch_more_than_what_bound_it(mapped: MakeRoad) -> None:
    one = Vehicle(mapped(part(0, 160), part(160, 320, 100.0), part(320, 480, 100.0)), exact())
    one.go(80, gps=True)
    published = one.answers(80)[-1]
    assert isinstance(published, Fix)
    one.use(published)
    assert None not in one.go(160)[10:], "the last place of the first one holds for 20 m"
    assert None in one.go(160), "two against one"


@pytest.mark.parametrize("ahead_m", [30.0, 150.0])
def test_a_vehicle_that_is_carried_while_it_rolls_is_noticed_and_known_again(ahead_m: float, mapped: MakeRoad) -> None:
    """From one frame to the next, by poses: no wheel has counted it. Before, no place there was ever accepted again."""
    one = Vehicle(mapped(part(0, 1000, has_odometer=True)), exact())
    one.nose_deg = 180.0  # it looks back, as the map's camera did

    def sees(at_m: float) -> PlaceMatch | None:
        place, covariance = round(at_m / SPACING_M), np.diag(np.square([0.4, 0.4, math.radians(0.5)]))
        return one.road.match(at_m, seen=KeyframeMatch(place, 0.0, place * SPACING_M - at_m, 0.0, covariance, 40, 0.9))

    one.go(80, sees, gps=True)
    for answer in one.answers(300, sees):
        if isinstance(answer, Fix):
            one.use(answer)
    one.north_m, one.off_m = one.north_m + ahead_m, -ahead_m
    carried_ns, offs_m = one.t_ns, []
    for number, answer in enumerate(one.answers(460, sees)):
        place = answer.place if isinstance(answer, Fix) else None
        if place is not None and place.stamp_ns > carried_ns:
            offs_m.append((2.0 * number, abs(north_m(place) - one.north_m + 458.0 - 2.0 * number), place.sigma_m))
    assert offs_m
    assert all(off_m < 3 * sigma_m for _, off_m, sigma_m in offs_m)


@pytest.fixture(scope="module")
def confirmed(long_road: Road) -> Vehicle:
    """A vehicle without GPS, after 700 m of one recording."""
    one = Vehicle(long_road, exact())
    assert one.go(700)[-1] is None
    return one


@pytest.mark.parametrize("unknown_m", [0, 60, 90, 150, 300])
def test_evidence_outlives_a_silence_as_far_as_the_vehicle_can_have_gone(unknown_m: float, confirmed: Vehicle) -> None:
    """After a reboot without GPS, 40 m further on the same recording; the autopilot is at its origin then."""
    one = confirmed.copy()
    one.unheard(40.0, unknown_m)
    one.drive.update(one.t_ns, Discontinuity("reboot"))
    one.off_m = -700.0
    last = one.answers(60)[-1]
    refused = {UNCONFIRMED, "the innovation test fails"}
    assert reason(last) in ({None} if 40 < unknown_m < 100 else refused)
    if isinstance(last, Fix):
        assert last.level.along_track_m > unknown_m, "the place may be wrong, by as much"


def test_evidence_outlives_first_matches_after_a_silence_that_are_far_off(confirmed: Vehicle) -> None:
    """On a recorded drive they were 9 m off, and right 10 m further on, which was another claim."""
    one = confirmed.copy()
    one.unheard(40.0, 60.0)
    one.drive.update(one.t_ns, Discontinuity("reboot"))
    one.go(38)
    for off_m in (8.0, 6.0, 4.0, 2.0, 0.0):
        why = one.go(4, partial(further, one.road, off_m))[-1]
    assert None in one.go(100), why


@pytest.mark.parametrize(("far_m", "unknown_m"), [(200.0, 2e7), (300.0, 0.0)])
def test_places_that_moved_otherwise_confirm_nothing(far_m: float, unknown_m: float, mapped: MakeRoad) -> None:
    """Those of another vehicle; and 300 m further on than the odometer says."""
    one = Vehicle(mapped(part(0, 120), part(120 + far_m, 240 + far_m)), exact())
    one.go(120)
    if unknown_m:
        one.unheard(far_m, unknown_m)
    one.north_m = 120.0 + far_m
    reasons = one.go(116)
    assert None not in reasons and reasons[-1] == UNCONFIRMED


def test_what_the_autopilot_makes_of_a_position_says_nothing_of_the_next_one(long_road: Road) -> None:
    """It stays 60 m away, as one that rejects what it gets; one that GPS has there contradicts the place."""
    one, other = since_gps(long_road), since_gps(long_road)
    sent = one.ask()
    assert isinstance(sent, Fix)
    one.use(sent)
    one.off_m = 60.0
    assert one.go(20) == [None] * 10 and isinstance(one.ask(is_reset=True), Fix)
    reckoned_off(other, 60.0)
    assert other.go(20) == [UNCONFIRMED] * 10


def test_the_stated_risk_is_what_decides(long_road: Road) -> None:
    for risk, is_published in ((1e-1, True), (1e-3, False), (1e-5, False)):
        one = since_gps(long_road, risk=risk)
        reckoned_off(one, 14.0)
        assert (one.go(2) == [None]) is is_published
    assert None in since_boot(long_road, exact(risk=1.0)).go(2)


def test_a_place_far_from_dead_reckoning_waits_for_another_one(mapped: MakeRoad) -> None:
    one = since_gps(mapped(Stretch(0, 140, sigma_m=3.0)))
    reckoned_off(one, 16.0)
    assert one.go(2) == [UNCONFIRMED]


@pytest.mark.parametrize(("limit_m", "why"), [(40.0, None), (15.0, ALERT), (0.0, None)])
def test_a_position_above_the_alert_limit_is_not_published(limit_m: float, why: str | None, long_road: Road) -> None:
    """GPS was there just before, and bounds it; a limit of 0 is none."""
    one = since_gps(long_road, 2.0, alert_limit_m=limit_m)
    one.own(speed_mps=5.0)
    assert reason(one.ask()) == why


def test_stretches_that_agree_make_a_level_of_the_errors_alone(long_road: Road) -> None:
    one = Vehicle(long_road, exact(alert_limit_m=40.0))
    assert None not in one.go(580)
    newest = one.answers(400)[-1]
    assert isinstance(newest, Fix)
    along_m, cross_track_m = (of_m - UNNOTICED_M for of_m in (newest.level.along_track_m, newest.level.cross_track_m))
    assert along_m / newest.place.sigma_along_m == pytest.approx(cross_track_m / newest.place.sigma_cross_track_m)


def test_a_level_holds_wherever_a_shifted_stretch_begins(mapped: MakeRoad) -> None:
    """15 m after a gap of 140 m, which may be the odometer's error, over 500 m of one recording."""
    road = mapped(Stretch(0, 1000, sigma_m=1.0), Stretch(1140, 1640, 0.0, 15.0, 1.0, recording="stretch 0"))
    one = Vehicle(road, exact())
    one.go(1000)
    fixes = [one for one in one.answers(500) if isinstance(one, Fix) and one.place.segment]
    assert len(fixes) > 100
    assert all(fix.level.along_track_m > 15.0 for fix in fixes)


def test_bayes() -> None:
    assert wrong_probability(0.5, 1e-3) == pytest.approx(0.5)
    assert wrong_probability(1e-3, 0.08) == pytest.approx(1e-6 / (1e-6 + 0.999 * 0.08))


def test_the_autopilots_position_is_moved_back_to_the_exposure() -> None:
    at = gps_at(20.0)
    place = PlaceFix(0, 7, at.lat_deg, at.lon_deg, 0.0, 3.0, 2.0, "forward", "same", 1.3)
    later = gps_at(30.0)
    own = VehiclePosition(S, later.lat_deg, later.lon_deg, 20.0, 0.0, 10.0, north_mps=10.0)
    assert distance_from(own, place) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("seen_before", [True, False])
def test_a_street_beside_that_looks_the_same_is_contradicted_by_own_motion_since_gps(
    seen_before: bool, long_road: Road
) -> None:
    """Its pictures match for 500 m; the vehicle is known to have gone 25 m to the side.

    seen_before: whether a place was recognized without GPS before it left the mapped road.
    """
    one = Vehicle(long_road)
    one.go(200, None if seen_before else nothing, gps=True)
    assert not seen_before or None in one.go(150)
    one.sideways_m = 1.0
    one.go(50, None if seen_before else nothing)
    one.sideways_m = 0.0
    assert None not in one.go(500)
    one.go(30, gps=True)
    assert None in one.go(10)
