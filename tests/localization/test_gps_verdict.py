"""GPS against recognized places: what is declared faulty, what is not, and how soon."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import GatesConfig, RigConfig
from edge.localization import Fix, GpsVerdict
from edge.localization.state import GPS_S, LINE_M
from edge.sequence import PlaceMatch
from tests.localization.events_of import SPEED_MPS, Road, Vehicle, gps_at, left_m, settings
from tests.localization.route_course import SPACING_M, Stretch

GPS_M, MATCH_M = 2.0, 4.5
"""Of GPS in each direction, and of a match along the road."""
SETTINGS = settings(RigConfig(sigma_along_m=MATCH_M, sigma_cross_track_m=2.5), GatesConfig())
AGREES_M, LONGEST = 200.0, 620
"""How far GPS and places agree before something happens; frames of the longest drive."""
Offset = Callable[[float], tuple[float, float] | None]
"""East and north, by which GPS is wrong at some meters driven; None without GPS."""
MakeRoad = Callable[..., Road]


def part(begins_m: float, ends_m: float, east_m: float = 0.0, recording: str = "") -> Stretch:
    return Stretch(begins_m, ends_m, east_m, sigma_m=3.0, recording=recording)


@pytest.fixture(scope="module")
def long_road(tmp_path_factory: pytest.TempPathFactory) -> Road:
    return Road(tmp_path_factory.mktemp("long road"), part(0, 1250))


@pytest.fixture(scope="module")
def shaped(long_road: Road, tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Road]:
    """By whether its recording is known to keep its shape."""
    return {False: long_road, True: Road(tmp_path_factory.mktemp("road"), replace(part(0, 1250), has_odometer=True))}


def right(at_m: float) -> tuple[float, float]:
    return 0.0, 0.0


def wandering(rng: np.random.Generator, count: int, sigma_m: float, within_m: float) -> NDArray[np.float64]:
    """Errors (count,) of a Gauss-Markov process."""
    kept = math.exp(-SPACING_M / within_m)
    errors = rng.normal(0.0, sigma_m, count) * math.sqrt(1 - kept**2)
    errors[0] /= math.sqrt(1 - kept**2)
    for row in range(1, count):
        errors[row] += kept * errors[row - 1]
    return errors


def honest(seed: int) -> NDArray[np.float64]:
    """Errors of GPS east and north, and of matches along the road (LONGEST, 3), as large as they are said to be."""
    rng = np.random.default_rng([seed, 17])
    of_gps = [wandering(rng, LONGEST, GPS_M, GPS_S * SPEED_MPS) for _ in range(2)]
    return np.column_stack([*of_gps, wandering(rng, LONGEST, MATCH_M, LINE_M)])


def begun(road: Road, odometer: float | None) -> Vehicle:
    """odometer: what it measures of a meter; None: own motion is not known without GPS."""
    one = Vehicle(road, SETTINGS)
    one.frame = {} if odometer else {"without_gps": None}
    one.odometer = odometer or 1.0
    return one


@cache
def agreed(road: Road, seed: int, odometer: float | None) -> tuple[Vehicle, list[GpsVerdict]]:
    """A vehicle after AGREES_M, and the verdict at each frame."""
    one = begun(road, odometer)
    return one, [shown(one, right, error, road.match) for error in honest(seed)[: int(AGREES_M / SPACING_M)]]


def shown(
    one: Vehicle,
    offset: Offset,
    error: NDArray[np.float64],
    sees: Callable[[float], PlaceMatch | None],
    sideways: float = 0.0,
) -> GpsVerdict:
    """The verdict at the next place."""
    one.move()
    off_m, seen = offset(one.north_m), sees(one.north_m + error[2])
    one.motion = one.moved(east_m=sideways * SPACING_M)
    return one.show(seen, None if off_m is None else gps_at(one.north_m + off_m[1] + error[1], off_m[0] + error[0]))


def drive(
    road: Road,
    offset: Offset,
    meters: float,
    seed: int = 1,
    sees: Callable[[float], PlaceMatch | None] | None = None,
    odometer: float | None = 0.97,
    sideways: float = 0.0,
    ends_in: str = "",
) -> list[GpsVerdict]:
    """The verdict at each frame. For AGREES_M GPS is as right as it says, and places are where they are.

    odometer: see `begun`. aside: meters to the east for each to the north that it goes from AGREES_M on. ends_in: the
    verdict with which the drive is over.
    """
    one, verdicts = agreed(road, seed, odometer)
    one, verdicts = one.copy(), verdicts.copy()
    for error in honest(seed)[len(verdicts) : int(meters / SPACING_M)]:
        verdicts.append(shown(one, offset, error, sees or road.match, sideways))
        if verdicts[-1].state == ends_in:
            break
    return verdicts


def states(verdicts: list[GpsVerdict], from_m: float = 0.0, to_m: float = math.inf) -> list[str]:
    return [one.state for row, one in enumerate(verdicts) if from_m <= row * SPACING_M < to_m]


def called_at_m(verdicts: list[GpsVerdict], *states: str) -> float:
    """Meters driven until GPS is declared faulty, or until one of those states."""
    return next((row * SPACING_M for row, one in enumerate(verdicts) if one.state in (states or ("faulty",))), math.inf)


def test_an_honest_gps_agrees(long_road: Road) -> None:
    found = [state for seed in range(3) for state in states(drive(long_road, right, 1240.0, seed))]
    assert "faulty" not in found
    assert np.mean([state == "consistent" for state in found]) > 0.9


def test_bursts_of_multipath_are_no_call(long_road: Road) -> None:
    """10 m for 80 m of every 400, in changing directions."""
    for seed in range(3):

        def burst(at_m: float, seed: int = seed) -> tuple[float, float]:
            angle = 3 * seed + at_m // 400
            return (10 * math.sin(angle), 10 * math.cos(angle)) if at_m % 400 > 320 else (0.0, 0.0)

        assert called_at_m(drive(long_road, burst, 1240.0, seed)) == math.inf


def test_a_drag_off_is_called_before_50_m_along_and_across(long_road: Road) -> None:
    """By 0.06 to 0.25 m for each meter driven: 0.5 to 2 m/s at 8 m/s. All are said before 40 m, and called."""
    offs_m = []
    for seed, (direction, share) in enumerate(product((0, 90, 180, 225), (0.06, 0.12, 0.25))):
        towards = np.array([math.sin(math.radians(direction)), math.cos(math.radians(direction))])

        def drag(at_m: float, towards: NDArray[np.float64] = towards, share: float = share) -> tuple[float, float]:
            east_m, north_m = share * max(0.0, at_m - AGREES_M) * towards
            return east_m, north_m

        verdicts = drive(long_road, drag, AGREES_M + 60.0 / share, seed % 4, ends_in="faulty")
        assert 0 < share * (called_at_m(verdicts, "faulty", "inconsistent") - AGREES_M) < 40
        offs_m.append(share * (called_at_m(verdicts) - AGREES_M))
        assert verdicts[-1].off_m == pytest.approx(offs_m[-1] * towards, abs=25.0)
    assert max(offs_m) < 50


@pytest.mark.parametrize("off_m", [40.0, 400.0, 4e6])
def test_a_jump_is_called_within_two_matches(long_road: Road, off_m: float) -> None:
    verdicts = drive(long_road, lambda at_m: (0.0, off_m if at_m >= AGREES_M else 0.0), 500.0, ends_in="faulty")
    assert AGREES_M - 2 <= called_at_m(verdicts) <= AGREES_M + 140


def test_it_agrees_again_when_gps_is_right_again_and_not_before(long_road: Road) -> None:
    verdicts = drive(long_road, lambda at_m: (60.0 if AGREES_M <= at_m < 450.0 else 0.0, 0.0), 800.0)
    found = states(verdicts)
    assert 450 < (len(found) - found[::-1].index("faulty")) * SPACING_M < 650
    assert found[-1] == "consistent"
    assert set(states(verdicts, 350, 450)) == {"faulty"}


@pytest.mark.parametrize("odometer", [0.97, None])
def test_where_they_have_never_agreed_neither_is_called_wrong(long_road: Road, odometer: float | None) -> None:
    one = begun(long_road, odometer)
    verdicts = [shown(one, lambda at_m: (0.0, 40.0), error, long_road.match) for error in honest(1)[:300]]
    assert called_at_m(verdicts, "faulty", "map faulty") == math.inf
    assert verdicts[-1].state == "inconsistent"
    off_m = verdicts[-1].off_m
    assert off_m is not None and off_m[1] == pytest.approx(40.0, abs=15.0)
    assert " m off to the N" in verdicts[-1].where


@pytest.mark.parametrize(("odometer", "last"), [(0.97, "faulty"), (None, "inconsistent")])
@pytest.mark.parametrize("gap_m", [0.0, 300.0])
def test_without_own_motion_nobody_is_called_wrong(
    long_road: Road, odometer: float | None, last: str, gap_m: float
) -> None:
    """GPS jumps by 40 m, also while no place is recognized."""

    def sees(at_m: float) -> PlaceMatch | None:
        return None if AGREES_M < at_m <= AGREES_M + gap_m else long_road.match(at_m)

    offset: Offset = lambda at_m: (40.0 if at_m > AGREES_M + gap_m else 0.0, 0.0)  # noqa: E731
    verdicts = drive(long_road, offset, AGREES_M + 300.0 + gap_m, sees=sees, odometer=odometer)
    assert set(states(verdicts, 450, 190 + gap_m)) <= {"cannot say"}
    assert verdicts[-1].state == last
    assert AGREES_M + gap_m <= called_at_m(verdicts, last) <= AGREES_M + 140 + gap_m


@pytest.mark.parametrize("off_m", [60.0, 150.0])
@pytest.mark.parametrize(("recording", "is_map"), [("out", False), ("another", False), ("another", True)])
def test_after_a_gap_the_vehicle_s_own_motion_says_whether_gps_or_the_map_is_wrong(
    mapped: MakeRoad, off_m: float, recording: str, is_map: bool
) -> None:
    """250 m without places, and another offset from there on; the vehicle's own velocity is wrong by 3 %."""
    road = mapped(part(0, 200, recording="out"), part(450, 900, -off_m if is_map else 0.0, recording))
    gps_off_m = 0.0 if is_map else off_m
    found = states(drive(road, lambda at_m: (gps_off_m if at_m >= 450.0 else 0.0, 0.0), 890.0, 4))
    assert ("faulty" in found, "map faulty" in found) == (not is_map, is_map)
    assert is_map or found[-1] == "faulty"


