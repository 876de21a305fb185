"""A vehicle that GPS keeps on the map's drive, and that is not recognized there."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from edge.config import RigConfig
from edge.localization import Discontinuity, GpsFix
from edge.localization.gps_monitor import FIRM, UNSEEN_M, GpsEvidence, GpsState, next_state
from edge.sequence import PlaceMatch
from tests.localization.events_of import Road, Vehicle, gps_at, match, settings
from tests.localization.route_course import SPACING_M, Stretch

FROM_M, FRAMES = 200.0, round(1.2 * UNSEEN_M / SPACING_M)
"""Where places are recognized up to, and how many frames follow that show none."""


def seen(at_m: float, **changes: Any) -> PlaceMatch:
    return match(round(at_m / SPACING_M), **changes)


def unseen(at_m: float) -> PlaceMatch:
    return seen(min(at_m, 398.0), confidence=0.1, accepted=False)


def drive(one: Vehicle, shows: Iterable[PlaceMatch], gps: Callable[[float], GpsFix | None] = gps_at) -> list[bool]:
    """Whether it is said after each frame that the vehicle is not recognized."""
    found = []
    for match_of_frame in shows:
        one.move()
        found.append(one.show(match_of_frame, gps(one.north_m)).state == "not recognized")
    return found


def places(from_m: float, to_m: float) -> list[float]:
    return [from_m + SPACING_M * (frame + 1) for frame in range(round((to_m - from_m) / SPACING_M))]


def recognized(road: Road, to_m: float = FROM_M, **changes: Any) -> Vehicle:
    """After 80 m of the drive on which each place was recognized; nothing is known of the vehicle's own motion."""
    one = Vehicle(road, north_m=to_m - 80.0)
    assert not any(drive(one, [seen(at_m, **changes) for at_m in places(one.north_m, to_m)]))
    return one


def warned_m(one: Vehicle, gps: Callable[[float], GpsFix | None] = gps_at) -> float | None:
    """Meters driven from here, recognizing nothing, until it is said; None if it never is."""
    found = drive(one, [unseen(at_m) for at_m in places(one.north_m, one.north_m + FRAMES * SPACING_M)], gps)
    return SPACING_M * (found.index(True) + 1) if any(found) else None


def test_what_is_not_recognized_on_the_map_s_drive_is_said_until_a_place_is(road: Road) -> None:
    one = recognized(road)
    assert warned_m(one) == pytest.approx(UNSEEN_M, abs=SPACING_M)
    assert drive(one, [seen(one.north_m + SPACING_M)]) == [False]


def test_gps_beside_its_lane_by_its_usual_error_is_on_the_road(road: Road) -> None:
    assert warned_m(recognized(road), lambda at_m: gps_at(at_m, 5.0)) is not None


@pytest.mark.parametrize(
    "gps",
    [
        pytest.param(lambda at_m: gps_at(at_m, at_m - FROM_M), id="turns off"),
        pytest.param(lambda at_m: gps_at(at_m, 10.0), id="beside the road"),  # by 2.5 sigmas
        pytest.param(lambda at_m: gps_at(at_m, 30.0), id="another road"),
        pytest.param(lambda at_m: gps_at(2 * FROM_M - at_m), id="comes back"),
        pytest.param(lambda at_m: gps_at(FROM_M), id="creeps"),
        pytest.param(lambda at_m: None, id="no GPS"),
    ],
)
def test_an_honest_gps_that_does_not_go_on_along_the_drive_is_not_warned_of(
    road: Road, gps: Callable[[float], GpsFix | None]
) -> None:
    assert warned_m(recognized(road), gps) is None


def test_what_was_driven_without_frames_says_nothing(road: Road) -> None:
    """One frame every 30 m."""
    one, states = recognized(road), []
    for _ in range(5):
        for _ in range(round(30.0 / SPACING_M)):
            one.move()
        states.append(one.show(unseen(one.north_m), gps_at(one.north_m)).state)
    assert set(states) == {"consistent"}


