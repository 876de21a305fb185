"""That errors exceed their protection levels no more often than stated, by counting on seeded drives without pictures.

`level_hours` has the drives. docs/integrity.md names these tests.
"""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from statistics import NormalDist

import msgspec
import numpy as np
import pytest
from tests.localization.splitting import LEVELS

from edge.config import GatesConfig
from edge.localization import Displacement, PlaceFix
from edge.localization.bound import Anchor, Reckoned
from edge.localization.integrity import UNNOTICED
from edge.localization.protection_level import MODEL_ERROR, Wrong, protection_level
from sim.research.trial.table import put_between
from tests.localization import level_course, level_hours
from tests.localization.route_bench import LANE_M, Bench
from tests.localization.route_course import Course, Stretch

FIX = PlaceFix(
    stamp_ns=0, place=3, lat_deg=-27.0, lon_deg=153.0, heading_deg=90.0, sigma_along_m=2.0, sigma_across_m=1.0,
    direction="forward", order="same", uniqueness=1.2,
)  # fmt: skip


def test_errors_exceed_protection_levels_no_more_often_than_stated(tmp_path: Path) -> None:
    """On maps that are right; `make soak` drives for hours."""
    first = level_hours.seed_of_run()
    found = []
    for seed in range(first, first + 10):
        drawn, _ = level_course.course(seed)
        bounded = Bench(drawn, seed, tmp_path).run().bounded
        assert level_hours.exceeded(bounded) == 0
        found.append((drawn.parallax, np.array(bounded).reshape(-1, 7)))
    # Apart, since levels with parallax are half of those without: a median of both may be of either.
    # 3.5 to 4.6 and 8.9 to 9.0 times the 95 % error in these ten drives; other seeds scatter.
    for parallax, most in ((False, 6), (True, 10)):
        every = np.concatenate([bounded for has_parallax, bounded in found if has_parallax is parallax])
        is_finite = np.isfinite(every[:, 5])
        assert is_finite.mean() > 0.3
        for error, level in ((1, 5), (2, 6)):
            assert np.median(every[is_finite, level]) <= most * np.quantile(every[is_finite, error], 0.95)


@pytest.mark.soak
def test_errors_exceed_protection_levels_no_more_often_than_stated_on_maps_that_are_shifted() -> None:
    """Weighted by how often they are: see docs/integrity.md for what so many drives can show."""
    found = level_hours.groups(level_hours.seeds([2] * len(level_course.CLASSES), level_hours.seed_of_run()))
    print(level_hours.statement(found, level_hours.seed_of_run()))
    estimate, _ = level_hours.rate(found)
    assert estimate <= GatesConfig().risk_per_hour


@pytest.mark.parametrize("seed", (2015, 2032, 2038))
def test_a_stretch_that_is_shifted_by_what_nothing_notices_is_within_the_level(seed: int, tmp_path: Path) -> None:
    """500 m of one drive of the map, 9 to 20 m off, and parallax: levels of 2.5 m and 6.2 sigma were exceeded."""
    rng = np.random.default_rng([seed, 6])
    far_m, angle = math.exp(rng.uniform(math.log(5), math.log(40))), rng.uniform(0, 2 * math.pi)
    off_m = far_m * math.sin(angle), far_m * math.cos(angle)
    shifted = Stretch(800.0, 1300.0, *off_m, continues=True)
    stretches = Stretch(0.0, 800.0), shifted, Stretch(1300.0, 1700.0, continues=True)
    steers, speed_mps = bool(rng.random() < 0.5), float(rng.uniform(3, 12))
    drawn = Course(road_m=1700.0, stretches=stretches, steers=steers, parallax=True, speed_mps=speed_mps)
    bounded = Bench(drawn, seed, tmp_path).run().bounded
    assert any(math.isfinite(one.level_along_m) for one in bounded)
    assert level_hours.exceeded(bounded) == 0