@pytest.mark.parametrize("side", [1, -1])
def test_after_a_gap_gps_is_held_against_where_it_was_when_it_agreed(mapped: MakeRoad, side: int) -> None:
    """It was honest there, and to one side of the places by its usual error; 38 m from there is not where it goes."""
    one, found = Vehicle(mapped(part(0, 200), part(398, 800)), SETTINGS), []
    for _ in range(390):
        one.move()
        off_m = side * (8.0 if one.north_m < 398.0 else -30.0)
        found.append(one.show(one.road.match(one.north_m), gps_at(one.north_m, off_m)).state)
    assert found[99] == "consistent"
    assert found[-1] == "faulty"


def test_gps_that_is_jammed_first_is_called_when_it_is_back(long_road: Road) -> None:
    def jammed(at_m: float) -> tuple[float, float] | None:
        return None if AGREES_M < at_m <= 600.0 else (0.0, 80.0 if at_m > 600.0 else 0.0)

    verdicts = drive(long_road, jammed, 750.0)
    assert set(states(verdicts, AGREES_M + 2, 600)) == {"cannot say"}
    assert called_at_m(verdicts) < 750.0


@pytest.mark.parametrize("is_map", [False, True])
def test_gps_that_no_place_has_judged_is_right_until_it_was_lost(mapped: MakeRoad, is_map: bool) -> None:
    """It is back 150 m from the places: where the vehicle's own motion leads says which of both is wrong."""
    one, found = Vehicle(mapped(part(150, 420, -150.0 if is_map else 0.0)), SETTINGS), []
    one.odometer = 0.97
    one.go(10, gps=True)
    one.go(180)
    for _ in range(100):
        one.move()
        found.append(one.show(one.road.match(one.north_m), gps_at(one.north_m, 0.0 if is_map else 150.0)).state)
    assert ("faulty" in found) != is_map


