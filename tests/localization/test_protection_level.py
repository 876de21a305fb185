"""How far off a position may be, by its protection level: the function, and drives whose errors must stay within it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from edge.journal.records import PlaceFix
from edge.localization import Odometry
from edge.localization.integrity import MODEL_ERROR, UNNOTICED_M, protection_level
from edge.localization.position_aiding import DeadReckoningOffset, OdometryDatum
from tests.localization.route_bench import Bench
from tests.localization.route_course import Course, Stretch

FIX = PlaceFix(
    stamp_ns=0, place=3, lat_deg=-27.0, lon_deg=153.0, heading_deg=90.0, sigma_along_m=2.0, sigma_cross_track_m=1.0,
    direction="forward", order="same", uniqueness=1.2,
)  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(("has_poses", "most"), [(False, 6), (True, 11)])  # 10.3 by poses, whose errors are small
def test_errors_stay_within_their_protection_levels_on_right_maps(has_poses: bool, most: float, tmp_path: Path) -> None:
    """And levels are no larger than so many times the 95 % error."""
    found = []
    for seed in range(4):
        rng = np.random.default_rng([seed, 7])
        course = Course(road_m=1700.0, stretches=(Stretch(0.0, 1700.0),), steers=seed % 2 > 0, poses=has_poses)
        drawn = Bench(replace(course, speed_mps=float(rng.uniform(3, 12))), seed, tmp_path, is_stream=seed > 1).run()
        assert not any(one.is_exceeded for one in drawn.bounded)
        found += drawn.bounded
    every = np.array([one for one in found if math.isfinite(one.level_along_m)])
    assert len(every) > 0.3 * len(found)
    for error, level in ((1, 3), (2, 4)):
        assert np.median(every[:, level]) <= most * np.quantile(every[:, error], 0.95)


@pytest.mark.parametrize(("seed", "is_stream"), [(2015, False), (2032, True), (2038, False)])
def test_a_stretch_that_is_shifted_by_what_nothing_notices_is_within_the_level(
    seed: int, is_stream: bool, tmp_path: Path
) -> None:
    """500 m of one drive of the map, 9 to 20 m off, and poses."""
    rng = np.random.default_rng([seed, 6])
    far_m, angle = math.exp(rng.uniform(math.log(5), math.log(40))), rng.uniform(0, 2 * math.pi)
    off_m = far_m * math.sin(angle), far_m * math.cos(angle)
    shifted = Stretch(800.0, 1300.0, *off_m, continues=True)
    stretches = Stretch(0.0, 800.0), shifted, Stretch(1300.0, 1700.0, continues=True)
    steers, speed_mps = bool(rng.random() < 0.5), float(rng.uniform(3, 12))
    drawn = Course(road_m=1700.0, stretches=stretches, steers=steers, poses=True, speed_mps=speed_mps)
    bounded = Bench(drawn, seed, tmp_path, is_stream=is_stream).run().bounded
    assert any(math.isfinite(one.level_along_m) for one in bounded)
    assert not any(one.is_exceeded for one in bounded)


HERE = -27.0, 153.0


def level_of(place: float, reckoned: DeadReckoningOffset | None) -> tuple[float, float]:
    level = protection_level(FIX, place, 0.0, reckoned, 8.0, 1e-3, 500.0)
    return level.along_track_m, level.cross_track_m


def test_a_place_that_is_certain_is_bounded_by_its_errors_and_what_nothing_notices() -> None:
    along_m, cross_track_m = level_of(1e-9, None)
    shift_m = UNNOTICED_M
    assert along_m - shift_m == pytest.approx(2 * (cross_track_m - shift_m))
    assert 3.4 * MODEL_ERROR < cross_track_m - shift_m < 3.6 * MODEL_ERROR  # 58 stretches in an hour, of which 1 in 200


def test_an_uncertain_place_is_bounded_by_its_errors_alone() -> None:
    uncertain = msgspec.structs.replace(FIX, sigma_along_m=10.0)
    level = protection_level(uncertain, 1e-9, 0.0, None, 8.0, 1e-3, 500.0)
    assert 5 * MODEL_ERROR < level.along_track_m / 10 < 5.3 * MODEL_ERROR  # 480 errors in an hour


def test_a_place_that_may_be_wrong_is_bounded_by_what_no_place_had_a_part_in() -> None:
    """It heads east: what is north of it is across."""
    along_m, cross_track_m = level_of(2e-5, DeadReckoningOffset(3.0, 40.0, 10.0))
    assert 40 < cross_track_m < 40 + 3 * 10
    assert along_m == pytest.approx(cross_track_m - 37)


def test_what_reckoning_is_off_by_is_along_and_across_the_heading() -> None:
    """North-east of a vehicle that heads north-east, it is off along the road alone."""
    northeast = msgspec.structs.replace(FIX, heading_deg=45.0)
    level = protection_level(northeast, 2e-5, 0.0, DeadReckoningOffset(30.0, 30.0, 1.0), 8.0, 1e-3, 500.0)
    assert level.along_track_m > math.hypot(30.0, 30.0)
    assert level.cross_track_m < 30.0


@pytest.mark.parametrize(
    ("place", "reckoned"),
    [
        (2e-5, None),
        (1e-3, DeadReckoningOffset(0.0, 0.0, 3.0)),
        (2e-5, DeadReckoningOffset(0.0, 0.0, 3.0, wrong=0.5)),
    ],
    ids=["nothing else is known", "wrong too often", "what else is known is wrong too often"],
)
def test_what_nothing_bounds_has_no_level(place: float, reckoned: DeadReckoningOffset | None) -> None:
    assert level_of(place, reckoned) == (math.inf, math.inf)


def test_a_map_that_may_be_shifted_is_bounded_by_reckoning() -> None:
    level = protection_level(FIX, 1e-9, 1e-3, DeadReckoningOffset(0.0, 60.0, 5.0), 8.0, 1e-3, 500.0)
    assert level.cross_track_m > 60.0


def test_reckoning_moves_as_the_vehicle_did_and_becomes_less_certain() -> None:
    anchor = OdometryDatum(-27.0, 153.0, 3.0, Odometry(1, 10.0, 0.0), 100.0)
    found = anchor.reckoned(HERE, Odometry(1, 90.0, 60.0), 0.05)
    assert (found.east_m, found.north_m) == pytest.approx((80.0, 60.0), abs=0.01)
    assert found.sigma_m == pytest.approx(math.hypot(3.0, 5.0))
    assert found.distance_m == pytest.approx(100.0, abs=0.01)
    assert anchor.reckoned(
        (FIX.lat_deg or 0.0, FIX.lon_deg or 0.0), Odometry(1, 90.0, 60.0), 0.05, 500.0
    ).sigma_m == pytest.approx(math.hypot(3.0, 20.0))
    unheard = anchor.reckoned(HERE, Odometry(2, 90.0, 60.0, unknown_m=80.0), 0.05)
    assert unheard.sigma_m == pytest.approx(math.hypot(3.0, 5.0, 80 / 3**0.5)), "another leg"
