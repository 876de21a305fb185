"""GPS against recognized places: what is called wrong, what is not, and how soon."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.geodesy import moved
from edge.localization import Displacement
from edge.localization.bound import Anchor
from edge.localization.gps_referee import (
    BURST_M,
    BURST_SHARE,
    OFFSETS_M,
    Comparison,
    GpsReferee,
    GpsVerdict,
    evidence_of,
)

HOME = (-27.0, 153.0)
ALONG_M, LEFT_M, MATCH_M, SPACING_M = 5.8, 4.4, 4.5, 2.0
Offset = Callable[[float], tuple[float, float]]
"""East and north, by which GPS is wrong at some meters driven."""


def comparison(
    driven_m: float,
    off_m: tuple[float, float],
    heading_rad: float = 0.0,
    recording: str = "",
    *,
    moved_m: float | None = None,
) -> Comparison:
    """On a straight road to the north, or to where `heading_rad` says."""
    sin, cos = math.sin(heading_rad), math.cos(heading_rad)
    lat_deg, lon_deg = moved(*HOME, driven_m * sin, driven_m * cos)
    along_m, left_m = off_m[0] * sin + off_m[1] * cos, off_m[1] * sin - off_m[0] * cos
    moved_by = None if moved_m is None else Displacement(1, moved_m * sin, moved_m * cos)
    return Comparison(
        recording, lat_deg, lon_deg, SPACING_M, heading_rad, along_m, left_m, ALONG_M, LEFT_M, MATCH_M, moved_by
    )


def honest(seed: int, count: int) -> NDArray[np.float64]:
    """Errors along and across (count, 2) that keep for CORRELATION_M, as large as they are said to be."""
    rng, kept = np.random.default_rng([seed, 17]), math.exp(-SPACING_M / 40.0)
    errors = rng.normal(0.0, 1.0, (count, 2)) * math.sqrt(1 - kept**2)
    errors[0] /= math.sqrt(1 - kept**2)
    for row in range(1, count):
        errors[row] += kept * errors[row - 1]
    return errors * (LEFT_M, ALONG_M)


def drive(offset: Offset, meters: float, seed: int = 1, referee: GpsReferee | None = None) -> list[GpsVerdict]:
    """The verdict at each frame of a drive to the north."""
    referee = referee or GpsReferee(1e-3, 0.01)
    errors, verdicts = honest(seed, int(meters / SPACING_M)), []
    for row, error in enumerate(errors):
        off = np.array(offset(row * SPACING_M)) + error
        verdicts.append(referee.update(comparison(row * SPACING_M, (off[0], off[1]))))
    return verdicts


def called_at_m(verdicts: list[GpsVerdict]) -> float:
    """Meters driven until GPS is called wrong."""
    return next((row * SPACING_M for row, verdict in enumerate(verdicts) if verdict.state == "wrong"), math.inf)


def test_the_evidence_is_the_logarithm_of_two_mixtures() -> None:
    def normal(value: float, *sigmas: float) -> float:
        return math.exp(-(value**2) / sum(s**2 for s in sigmas) / 2) / math.sqrt(math.tau * sum(s**2 for s in sigmas))

    one = comparison(0.0, (0.0, 0.0))
    for along, left in ((0.0, 0.0), (12.0, -3.0), (25.0, 18.0)):
        usual = normal(along, ALONG_M) * normal(left, LEFT_M)
        burst = normal(along, ALONG_M, BURST_M) * normal(left, LEFT_M, BURST_M)
        wrong = np.mean([normal(along, ALONG_M, scale) * normal(left, LEFT_M, scale) for scale in OFFSETS_M])
        expected = math.log(wrong / ((1 - BURST_SHARE) * usual + BURST_SHARE * burst))
        assert evidence_of(one, along, left) == pytest.approx(expected, abs=1e-6)


def test_an_honest_gps_agrees() -> None:
    verdicts = [verdict for seed in range(20) for verdict in drive(lambda at_m: (0.0, 0.0), 2000.0, seed)]
    assert not any(verdict.state == "wrong" for verdict in verdicts)
    assert np.mean([verdict.state == "agrees" for verdict in verdicts]) > 0.9


def test_bursts_of_multipath_are_no_call() -> None:
    """10 m for 80 m of every 400, in changing directions."""

    def burst(at_m: float) -> tuple[float, float]:
        angle = at_m // 400
        return (10 * math.sin(angle), 10 * math.cos(angle)) if at_m % 400 > 320 else (0.0, 0.0)

    assert not any(verdict.state == "wrong" for seed in range(20) for verdict in drive(burst, 2000.0, seed))


@pytest.mark.parametrize("direction", [0.0, 90.0, 180.0, 225.0])
@pytest.mark.parametrize("share", [0.06, 0.12, 0.25])
def test_a_drag_off_is_called_before_50_m_along_and_across(direction: float, share: float) -> None:
    """By so many meters per meter driven: 0.5, 1 and 2 m/s at 8 m/s."""
    sin, cos = math.sin(math.radians(direction)), math.cos(math.radians(direction))

    def drag(at_m: float) -> tuple[float, float]:
        off_m = share * max(0.0, at_m - 300.0)
        return off_m * sin, off_m * cos

    for seed in range(5):
        verdicts = drive(drag, 300.0 + 60.0 / share, seed)
        off_m = share * (called_at_m(verdicts) - 300.0)
        assert 0 < off_m < 50
        called = next(verdict for verdict in verdicts if verdict.state == "wrong")
        assert called.east_m == pytest.approx(off_m * sin, abs=20.0)
        assert called.north_m == pytest.approx(off_m * cos, abs=20.0)


@pytest.mark.parametrize("off_m", [40.0, 400.0, 4e6])
def test_a_jump_is_called_within_two_sightings(off_m: float) -> None:
    verdicts = drive(lambda at_m: (0.0, off_m if at_m >= 300.0 else 0.0), 600.0)
    assert 300 <= called_at_m(verdicts) <= 440


def test_it_agrees_again_when_gps_is_right_again_and_not_before() -> None:
    verdicts = drive(lambda at_m: (60.0 if 300.0 <= at_m < 700.0 else 0.0, 0.0), 1200.0)
    states = [verdict.state for verdict in verdicts]
    back_m = (len(states) - states[::-1].index("wrong")) * SPACING_M
    assert 700 < back_m < 900
    assert states[-1] == "agrees"
    assert set(states[int(450 / SPACING_M) : int(700 / SPACING_M)]) == {"wrong"}


def test_an_offset_since_the_map_began_is_a_fault_of_the_map() -> None:
    verdicts = drive(lambda at_m: (0.0, 40.0), 800.0)
    assert called_at_m(verdicts) == math.inf
    assert verdicts[-1].state == "map shifted"
    assert verdicts[-1].north_m == pytest.approx(40.0, abs=8.0)
    assert verdicts[-1].where.endswith("m to the N")


def test_gps_is_judged_on_a_shifted_map_as_well() -> None:
    verdicts = drive(lambda at_m: (0.0, 40.0 + 0.2 * max(0.0, at_m - 600.0)), 1000.0)
    assert 600 < called_at_m(verdicts) < 600 + 50 / 0.2


def test_a_drive_that_has_agreed_is_not_shifted_later() -> None:
    """GPS jumps while no place is recognized for 300 m."""
    referee = GpsReferee(1e-3, 0.01)
    drive(lambda at_m: (0.0, 0.0), 400.0, 1, referee)
    for _ in range(150):
        referee.update(None)
    assert referee.verdict.state == "cannot say"
    verdicts = drive(lambda at_m: (40.0, 0.0), 600.0, 2, referee)
    assert 180 <= called_at_m(verdicts) <= 400


@pytest.mark.parametrize(("gap_m", "last"), [(100.0, "wrong"), (250.0, "map shifted")])
def test_a_track_goes_on_after_a_gap_that_the_vehicle_may_have_driven(gap_m: float, last: str) -> None:
    """Where the vehicle's own motion is unknown, a track on which GPS agreed shows that GPS is wrong, not the map."""
    referee = GpsReferee(1e-3, 0.01)
    for row, error in enumerate(honest(5, 500)):
        at_m = row * SPACING_M
        if 400.0 <= at_m < 400.0 + gap_m:
            referee.update(None)
        elif at_m < 400.0:
            referee.update(comparison(at_m, tuple(error), recording="out"))
        else:
            referee.update(comparison(at_m, (error[0] + 150.0, error[1]), recording="another"))
    assert referee.verdict.state == last


