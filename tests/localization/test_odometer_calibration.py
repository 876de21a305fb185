"""What GPS shows of an odometer, how certain that is, and what takes it back."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from edge.geodesy import moved
from edge.localization.odometer_calibration import (
    CHANGES,
    LATE_S,
    OdometerCalibration,
    ScaleFactor,
    learned,
)
from tests.common import S
from tests.localization.route_course import HOME

SPEED_MPS = 8.0


def go(
    shown: OdometerCalibration,
    seconds: float,
    scale: Callable[[float], float],
    *,
    gps: bool = True,
    begins_s: float = 0.0,
    seed: int = 1,
    own: Callable[[float], float] = lambda driven_m: driven_m,
) -> None:
    """Straight ahead: five fixes a second, and two readings of wheels whose meters are so many times too short.

    The receiver's error walks, as that of simulated ones does. own: meters by the autopilot, by the true ones.
    """
    rng = np.random.default_rng(seed)
    error, wheels_m = np.zeros(2), begins_s * SPEED_MPS / scale(0.0)
    for step in range(round(seconds * 10) + 1):
        now_s = begins_s + step / 10
        error = error + rng.normal(0.0, 0.2 * math.sqrt(0.1), 2)
        true_m = SPEED_MPS * now_s
        wheels_m += SPEED_MPS / 10 / scale(now_s) if step else 0.0
        if step % 5 == 0:
            shown.add_meters(S + round(now_s * S), wheels_m, own(true_m))
        if gps and step % 2 == 1:
            shown.add_fix(S + round((now_s + LATE_S) * S), moved(*HOME, float(error[0]), true_m + float(error[1])))


@pytest.mark.parametrize("true", [0.97, 1.0, 1.08])
@pytest.mark.parametrize("seconds", [3.0, 9.0, 60.0])
def test_wheels_are_found_to_be_as_wrong_as_they_are(true: float, seconds: float) -> None:
    """The error over its standard deviation, of forty receivers; the longer GPS lasts, the more certain."""
    off = []
    for seed in range(40):
        shown = OdometerCalibration()
        go(shown, seconds, lambda _: true, seed=seed)
        assert shown.scale is not None
        off.append((shown.scale.mean - (true - 1)) / shown.scale.sigma)
        assert shown.scale.sigma < {3.0: 0.2, 9.0: 0.03, 60.0: 0.01}[seconds]
        assert CHANGES <= shown.scale.varies < (3 if seconds < 9 else 2) * CHANGES
    assert 0.2 < np.sqrt(np.mean(np.square(off))) < 1.0


@pytest.mark.parametrize("stood_s", [0, 600])
def test_wheels_that_spin_while_gps_is_healthy_show_that_little_is_known(stood_s: int) -> None:
    """By half too fast, for 3 s of 20; also after a halt, whose wandering receiver explains nothing of it."""
    shown = OdometerCalibration()
    for step in range(-5 * stood_s, 0):
        shown.add_meters(S + step * S // 5, 0.0, 0.0)
        shown.add_fix(S + step * S // 5 + S // 10, moved(*HOME, math.sin(step / 50), 0.0))
    go(shown, 40.0, lambda now_s: 1 / 1.5 if now_s % 20 < 3 else 1.0)
    assert shown.scale is not None and shown.scale.later > 0.1


def test_before_anything_was_driven_nothing_is_shown() -> None:
    shown = OdometerCalibration()
    go(shown, 1.0, lambda _: 1.0)
    assert shown.scale is None


def test_while_the_vehicle_stands_a_receiver_that_wanders_shows_nothing() -> None:
    shown = OdometerCalibration()
    for step in range(600):
        shown.add_meters(S + step * S // 5, 0.0, 0.0)
        shown.add_fix(S + step * S // 5 + S // 10, moved(*HOME, 3 * math.sin(step / 50), 0.0))
    assert shown.scale is None


@pytest.mark.parametrize(("share", "holds"), [(1.0, True), (1.03, True), (0.9, False), (1.1, False)])
def test_what_is_shown_holds_only_for_an_autopilot_that_moves_by_the_odometer(share: float, holds: bool) -> None:
    """share: of the odometer's meters, as the autopilot moves once GPS is lost, by flow or by airspeed."""
    shown = OdometerCalibration()
    go(shown, 20.0, lambda _: 1.0)
    go(shown, 10.0, lambda _: 1.0, gps=False, begins_s=20.0, own=lambda driven_m: share * driven_m)
    assert (shown.scale is not None) == holds


def test_two_findings_are_weighed_by_their_variances() -> None:
    both = ScaleFactor(0.0, 0.06).and_also(ScaleFactor(0.05, 0.03, 0.01))
    assert both == pytest.approx((0.04, 0.06 / math.sqrt(5), 0.01))
    assert both.later == pytest.approx(math.hypot(0.06 / math.sqrt(5), 0.01)), (
        "no number of readings makes it vary less"
    )


def drives_of(rng: np.random.Generator, count: int, varies: float, true: float = 0.03) -> list[ScaleFactor]:
    """What so many drives find of wheels that differ from drive to drive."""
    return [ScaleFactor(true + rng.normal(0.0, math.hypot(varies, 0.004)), 0.004) for _ in range(count)]


@pytest.mark.parametrize("varies", [0.0, 0.003, 0.01])
@pytest.mark.parametrize("count", [3, 10, 20])
def test_the_next_drive_is_as_far_from_what_was_learned_as_that_says(count: int, varies: float) -> None:
    """Of two hundred vehicles; the more drives, the more certain, down to what they differ by."""
    rng, off, sigmas = np.random.default_rng(3), [], []
    for _ in range(200):
        scale = learned(drives_of(rng, count, varies))
        assert scale is not None
        off.append((0.03 + rng.normal(0.0, varies) - scale.mean) / scale.later)
        sigmas.append(scale.later)
    assert np.sqrt(np.mean(np.square(off))) < 1.1
    assert np.median(sigmas) < {3: 0.014, 10: 0.009, 20: 0.006}[count] + varies


def test_one_drive_teaches_nothing_and_new_tires_void_what_was_learned() -> None:
    old, new = [ScaleFactor(0.0, 0.004)] * 10, ScaleFactor(0.12, 0.004)
    assert learned(old[:1]) is None
    assert learned([*old, new]) is None, "nobody knows yet which of both counts"
    both = learned([*old, new, new])
    assert both is not None and both.mean == pytest.approx(0.12)


@pytest.mark.parametrize(("before", "is_changed"), [(0.03, False), (0.2, True)])
def test_what_was_learned_counts_while_this_drive_agrees(before: float, *, is_changed: bool) -> None:
    """Of 9 s with GPS, which alone show 3 %."""
    shown = OdometerCalibration()
    shown.learn(ScaleFactor(before, 0.002, 0.005))
    assert shown.scale == shown.learned
    go(shown, 9.0, lambda _: 1.03)
    assert shown.scale is not None
    assert shown.is_changed == is_changed
    assert shown.scale.mean == pytest.approx(0.03, abs=0.003 if not is_changed else 0.06)
    assert (shown.scale.later < 0.01) == (not is_changed)