def test_groups_that_were_driven_by_other_code_are_not_used(tmp_path: Path) -> None:
    kept, name = tmp_path / "groups.jsonl", "by 8 to 40 m"
    drawn, _ = level_course.course(7, level_course.CLASSES[name])
    first_m = level_hours.summed_m(Bench(drawn, 7, tmp_path).run())
    assert first_m > 10
    one = level_hours.Group(name, 7, 20, 0.1, [0.0] * len(LEVELS), (None, (26.1, 22.5)), first_m)
    kept.write_bytes(msgspec.json.encode(one) + b"\n")
    known = level_hours.read(kept)
    assert known == {7: one}
    level_hours.check(kept, known)
    with pytest.raises(ValueError, match="group 7 was driven by other code; delete the file"):
        level_hours.check(kept, {7: msgspec.structs.replace(one, first_m=1.001 * first_m)})
    with pytest.raises(ValueError, match="group 7 is of another class; delete the file"):
        level_hours.check(kept, {7: msgspec.structs.replace(one, drives=50)})
    kept.write_bytes(b"{}\n")
    with pytest.raises(ValueError, match="line 1: Object missing required field `of_class`"):
        level_hours.read(kept)


@pytest.mark.soak
def test_the_kept_groups_are_of_this_code() -> None:
    level_hours.check(level_hours.KEPT, level_hours.read(level_hours.KEPT))


def test_the_page_says_what_the_kept_groups_show(tmp_path: Path) -> None:
    """All of them: no group is kept that the page does not count."""
    known = level_hours.read(level_hours.KEPT)
    every = [known[seed] for seed in sorted(known)]
    found = {name: [one for one in every if one.of_class == name] for name in level_course.CLASSES}
    page = Path(__file__).parents[2] / "docs" / "integrity.md"
    again = Path(shutil.copy(page, tmp_path))
    put_between("level hours", again, level_hours.statement(found, min(known)))
    assert again.read_text(encoding="utf-8") == page.read_text(encoding="utf-8")
    _, bounds = level_hours.rate(found)
    assert sum(bounds.values()) <= GatesConfig().risk_per_hour


def groups(count: int, reached: dict[int, dict[int, float]]) -> list[level_hours.Group]:
    """reached: by the number of a group, how often it comes to a level."""
    found = []
    for number in range(count):
        near = np.zeros(len(LEVELS))
        for level, share in reached.get(number, {}).items():
            near[: level % len(LEVELS) + 1] = share
        found.append(level_hours.Group("right", number, 50, 0.05, near.tolist(), (None, None), 0.0))
    return found


def test_the_bound_of_a_rate_falls_with_how_near_drives_came() -> None:
    often = groups(100, {number: {-1: 0.01} for number in range(20)})
    few = groups(100, {number: {3: 1e-3} for number in range(level_hours.FEW - 1)})
    estimate, bounds = level_hours.rate({"right": few, "shifted": often})
    assert estimate == pytest.approx(0.2 * 0.01 / 0.1)
    assert estimate < bounds["shifted"] < 2 * estimate
    assert bounds["right"] == math.inf, "a class of which too few come near may be anything"
    near = groups(100, {number: {3: 1e-3} for number in range(20)})
    _, bounds = level_hours.rate({"right": near, "shifted": often})
    assert 2e-3 < bounds["right"] < 2 * 2e-3


def test_a_level_to_which_few_groups_come_hides_those_above() -> None:
    even = groups(100, {number: {10: 1e-3} for number in range(20)})
    assert level_hours.bounding_level(even) == 10
    even[50].reached[6] = 0.5
    assert level_hours.bounding_level(even) == 5


def test_errors_exceed_their_level_less_often_than_the_bound() -> None:
    """Errors as shares of their levels are normal in each group, and so are their means: how often is then known.

    Where few groups come near, the level that is chosen is one that they happen to come to; errors exceed it less.
    """
    rng, means, errors, count = np.random.default_rng(1), NormalDist(0.3, 0.1), NormalDist(0.0, 0.07), 60
    every, of_level = means + errors, []
    for _ in range(count):
        found = groups(300, {})
        for one, mean in zip(found, rng.normal(means.mean, means.stdev, len(found)), strict=True):
            one.reached[:] = [errors.cdf(mean - level) for level in LEVELS]
        level, bound = level_hours.bounding_level(found), level_hours.upper_bound(found, 0.05)
        assert level is not None
        assert 0.5 < LEVELS[level] < 0.75
        assert bound > 1 - every.cdf(1.0)
        of_level.append(bound > 1 - every.cdf(LEVELS[level]))
    assert np.mean(of_level) > 0.8