@pytest.mark.parametrize("off_m", [60.0, 150.0])
@pytest.mark.parametrize("recording", ["out", "another"])
@pytest.mark.parametrize("is_map", [False, True])
def test_after_a_gap_the_vehicle_s_own_motion_says_whether_gps_or_the_map_is_wrong(
    off_m: float, recording: str, is_map: bool
) -> None:
    """250 m without places, and another offset from there on; the vehicle's own velocity is wrong by 3 %."""
    referee, states = GpsReferee(1e-3, 0.01), []
    for row, error in enumerate(honest(4, 500)):
        at_m = row * SPACING_M
        if 400.0 <= at_m < 650.0:
            referee.update(None)
            continue
        is_after = at_m >= 650.0
        off = error + ((off_m, 0.0) if is_after and not is_map else (0.0, 0.0))
        one = comparison(at_m, tuple(off), recording=recording if is_after else "out", moved_m=0.97 * at_m)
        if is_after and is_map:
            assert one.off_left_m is not None
            lat_deg, lon_deg = moved(one.lat_deg, one.lon_deg, off_m, 0.0)
            one = replace(one, lat_deg=lat_deg, lon_deg=lon_deg, off_left_m=one.off_left_m + off_m)
        states.append(referee.update(one).state)
    if is_map and recording != "out":
        assert "wrong" not in states
        assert states[-1] == "map shifted"
    elif not is_map:
        assert "map shifted" not in states
        assert states[-1] == "wrong"


