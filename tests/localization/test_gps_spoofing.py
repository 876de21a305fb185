"""GPS against keypoint poses: how far a spoofing drift goes before it is called, and what of an honest GPS never is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from edge.config import GatesConfig, RigConfig
from edge.localization import Fix
from edge.sequence import KeyframeMatch, PlaceMatch
from sim.research.trial import gps_histories
from tests.localization.events_of import FRAME_NS, SPEED_MPS, Road, Vehicle, gps_at, left_m, match, north_m, settings
from tests.localization.route_course import SPACING_M, Stretch

LENGTH_M, FROM_S, DRAWN = 900.0, 30.0, 590
EVERY, POSE_M, SECOND, SECOND_M = 4, 0.4, 0.1, 2.5
"""Frames from pose to pose; how far off one is; which share of them is a second solution, and by how much."""
SETTINGS = settings(RigConfig(look_sigma_m=0.01))
SWITCHED = settings(SETTINGS.rig, GatesConfig(doubted_gps="switch"))


class Called(NamedTuple):
    """The verdict on GPS after a frame, and how far GPS is off by then."""

    state: str
    off_m: float


@pytest.fixture(scope="module")
def long_road(tmp_path_factory: pytest.TempPathFactory) -> Road:
    """Mapped to a meter east and north, by wheels that agreed."""
    stretch = Stretch(0, LENGTH_M, sigma_m=math.sqrt(2), recording="out", has_odometer=True)
    return Road(tmp_path_factory.mktemp("long road"), stretch)


def drive(
    road: Road,
    history: gps_histories.History,
    seed: int,
    odometer: float | None = 0.97,
    twin_m: float = 0.0,
    blind_s: float = 0.0,
    turns_dps: float = 0.0,
    ends_in: str = "",
) -> list[Called]:
    """Home on the map of a rear camera. odometer: what it measures of a meter, None if it is not known.

    twin_m: from the middle on, poses have the vehicle that far beside where it is, as on a street that looks the same.
    blind_s: of every 30 s, without a pose. turns_dps: the bias of gyros from FROM_S on, and 150 m are
    rebuilt. ends_in: the verdict with which the drive is over.
    """
    rng = np.random.default_rng([seed, 29])
    one, said = Vehicle(road, SETTINGS, LENGTH_M - 10.0, "reverse"), []
    one.odometer = odometer or 1.0
    one.frame = {} if odometer else {"without_gps": None}
    count = round((LENGTH_M - 20.0) / SPACING_M)
    time_s = np.arange(DRAWN) * FRAME_NS / 1e9
    true_m = np.column_stack([np.zeros(DRAWN), one.north_m - SPEED_MPS * time_s])
    offsets_m = history(time_s, true_m, rng)
    map_m = gps_histories.usual(time_s, rng) / 1.2
    for frame, (off_m, mapped_m) in enumerate(zip(offsets_m[:count], map_m, strict=False)):
        one.move()
        beside_m = mapped_m[0] + rng.normal(0.0, POSE_M) + SECOND_M * (rng.random() < SECOND)
        beside_m += twin_m if 2 * frame > count else 0.0
        shown: PlaceMatch | None = matched(
            one.north_m,
            -beside_m,
            mapped_m[1] + rng.normal(0.0, POSE_M),
            is_pose=frame % EVERY == 0 and time_s[frame] % 30 >= blind_s,
        )
        since_s = time_s[frame] - FROM_S
        one.compass_rad = -math.radians(turns_dps) * max(0.0, since_s)
        if turns_dps and 20.0 <= since_s < 35.0:
            shown = None
        gps = None if np.isnan(off_m[0]) else gps_at(one.north_m + off_m[1], off_m[0])
        said.append(Called(one.show(shown, gps).state, float(np.hypot(*off_m))))
        if said[-1].state == ends_in:
            break
    return said


def matched(at_m: float, west_m: float, north_m: float, *, is_pose: bool, confidence: float = 0.9) -> PlaceMatch:
    """A line that ends 4 m off, and a pose that is that far off."""
    place = round(at_m / SPACING_M)
    covariance = np.diag(np.square([POSE_M, POSE_M, math.radians(0.5)]))
    ahead_m = place * SPACING_M - at_m - north_m  # towards the south, where both cameras look
    seen = KeyframeMatch(place, west_m, ahead_m, 0.0, covariance, 40, confidence) if is_pose else None
    return match(place + 2, "reverse", order="same", seen=seen)


def called_m(said: list[Called], state: str = "faulty") -> float:
    """How far GPS was off when it was called."""
    return next((one.off_m for one in said if one.state == state), math.inf)


@pytest.mark.parametrize(
    ("rate_mps", "way", "most_m"),
    [(0.5, "left", 18.0), (1.0, "left", 12.5), (1.0, "along", 12.5), (2.0, "right", 18.0)],
)
@pytest.mark.parametrize("odometer", [pytest.param(0.97, marks=pytest.mark.long), None])
def test_a_drag_is_called_a_few_meters_off(
    long_road: Road, rate_mps: float, way: str, most_m: float, odometer: float | None
) -> None:
    """Also where own motion is not known, by a recording that keeps its shape; GPS itself is off by 1.2 m before."""
    history = gps_histories.drag(rate_mps, way, FROM_S)
    offs_m = [called_m(drive(long_road, history, seed, odometer, ends_in="faulty")) for seed in (1, 2)]
    assert max(offs_m) < most_m


def test_gps_by_which_a_vehicle_leaves_what_it_sees_is_called_by_own_motion(long_road: Road) -> None:
    """The autopilot steers by a drag of 1 m/s; 7 m beside the road there are no more poses, and lines go on."""
    one, sideways_m, found = Vehicle(long_road, SETTINGS, LENGTH_M - 10.0, "reverse"), 0.0, []
    for frame in range(440):
        one.sideways_m = FRAME_NS / 1e9 if frame * FRAME_NS / 1e9 >= FROM_S else 0.0
        sideways_m += one.sideways_m
        one.move()
        shown = matched(one.north_m, -sideways_m, 0.0, is_pose=frame % EVERY == 0 and sideways_m < 7.0)
        found.append(Called(one.show(shown, gps_at(one.north_m)).state, sideways_m))
    assert called_m(found) < 14.0
    assert found[-1].state == "faulty", "no line speaks for GPS soon after poses did not"


@pytest.mark.parametrize("drag_s", [12.0, 20.0, math.inf])
def test_a_drag_that_ends_in_a_jam_leaves_what_places_say(long_road: Road, drag_s: float) -> None:
    """By 0.5 m/s, before it is called and after; the autopilot is where GPS was. Without a jam, and by sequence matches
    alone: from the call on no position is of the filter that followed GPS."""
    config, every, least = (SETTINGS, EVERY, 25) if math.isfinite(drag_s) else (SWITCHED, 10**6, 8)
    one, rng, sigmas = Vehicle(long_road, config, LENGTH_M - 10.0, "reverse"), np.random.default_rng(3), []
    for frame, time_s in enumerate((np.arange(440) * FRAME_NS / 1e9).tolist()):
        has_gps, one.off_m = time_s < 20.0 + drag_s, 0.5 * min(max(time_s - 20.0, 0.0), drag_s)
        one.move()
        one.own(has_gps=has_gps)
        shown = matched(one.north_m, *rng.normal(0.0, POSE_M, 2), is_pose=frame % every == 0)
        one.show(shown, gps_at(one.north_m + one.off_m) if has_gps else None)
        if isinstance(answer := one.ask(), Fix):
            sigmas.append(abs(north_m(answer.place) - one.north_m) / answer.place.sigma_m)
    assert len(sigmas) >= least and max(sigmas) < 3.0


HONEST: dict[str, Callable[[], gps_histories.History]] = {
    "open sky": lambda: lambda time_s, true_m, rng: gps_histories.usual(time_s, rng),
    "3 m": lambda: lambda time_s, true_m, rng: 2.5 * gps_histories.usual(time_s, rng),
    "multipath": lambda: gps_histories.multipath,
}


@pytest.mark.parametrize(
    ("kind", "odometer", "blind_s"),
    [*((kind, None, 0.0) for kind in HONEST), ("multipath", 0.97, 0.0), ("multipath", 0.9, 15.0)],
)
def test_an_honest_gps_is_not_called_wrong(long_road: Road, kind: str, odometer: float | None, blind_s: float) -> None:
    """Also where own motion, 10 % wrong, is held against it between poses."""
    for seed in (1, 2):
        said = drive(long_road, HONEST[kind](), seed, odometer, blind_s=blind_s)
        assert called_m(said) == called_m(said, "map faulty") == math.inf


CREPT = {
    "25 m over 500": (200.0, 700.0, 25.0, 0.0),
    "12 m over 300": (300.0, 600.0, 0.0, 12.0),
    "6 m": (450.0, 451.0, 6.0, 0.0),
}


@pytest.mark.parametrize("odometer", [0.97, None])
@pytest.mark.parametrize("crept", CREPT.values(), ids=CREPT)
def test_an_honest_gps_is_not_wrong_where_that_of_the_map_crept(
    tmp_path: Path, crept: tuple[float, float, float, float], odometer: float | None
) -> None:
    """By less than 5 % of the way, which counts as moved as driven."""
    road = Road(tmp_path, Stretch(0, LENGTH_M, sigma_m=math.sqrt(2), recording="out", has_odometer=True, crept=crept))
    assert called_m(drive(road, HONEST["open sky"](), 1, odometer)) == math.inf


@pytest.mark.parametrize("turns_dps", [0.3, -1.0])
def test_gyros_that_have_another_bias_make_no_gps_wrong(long_road: Road, turns_dps: float) -> None:
    """By 1 degree a second headings were 35 degrees off, and GPS was declared faulty 11 s later."""
    assert called_m(drive(long_road, HONEST["open sky"](), 1, turns_dps=turns_dps)) == math.inf


@pytest.mark.parametrize("odometer", [0.97, None])
@pytest.mark.parametrize("twin_m", [8.0, 25.0])
def test_a_street_beside_that_looks_the_same_makes_no_gps_wrong(
    long_road: Road, twin_m: float, odometer: float | None
) -> None:
    assert called_m(drive(long_road, HONEST["open sky"](), 1, odometer, twin_m)) == math.inf


class Left(NamedTuple):
    """After a frame: by how much GPS is off, whether it is ignored, and how far a pose that is new is off."""

    drag_m: float
    is_ignored: bool
    pose_off_m: float | None


def left(
    road: Road,
    every: int,
    to_m: float,
    *,
    fuses_poses: bool = True,
    acts: Any = "switch",
    wrong: range = range(0),
    confidence: float = 0.9,
    seed: int | Sequence[int] = 7,
) -> list[Left]:
    """Home, by an autopilot that follows GPS: twice, that leaves to the left by 1 m/s, and is right again after to_m.

    every: frames from pose to pose. acts: `doubted_gps`. wrong: frames whose poses, of that confidence,
    are 8 m to the right.
    """
    gates = GatesConfig(doubted_gps=acts, risk=1.0)
    one = Vehicle(road, settings(SETTINGS.rig, gates), LENGTH_M - 10.0, "reverse")
    rng, found = np.random.default_rng(seed), list[Left]()
    one.frame = {"without_gps": None}
    time_s = np.arange(round((LENGTH_M - 20.0) / SPACING_M)) * FRAME_NS / 1e9
    drags_m = np.maximum(0.0, time_s - FROM_S) % 40.0
    drags_m[drags_m > to_m] = 0.0
    for frame, (drag_m, gps_m) in enumerate(zip(drags_m.tolist(), gps_histories.usual(time_s, rng), strict=True)):
        one.move()
        at = gps_at(one.north_m + gps_m[1], drag_m + gps_m[0])
        position = replace(one.position, lat_deg=at.lat_deg, lon_deg=at.lon_deg)
        one.own(has_gps=True, fuses_poses=fuses_poses, position=position)
        beside_m, along_m = rng.normal(0.0, POSE_M, 2)
        beside_m += 8.0 * (frame in wrong)
        is_pose, surely = frame in wrong or frame % every == 0, confidence if frame in wrong else 0.9
        one.show(matched(one.north_m, beside_m, along_m, is_pose=is_pose, confidence=surely), at)
        answer, off_m = one.ask(at="pose"), None
        if isinstance(answer, Fix) and answer.place.stamp_ns == one.t_ns:
            off_m = math.hypot(left_m(answer.place), north_m(answer.place) - one.north_m)
        found.append(Left(drag_m, one.drive.state.ignores_gps, off_m))
    return found


@pytest.mark.parametrize("every", [3, 10])
def test_gps_that_two_poses_contradict_is_left_where_poses_are_fused(long_road: Road, every: int) -> None:
    """A few meters off; what is handed on is the pose itself. Once it agrees for 120 m GPS counts again, and no sooner
    the second time."""
    said = left(long_road, every, 15.0, seed=8)
    first = next(row for row, one in enumerate(said) if one.is_ignored)
    assert 2.0 < said[first].drag_m < 5.0
    while_left = [one for one in said[first:] if one.is_ignored]
    assert np.count_nonzero(np.diff([one.is_ignored for one in said])) == 3
    offs_m = [one.pose_off_m for one in while_left if one.pose_off_m is not None]
    assert len(offs_m) >= len(while_left) / every - 2 and max(offs_m) < 4 * POSE_M, "each time from the next pose on"
    right = [row for row, one in enumerate(said) if row > first and not one.drag_m]
    again = next(row for row in right if not said[row].is_ignored)
    assert 100.0 < SPACING_M * (again - right[0]) < 240.0


@pytest.mark.parametrize(("fuses_poses", "acts", "from_m"), [(False, "switch", 4.5), (True, "report", math.inf)])
def test_gps_is_not_left_so_early_elsewhere(long_road: Road, fuses_poses: bool, acts: str, from_m: float) -> None:
    """Where it is left only as faulty, by the evidence, or not at all."""
    said = left(long_road, 5, 15.0, fuses_poses=fuses_poses, acts=acts)
    assert next((one.drag_m for one in said if one.is_ignored), math.inf) >= from_m


def test_gps_is_left_before_the_evidence_against_it_suffices(tmp_path: Path) -> None:
    """That lets a map of 8 m be wrong in its place, until 5.8 m; departing poses do not."""
    road = Road(tmp_path, Stretch(0, LENGTH_M, sigma_m=8.0, recording="out", has_odometer=True))
    said = left(road, 2, 15.0, seed=(1, 7))
    assert next(one.drag_m for one in said if one.is_ignored) < 5.0


@pytest.mark.parametrize(("wrong", "confidence"), [(range(202, 203), 0.9), (range(201, 205), 0.49)])
def test_one_wrong_pose_is_no_reason_to_leave_gps(long_road: Road, wrong: range, confidence: float) -> None:
    """Nor are four that are faint: they agreed 6 to 8 m off in a bend."""
    assert not any(one.is_ignored for one in left(long_road, 5, 0.0, wrong=wrong, confidence=confidence))