def test_where_groups_differ_widely_a_level_is_reached_2_2_times_as_often_as_the_bound_at_most() -> None:
    """Logarithms with a sigma of 2: mostly too few groups are alike; where they are, what is rare is missing."""
    rng, sigma, tried = np.random.default_rng(1), 2.0, 0
    found: list[float] = []
    while len(found) < 300:
        drawn = rng.lognormal(0.0, sigma, 40)
        every = [
            level_hours.Group("right", 0, 50, 0.05, [share] * len(LEVELS), (None, None), 0.0)
            for share in drawn.tolist()
        ]
        tried += 1
        if level_hours.bounding_level(every) is not None:
            found.append(math.exp(sigma**2 / 2) / level_hours.upper_bound(every, 0.05 / 4))
    assert len(found) < 0.2 * tried
    assert np.quantile(found, 0.95) == pytest.approx(2.2, abs=0.1)


def test_what_is_drawn_is_weighted_by_how_often_it_occurs() -> None:
    """The weights of all classes add up to one, and those of the shifted ones to how often a stretch is shifted."""
    found = {
        name: [level_course.course(seed, of_class) for seed in range(6000)]
        for name, of_class in level_course.CLASSES.items()
    }
    weights = {name: np.mean([weight for _, weight in drawn]) for name, drawn in found.items()}
    assert sum(weights.values()) == pytest.approx(1.0, abs=0.03)
    assert weights["right"] == pytest.approx((1 - 5e-3) ** 5.5, abs=0.03)
    for name, drawn in found.items():
        weight = np.array([weight for _, weight in drawn]) / weights[name] / len(drawn)
        of = [one for one, _ in drawn]
        assert weight @ [one.parallax for one in of] == pytest.approx(level_course.OCCUR.parallax, abs=0.05)
        assert weight @ [one.steers for one in of] == pytest.approx(level_course.OCCUR.steers, abs=0.05)
        assert weight @ [one.off_how == "reverse 2" for one in of] == pytest.approx(0.0375, abs=0.015)
        motion = np.array([(one.scale, one.heading_deg) for one in of], float)
        sigmas = level_course.SCALE, level_course.HEADING_DEG
        assert np.sqrt(weight @ motion**2) == pytest.approx(sigmas, rel=0.1)
        several_shifted = [sum(part.east_m != 0.0 for part in one.stretches) > 1 for one in of]
        # 4.5 other stretches; a map with two comes from either of them, so each counts half.
        occurs = 0.0 if name == "right" else 4.5 * 5e-3 / 2
        assert weight @ several_shifted == pytest.approx(occurs, abs=0.004)
        wider = level_course.CLASSES[name].shares.wider
        assert (motion.std(axis=0) > 0.95 * wider * np.array(sigmas)).all(), "what is rare is drawn often"


def test_a_shift_that_odometer_and_heading_hide_is_drawn_often_and_weighted() -> None:
    of_class, drawn, found = level_course.CLASSES["by 40 to 500 m"], level_course.Drawn(np.random.default_rng(1)), []
    for _ in range(20_000):
        drawn.weight = 1.0
        east_m, north_m = drawn.shift_m(of_class, (60.0, 0.0))
        found.append((drawn.weight, math.hypot(east_m, north_m), math.atan2(north_m, east_m)))
    weight, far_m, aside = np.array(found).T
    assert ((far_m > 40) & (far_m < 500)).all()
    assert np.mean((np.abs(far_m - 60) < 30) & (np.abs(aside) < 1)) > 0.5
    assert weight.mean() == pytest.approx(math.log(500 / 40) / math.log(500 / 5), rel=0.03)
    weight /= weight.sum()
    assert weight @ np.log(far_m) == pytest.approx((math.log(40) + math.log(500)) / 2, abs=0.05)
    assert (weight @ np.cos(aside), weight @ np.sin(aside)) == pytest.approx((0.0, 0.0), abs=0.05)


def test_what_odometer_and_heading_are_wrong_by_is_what_the_vehicle_drifts_by(tmp_path: Path) -> None:
    drawn = Course(road_m=800.0, stretches=(Stretch(0.0, 100.0),), scale=0.05, heading_deg=3.0, speed_mps=10.0)
    bench = Bench(drawn, 5, tmp_path)
    bench.run()
    expected_m = level_course.drift_m(drawn, 5, 798.0)
    assert math.hypot(*expected_m) > 20
    assert bench.alone - bench.truth == pytest.approx(expected_m, abs=2.0)