@pytest.mark.parametrize(
    ("stretches", "from_m", "further_m", "odometer", "last"),
    [
        ((part(0, 800), part(800, 1200)), 200.0, 660.0, 0.97, ""),
        ((part(0, 200), part(260, 560, 130.0)), 300.0, 0.0, 1.0, "map faulty"),
        ((part(0, 200), part(260, 560, 130.0)), 300.0, 0.0, None, "inconsistent"),
    ],
    ids=["on another track", "beside the road", "beside the road, own motion unknown"],
)
def test_a_false_place_where_the_vehicle_did_not_drive_is_no_evidence_against_gps(
    mapped: MakeRoad, stretches: tuple[Stretch, ...], from_m: float, further_m: float, odometer: float | None, last: str
) -> None:
    """For 200 m, 300 m away; and 130 m beside the vehicle, 100 m after the last place."""
    road = mapped(*stretches)

    def sees(at_m: float) -> PlaceMatch | None:
        if further_m:
            return road.match(at_m + further_m if from_m < at_m <= from_m + 200.0 else at_m)
        return None if AGREES_M < at_m <= from_m else road.match(at_m)

    found = states(drive(road, right, 780.0 if further_m else 500.0, 5, sees, odometer))
    assert "faulty" not in found
    assert last in ("", found[-1])


def test_without_places_nothing_is_said(long_road: Road) -> None:
    assert Vehicle(long_road).drive.state.gps == GpsVerdict()
    verdicts = drive(long_road, right, 600.0, sees=lambda at_m: long_road.match(at_m) if at_m < AGREES_M else None)
    assert verdicts[-1].state == "cannot say"


