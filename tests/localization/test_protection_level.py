"""That errors exceed their protection levels no more often than stated, by counting on seeded drives without pictures.

The drives have what positions are wrong by: errors of matches and of their parallax that last, an odometer and a
heading that are wrong, stretches of the map that are shifted as often as `STRETCH_WRONG` says, unmapped stretches of
which some resemble the map, turn-offs, halts and reversing. An hour of them in the suite; `make soak` counts 500.
docs/integrity.md names these tests.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ProcessPoolExecutor
from itertools import count
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition
from edge.localization import Displacement, PlaceFix
from edge.localization.claims import STRETCH_WRONG
from edge.localization.protection_level import MODEL_ERROR, UNNOTICED_M, Reckoned, Reckoning, Wrong, protection_level
from tests.localization.route_bench import CORRELATED_M, Bench, Bounded, Course, Stretch

ROAD_M, STRETCH_M = 3000.0, 500.0
UNMAPPED, RESEMBLES, OFF = 0.1, 0.1, 0.15
OFF_HOW = "turn -90", "turn 180", "stop 45", "reverse 2"
BATCH = 32
"""Drives at a time, whatever the number of processors: the same drives are counted on each computer."""
FIX = PlaceFix(
    stamp_ns=0, place=3, lat_deg=-27.0, lon_deg=153.0, heading_deg=90.0, sigma_along_m=2.0, sigma_across_m=1.0,
    direction="forward", order="same", uniqueness=1.2,
)  # fmt: skip


def stretches(rng: np.random.Generator) -> list[Stretch]:
    """Of a map: some are missing, some shifted; a map is one drive but for what is missing, or several."""
    found: list[Stretch] = []
    several = rng.random() < 0.3
    for begins_m in np.arange(0.0, ROAD_M, STRETCH_M):
        if begins_m > 0 and rng.random() < UNMAPPED:
            continue
        far_m = math.exp(rng.uniform(math.log(5), math.log(500))) if rng.random() < STRETCH_WRONG else 0.0
        angle = rng.uniform(0, 2 * math.pi)
        continues = bool(found) and found[-1].ends_m == begins_m and not several
        shift = far_m * math.sin(angle), far_m * math.cos(angle)
        found.append(Stretch(float(begins_m), float(begins_m) + STRETCH_M, *shift, continues=continues))
    return found


def course(seed: int) -> Course:
    rng = np.random.default_rng([seed, 17])
    mapped = stretches(rng)
    missing = set(np.arange(0.0, ROAD_M, STRETCH_M)) - {one.begins_m for one in mapped}
    alias = (math.inf, math.inf)
    if missing and rng.random() < RESEMBLES:
        begins_m = float(rng.choice(sorted(missing))) + 100.0
        alias = begins_m, begins_m + 128.0
    off_how = str(rng.choice(OFF_HOW)) if rng.random() < OFF else ""
    return Course(
        road_m=ROAD_M,
        stretches=tuple(mapped),
        off_at_m=float(rng.uniform(600, 2400)) if off_how else math.inf,
        off_how=off_how,
        alias=alias,
        alias_from_m=30.0,
        steers=bool(rng.random() < 0.5),
        parallax=bool(rng.random() < 0.5),
        speed_mps=float(rng.uniform(3, 12)),
    )


def drive(seed: int, folder: Path) -> tuple[float, list[Bounded]]:
    """Hours, and the positions."""
    bench = Bench(course(seed), seed, folder)
    found = bench.run().bounded
    return bench.seconds / 3600, found


def exceeded(bounded: list[Bounded]) -> int:
    """Episodes in which a position is further off than its protection level."""
    at_m = [one.at_m for one in bounded if one.along_m > one.level_along_m or one.across_m > one.level_across_m]
    return sum(index == 0 or at - at_m[index - 1] > CORRELATED_M for index, at in enumerate(at_m))


def drives(hours: float, folder: Path) -> tuple[float, list[list[Bounded]]]:
    """Drives of so many hours together, on all processors."""
    driven, found = 0.0, []
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for first in count(0, BATCH):
            seeds = range(first, first + BATCH)
            for one_h, bounded in pool.map(drive, seeds, [folder] * len(seeds)):
                driven += one_h
                found.append(bounded)
            if driven >= hours:
                return driven, found
    raise AssertionError


@pytest.mark.parametrize("hours", [1.0, pytest.param(500.0, marks=pytest.mark.soak)])
def test_errors_exceed_protection_levels_no_more_often_than_stated(hours: float, tmp_path: Path) -> None:
    driven, found = drives(hours, tmp_path)
    episodes = sum(exceeded(bounded) for bounded in found)
    every = np.array([one for bounded in found for one in bounded])
    is_finite = np.isfinite(every[:, 5])
    print(f"{driven:.0f} h, {len(every)} positions, {is_finite.mean():.0%} bounded; exceeded {episodes} times")
    assert episodes <= max(driven * GatesConfig().risk_per_hour, 0.5)
    assert is_finite.mean() > 0.3
    # Apart, since levels with parallax are half of those without: a median of both may be of either.
    shows = np.array([course(seed).parallax for seed, bounded in enumerate(found) for _ in bounded])
    for finite, most in ((every[is_finite & ~shows], 4), (every[is_finite & shows], 5)):
        for error, level in ((1, 5), (2, 6)):
            assert np.median(finite[:, level]) <= most * np.quantile(finite[:, error], 0.95)


def level_of(place: float, reckoned: Reckoned | None, bound: float = 0.1) -> tuple[float, float]:
    level = protection_level(FIX, Wrong(place, 0.0, bound), reckoned, 8.0, 1e-3, 500.0)
    return level.along_m, level.across_m


def test_a_place_that_is_certain_is_bounded_by_its_errors_alone() -> None:
    along_m, across_m = level_of(1e-9, None)
    assert along_m - UNNOTICED_M == pytest.approx(2 * (across_m - UNNOTICED_M))
    assert 5 * MODEL_ERROR < across_m - UNNOTICED_M < 5.3 * MODEL_ERROR  # 480 errors in an hour


def test_a_place_that_may_be_wrong_is_bounded_by_what_no_place_had_a_part_in() -> None:
    """It heads east: what is north of it is across."""
    along_m, across_m = level_of(2e-5, Reckoned(3.0, 40.0, 10.0))
    assert 40 < across_m < 40 + 3 * 10
    assert along_m == pytest.approx(across_m - 37)


@pytest.mark.parametrize(
    ("place", "reckoned", "bound"),
    [(2e-5, None, 0.1), (1e-3, Reckoned(0.0, 0.0, 3.0), 0.1), (2e-5, Reckoned(0.0, 0.0, 3.0), 0.5)],
    ids=["nothing else is known", "wrong too often", "what else is known is wrong too often"],
)
def test_what_nothing_bounds_has_no_level(place: float, reckoned: Reckoned | None, bound: float) -> None:
    assert level_of(place, reckoned, bound) == (math.inf, math.inf)


def test_a_map_that_may_be_shifted_is_bounded_by_reckoning() -> None:
    level = protection_level(FIX, Wrong(1e-9, 1e-3, 0.1), Reckoned(0.0, 60.0, 5.0), 8.0, 1e-3, 500.0)
    assert level.across_m > 60.0


def test_reckoning_moves_as_the_vehicle_did_and_becomes_less_certain() -> None:
    own = VehiclePosition(0, -27.0, 153.0, 0.0, 90.0, 8.0)
    reckoning = Reckoning(drift_percent=5.0)
    assert reckoning.at(FIX, Displacement(1, 0.0, 0.0), 0.0) is None
    reckoning.bind(own, Displacement(1, 10.0, 0.0), 100.0, 3.0)
    found = reckoning.at(FIX, Displacement(1, 90.0, 60.0), 200.0)
    assert found is not None
    assert (found.east_m, found.north_m) == pytest.approx((80.0, 60.0), abs=0.01)
    assert found.sigma_m == pytest.approx(math.hypot(3.0, 5.0))
    assert found.distance_m == pytest.approx(100.0, abs=0.01)
    assert reckoning.at(FIX, Displacement(2, 90.0, 60.0), 200.0) is None, "another leg"
    assert reckoning.at(FIX, None, 200.0) is None
    reckoning.reset()
    assert reckoning.at(FIX, Displacement(1, 90.0, 60.0), 200.0) is None