def test_what_the_map_and_the_lane_are_off_by_is_weighted_as_well() -> None:
    of_class = level_course.CLASSES["right"]
    found = [level_course.course(seed, of_class) for seed in range(6000)]
    weight = np.array([weight for _, weight in found]) / sum(weight for _, weight in found)
    off_m = np.array([(*(one.map_off_m or ()), one.lane_m) for one, _ in found], float)
    assert np.sqrt(weight @ off_m**2) == pytest.approx((1.0, 1.0, LANE_M), rel=0.1)
    assert off_m.std(axis=0) == pytest.approx(of_class.shares.beside * np.array([1.0, 1.0, LANE_M]), rel=0.1)


def level_of(place: float, reckoned: Reckoned | None, bound: float = 0.1) -> tuple[float, float]:
    level = protection_level(FIX, Wrong(place, 0.0, bound), UNNOTICED, reckoned, 8.0, 1e-3, 500.0)
    return level.along_m, level.across_m


def test_a_place_that_is_certain_is_bounded_by_its_errors_and_what_nothing_notices() -> None:
    along_m, across_m = level_of(1e-9, None)
    shift_m = UNNOTICED.most_m
    assert along_m - shift_m == pytest.approx(2 * (across_m - shift_m))
    assert 3.4 * MODEL_ERROR < across_m - shift_m < 3.6 * MODEL_ERROR  # 58 stretches in an hour, of which 1 in 200


def test_an_uncertain_place_is_bounded_by_its_errors_alone() -> None:
    uncertain = msgspec.structs.replace(FIX, sigma_along_m=10.0)
    level = protection_level(uncertain, Wrong(1e-9, 0.0, 0.1), UNNOTICED, None, 8.0, 1e-3, 500.0)
    assert 5 * MODEL_ERROR < level.along_m / 10 < 5.3 * MODEL_ERROR  # 480 errors in an hour


def test_a_place_that_may_be_wrong_is_bounded_by_what_no_place_had_a_part_in() -> None:
    """It heads east: what is north of it is across."""
    along_m, across_m = level_of(2e-5, Reckoned(3.0, 40.0, 10.0))
    assert 40 < across_m < 40 + 3 * 10
    assert along_m == pytest.approx(across_m - 37)


def test_what_reckoning_is_off_by_is_along_and_across_the_heading() -> None:
    """North-east of a vehicle that heads north-east, it is off along the road alone."""
    northeast = msgspec.structs.replace(FIX, heading_deg=45.0)
    level = protection_level(northeast, Wrong(2e-5, 0.0, 0.1), UNNOTICED, Reckoned(30.0, 30.0, 1.0), 8.0, 1e-3, 500.0)
    assert level.along_m > math.hypot(30.0, 30.0)
    assert level.across_m < 30.0


@pytest.mark.parametrize(
    ("place", "reckoned", "bound"),
    [(2e-5, None, 0.1), (1e-3, Reckoned(0.0, 0.0, 3.0), 0.1), (2e-5, Reckoned(0.0, 0.0, 3.0), 0.5)],
    ids=["nothing else is known", "wrong too often", "what else is known is wrong too often"],
)
def test_what_nothing_bounds_has_no_level(place: float, reckoned: Reckoned | None, bound: float) -> None:
    assert level_of(place, reckoned, bound) == (math.inf, math.inf)


def test_a_map_that_may_be_shifted_is_bounded_by_reckoning() -> None:
    level = protection_level(FIX, Wrong(1e-9, 1e-3, 0.1), UNNOTICED, Reckoned(0.0, 60.0, 5.0), 8.0, 1e-3, 500.0)
    assert level.across_m > 60.0


def test_reckoning_moves_as_the_vehicle_did_and_becomes_less_certain() -> None:
    anchor = Anchor(-27.0, 153.0, 3.0, Displacement(1, 10.0, 0.0))
    found = anchor.reckoned(FIX, Displacement(1, 90.0, 60.0), 0.05)
    assert (found.east_m, found.north_m) == pytest.approx((80.0, 60.0), abs=0.01)
    assert found.sigma_m == pytest.approx(math.hypot(3.0, 5.0))
    assert found.distance_m == pytest.approx(100.0, abs=0.01)
    assert anchor.reckoned(FIX, Displacement(1, 90.0, 60.0), 0.05, 400.0).sigma_m == pytest.approx(
        math.hypot(3.0, 20.0)
    )
    unheard = anchor.reckoned(FIX, Displacement(2, 90.0, 60.0, unknown_m=80.0), 0.05)
    assert unheard.sigma_m == pytest.approx(math.hypot(3.0, 5.0, 80 / 3**0.5)), "another leg"