@pytest.mark.parametrize(("before_m", "after_m"), [(8.0, -30.0), (-8.0, 30.0)])
def test_after_a_gap_gps_is_held_against_where_it_was_when_it_agreed(before_m: float, after_m: float) -> None:
    """It was honest there, and to one side of the places by its usual error; 38 m from there is not where it goes."""
    referee, states = GpsReferee(1e-3, 0.01), []
    for row in range(500):
        at_m = row * SPACING_M
        if 400.0 <= at_m < 650.0:
            referee.update(None)
            continue
        off_m = before_m if at_m < 400.0 else after_m
        recording = "out" if at_m < 400.0 else "another"
        states.append(referee.update(comparison(at_m, (off_m, 0.0), recording=recording, moved_m=at_m)).state)
    assert states[199] == "agrees"
    assert states[-1] == "wrong"


def test_gps_that_is_jammed_first_is_called_when_it_is_back() -> None:
    referee = GpsReferee(1e-3, 0.01)
    drive(lambda at_m: (0.0, 0.0), 300.0, 1, referee)
    for row in range(150, 350):
        place = comparison(row * SPACING_M, (0.0, 0.0))
        without = Comparison(**{**vars(place), "off_along_m": None, "off_left_m": None})
        assert referee.update(without).state == "cannot say"
    called = [referee.update(comparison(row * SPACING_M, (0.0, 80.0))).state for row in range(350, 420)]
    assert "wrong" in called[: int(150 / SPACING_M)]


@pytest.mark.parametrize("is_map", [False, True])
def test_gps_that_no_place_has_judged_is_right_until_it_was_lost(is_map: bool) -> None:
    """It is back 150 m from the places: where the vehicle's own motion leads says which of both is wrong."""
    referee, states = GpsReferee(1e-3, 0.01), []
    for row in range(100, 200):
        referee.keep_until_lost(Anchor(*HOME, 3.0, Displacement(1, 0.0, 0.0)))
        one = comparison(row * SPACING_M, (150.0, 0.0), moved_m=0.97 * row * SPACING_M)
        if is_map:
            lat_deg, lon_deg = moved(one.lat_deg, one.lon_deg, -150.0, 0.0)
            one = replace(one, lat_deg=lat_deg, lon_deg=lon_deg)
        states.append(referee.update(one).state)
    assert ("wrong" in states) != is_map


def test_another_place_is_no_evidence_against_gps() -> None:
    """For 200 m the match is 300 m away: another track, which has never agreed."""
    referee = GpsReferee(1e-3, 0.01)
    states = [verdict.state for verdict in drive(lambda at_m: (0.0, 0.0), 400.0, 1, referee)]
    for row in range(100):
        elsewhere = comparison(row * SPACING_M + 700.0, (0.0, -300.0 + row * 0.5), recording="another")
        states.append(referee.update(elsewhere).state)
    states += [verdict.state for verdict in drive(lambda at_m: (0.0, 0.0), 400.0, 3, referee)]
    assert "doubtful" in states
    assert "wrong" not in states


@pytest.mark.parametrize(("knows_motion", "last"), [(True, "doubtful"), (False, "wrong")])
def test_a_false_place_where_the_vehicle_did_not_drive_is_no_evidence_against_gps(
    knows_motion: bool, last: str
) -> None:
    """100 m after the last place, 130 m beside the vehicle, for 40 m."""
    referee, verdict = GpsReferee(1e-3, 0.01), GpsVerdict()
    for row, error in enumerate(honest(5, 270)):
        at_m = row * SPACING_M
        one = comparison(at_m, tuple(error), recording="out", moved_m=at_m if knows_motion else None)
        if at_m >= 500.0:
            assert one.off_left_m is not None
            lat_deg, lon_deg = moved(one.lat_deg, one.lon_deg, 130.0, 0.0)
            one = replace(one, lat_deg=lat_deg, lon_deg=lon_deg, off_left_m=one.off_left_m + 130.0)
        verdict = referee.update(None if 400.0 <= at_m < 500.0 else one)
    assert verdict.state == last


def test_without_places_nothing_is_said() -> None:
    referee = GpsReferee(1e-3, 0.01)
    assert referee.verdict == GpsVerdict()
    drive(lambda at_m: (0.0, 0.0), 300.0, 1, referee)
    assert [referee.update(None).state for _ in range(200)][-1] == "cannot say"