def test_nothing_is_said_beyond_the_end_of_the_map(road: Road) -> None:
    assert warned_m(recognized(road, 390.0)) is None


def test_a_short_stretch_that_is_not_recognized_is_no_warning(road: Road) -> None:
    one, most = recognized(road), round(0.8 * UNSEEN_M / SPACING_M)
    shows = [unseen(at_m) for at_m in places(FROM_M, 380.0)]
    shows[most - 1 :: most] = [seen(at_m) for at_m in places(FROM_M, 380.0)[most - 1 :: most]]
    assert not any(drive(one, shows))


def test_nothing_is_said_after_a_recognition_that_was_not_firm(road: Road) -> None:
    assert warned_m(recognized(road, confidence=FIRM - 0.02)) is None


@pytest.mark.parametrize(("weak_m", "is_warned"), [(10.0, True), (80.0, False)])
def test_a_recognition_stays_firm_through_a_few_weak_frames(road: Road, weak_m: float, is_warned: bool) -> None:
    one = recognized(road, FROM_M - weak_m)
    drive(one, [seen(at_m, confidence=0.94) for at_m in places(FROM_M - weak_m, FROM_M)])
    assert (warned_m(one) is not None) == is_warned


@pytest.mark.parametrize(("confidence", "left_m"), [(0.94, UNSEEN_M - 68.0), (0.999, None)])
def test_one_firm_frame_ends_what_was_not_recognized_and_a_weak_one_does_not(
    road: Road, confidence: float, left_m: float | None
) -> None:
    one = recognized(road, 128.0)
    drive(one, [unseen(at_m) for at_m in places(128.0, 198.0)])
    drive(one, [seen(200.0, confidence=confidence)])
    found = warned_m(one)
    assert found == (None if left_m is None else pytest.approx(left_m, abs=2 * SPACING_M))


def ahead(by_m: float, at_m: float) -> GpsFix:
    return gps_at(at_m + by_m)


def test_where_gps_was_doubtful_less_must_be_unrecognized(road: Road) -> None:
    one, off_m = recognized(road, 160.0), 0.0
    while one.drive.state.gps.state != "suspect":
        off_m += 0.5
        drive(one, [seen(one.north_m + SPACING_M)], partial(ahead, off_m))
    doubt = one.drive.state.gps.doubt
    assert doubt is not None and 0.4 < doubt < 1.0
    assert warned_m(one) == pytest.approx((1 - doubt / 2) * UNSEEN_M - off_m, abs=off_m + SPACING_M)


@pytest.mark.parametrize("happens", ["a sequence that begins anew", "a blindness"])
def test_what_begins_anew_is_not_unrecognized(road: Road, happens: str) -> None:
    one = recognized(road)
    if happens == "a blindness":
        one.drive.update(one.t_ns, Discontinuity("blind"))
    else:
        one.show(None, gps_at(FROM_M))
    assert warned_m(one) is None


def test_gps_that_was_called_wrong_stays_wrong_where_nothing_is_recognized(road: Road) -> None:
    one = recognized(road)
    drive(one, [seen(at_m) for at_m in places(FROM_M, 240.0)], lambda at_m: gps_at(at_m, 200.0))
    assert one.drive.state.gps.state == "faulty"
    assert warned_m(one) is None and one.drive.state.gps.state == "faulty"


def honest(north_m: float) -> GpsFix:
    return gps_at(north_m)


def bursts(north_m: float) -> GpsFix:
    """Multipath: 10 m for 80 m of every 400, one of them where nothing is recognized."""
    return gps_at(north_m, 10.0 if north_m % 400 > 320 else 0.0)