@pytest.mark.parametrize("share", [0.12, 0.25])
@pytest.mark.parametrize("has_odometer", [True, False])
def test_gps_that_departs_from_a_recording_that_keeps_its_shape_is_wrong(
    shaped: dict[bool, Road], share: float, has_odometer: bool
) -> None:
    """Also where own motion is not known; a recording of whose shape nothing is known is no witness."""
    offset: Offset = lambda at_m: (share * max(0.0, at_m - AGREES_M), 0.0)  # noqa: E731
    verdicts = drive(shaped[has_odometer], offset, 1000.0, odometer=None, ends_in="faulty")
    assert "map faulty" not in states(verdicts)
    if has_odometer:
        assert share * (called_at_m(verdicts) - AGREES_M) < 85.0
    else:
        assert verdicts[-1].state == "inconsistent"


@pytest.mark.parametrize("off_m", [25.0, 60.0])
@pytest.mark.parametrize("gap_m", [0.0, 80.0])
def test_a_street_beside_that_looks_the_same_makes_no_gps_wrong(
    shaped: dict[bool, Road], off_m: float, gap_m: float
) -> None:
    """The vehicle changes to it: GPS is right, and keeps its distance from the recording that is recognized."""
    road = shaped[True]

    def sees(at_m: float) -> PlaceMatch | None:
        return None if AGREES_M < at_m <= AGREES_M + gap_m else road.match(at_m)

    found = states(drive(road, lambda at_m: (off_m if at_m > AGREES_M else 0.0, 0.0), 1000.0, sees=sees, odometer=None))
    assert "faulty" not in found
    assert found[-1] == "inconsistent"


def test_a_road_that_leads_away_slowly_makes_no_gps_wrong(shaped: dict[bool, Road]) -> None:
    """By one meter in six; it is taken for the mapped one as far as the lane was shown to a vehicle beside it, 20 m."""
    road = shaped[True]

    def sees(at_m: float) -> PlaceMatch | None:
        return road.match(at_m) if at_m < AGREES_M + 6 * 20.0 else None

    offset: Offset = lambda at_m: (max(0.0, at_m - AGREES_M) / 6, 0.0)  # noqa: E731
    assert "faulty" not in states(drive(road, offset, 1000.0, sees=sees, odometer=None, sideways=1 / 6))


@pytest.mark.parametrize("share", [1.0, pytest.param(0.75, marks=pytest.mark.long)])
def test_a_recording_that_is_25_m_off_in_part_makes_no_gps_wrong(mapped: MakeRoad, share: float) -> None:
    """Places that are wrong count as agreed for a while; own motion since then must not speak for them.

    share: of the errors' variance that is in the places, and not in GPS.
    """
    road = mapped(part(0, 400, recording="all"), Stretch(400, 900, 0.0, 25.0, 3.0, recording="all"))
    found = []
    for seed in range(6):
        places = honest(seed)[:440]
        one, states_of = Vehicle(road, SETTINGS), []
        for error in places:
            one.move()
            gps = gps_at(one.north_m + math.sqrt(1 - share) * error[1], math.sqrt(1 - share) * error[0])
            states_of.append(one.show(road.match(one.north_m + share * error[1]), gps).state)
        found.append("faulty" in states_of)
    assert not any(found)


@cache
def gone_with_gps(road: Road) -> Vehicle:
    one = Vehicle(road, SETTINGS)
    one.go(AGREES_M, gps=True)
    return one


@pytest.mark.parametrize(("share", "off_m"), [(0.12, 20.0), (0.12, 25.0), (0.25, 25.0), (0.06, 25.0)])
@pytest.mark.parametrize("has_odometer", [True, False])
def test_gps_that_is_spoofed_and_jammed_before_it_is_called_bounds_nothing(
    shaped: dict[bool, Road], share: float, off_m: float, has_odometer: bool
) -> None:
    """1 m/s at 8 and at 4 m/s, and 0.5 m/s. Positions come by the places."""
    one = gone_with_gps(shaped[has_odometer]).copy()
    while one.off_m < off_m:
        one.off_m = share * max(0.0, one.north_m - AGREES_M)
        one.go(2, gps=True)
    answers = one.answers(240)
    found = [answer for answer in answers if isinstance(answer, Fix)]
    assert found
    for answer in found:
        place = answer.place
        assert place.lat_deg is not None and abs(left_m(place)) < 3 * place.sigma_cross_track_m


def test_a_street_beside_that_is_entered_without_gps_makes_no_gps_wrong(mapped: MakeRoad) -> None:
    """Own motion goes there, and the places of the street that looks the same do not: GPS was right until then."""
    one = Vehicle(mapped(replace(part(0, 900), has_odometer=True)))
    one.go(AGREES_M, gps=True)
    for frame in range(200):
        one.sideways_m = 0.5 if frame < 50 else 0.0
        one.go(2)
        assert one.drive.state.gps.state != "faulty"
    assert not any(isinstance(answer, Fix) for answer in one.answers(100))