@pytest.mark.parametrize(
    ("sideways", "odometer", "gps", "state"),
    [
        pytest.param(0.125, 1.0, honest, "faulty", id="1 m/s at 8 m/s"),
        pytest.param(0.25, 1.0, honest, "faulty", id="1 m/s at 4 m/s"),
        pytest.param(0.25, 0.92, honest, "faulty", id="wheels 8 % wrong"),
        pytest.param(0.0, 1.0, honest, "not recognized", id="a road that was rebuilt"),
        pytest.param(0.0, 1.0, bursts, "not recognized", id="multipath"),
        pytest.param(0.0, 0.88, honest, "not recognized", id="wheels that slip"),
    ],
)
def test_gps_by_which_the_vehicle_leaves_the_road_is_wrong_where_own_motion_says_so(
    tmp_path: Path, sideways: float, odometer: float, gps: Callable[[float], GpsFix], state: str
) -> None:
    """It steers by a GPS that is spoofed, which so stays on the lane; no place is recognized 16 m beside it.

    aside: meters to the side for each that is driven, from 300 m on.
    """
    one, sideways_m = Vehicle(Road(tmp_path, Stretch(0.0, 1360.0))), 0.0
    called_m = None
    while one.north_m < 1200.0 and called_m is None:
        is_spoofed = one.north_m >= 300.0
        one.sideways_m = sideways * SPACING_M if is_spoofed else 0.0
        one.odometer = odometer if is_spoofed or odometer > 0.9 else 1.0
        sideways_m += one.sideways_m
        one.move()
        shown = seen(one.north_m) if sideways_m < 16.0 and one.north_m < 560.0 else unseen(one.north_m)
        found = one.show(shown, gps(one.north_m)).state
        assert found in ("cannot say", "consistent", "suspect", state)
        called_m = sideways_m if found == "faulty" else None
    assert found == state
    assert called_m is None or called_m < 35.0


@pytest.mark.parametrize(("timestamp_sigma_s", "state"), [(0.0, "faulty"), (1.5, "cannot say")])
def test_gps_is_not_called_wrong_for_pictures_whose_time_is_uncertain(
    road: Road, timestamp_sigma_s: float, state: str
) -> None:
    """Pictures that are 3 s late put a vehicle at 10 m/s 30 m behind where GPS has it."""
    one = Vehicle(road, settings(RigConfig(sigma_along_m=3.0)))
    one.frame = {"timestamp_sigma_s": timestamp_sigma_s}
    one.own()
    for at_m in places(0.0, 300.0):
        one.move()
        one.show(seen(at_m), gps_at(at_m if at_m < 160.0 else at_m + 30.0))
    assert one.drive.state.gps.state == state


@pytest.mark.parametrize(
    ("state", "changes", "after"), [
        ("faulty", {"is_followed": False}, "faulty"), ("left", {"agreed_m": 120.0, "is_followed": False}, "consistent"),
        ("faulty", {"agreed_m": 120.0, "is_followed": False}, "consistent"), ("left", {"gap_m": 241.0}, "cannot say"),
        ("suspect", {"agreed_m": 999.0, "is_followed": False}, "left"), ("suspect", {"agreed_m": 30.0}, "consistent"),
        ("left", {"is_followed": False, "is_far": True}, "faulty"), ("consistent", {"gps": 3.0}, "suspect"),
        ("consistent", {"gps": 9.0, "of_map": 6.0}, "faulty"), ("consistent", {"of_map": 9.0}, "map faulty"),
        ("consistent", {"gps": 9.0, "tells_gps": False}, "inconsistent"), ("suspect", {"is_far": True}, "suspect"),
        ("consistent", {"of_map": 9.0, "tells_map": False}, "inconsistent"), ("suspect", {"gps": 2.9}, "suspect"),
    ])  # fmt: skip
def test_the_table_of_states(state: GpsState, changes: dict[str, Any], after: GpsState) -> None:
    assert next_state(state, GpsEvidence(0, 0, 9, True, True, 0, 0, True, False)._replace(**changes)) == after
