"""The Kalman filter against drives that are drawn from its own model: its covariance must be that of its errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.localization.odometer import Scale
from edge.localization.route_estimate import (
    CORRELATION_M,
    MATCH,
    MatchErrors,
    Passed,
    RouteEstimate,
    VelocityErrors,
)

HEADING_RAD, SCALE, MATCH_M, JITTER_M, BEHIND = 0.035, 0.05, 2.5, 1.0, 20
ERRORS = VelocityErrors(HEADING_RAD, SCALE, MatchErrors(MATCH_M))


def winding(places: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors along a road of 2 m steps, and its points."""
    heading = 0.7 * np.sin(np.arange(places) * 2 * np.pi / 260)
    along = np.column_stack([np.sin(heading), np.cos(heading)])
    return along, np.cumsum(2 * along, axis=0)


def drive(seed: int, places: int = 400) -> tuple[RouteEstimate, NDArray[np.float64]]:
    """A drive whose errors are drawn from the model; the estimate at its end, and its errors (4,) there."""
    rng = np.random.default_rng(seed)
    along, points = winding(places)
    heading_rad, scale, across_m = rng.normal(0, [HEADING_RAD, SCALE, 2.0])
    sin, cos = np.sin(heading_rad), np.cos(heading_rad)
    steps = np.diff(points, axis=0, prepend=points[:1])
    reckoned = np.cumsum(steps @ np.array([[cos, sin], [-sin, cos]]) / (1 + scale), axis=0)
    reckoned = np.column_stack([reckoned, np.zeros((places, 2))])
    stays_m, wander_m, kept = rng.normal(0, MATCH_M / 2), rng.normal(0, MATCH_M), np.exp(-2 / CORRELATION_M)
    estimate = None
    for at in range(BEHIND, places):
        wander_m = kept * wander_m + np.sqrt(1 - kept**2) * rng.normal(0, MATCH_M)
        middle = at - BEHIND
        seen = points[middle] + along[middle] * (stays_m + wander_m + rng.normal(0, JITTER_M))
        since = reckoned[at] - reckoned[middle]
        if estimate is None:
            left = np.array([-along[middle][1], along[middle][0]])
            estimate = RouteEstimate.on_road(Passed(seen + across_m * left, along[middle], since), 2.0, ERRORS)
        else:
            estimate.predict(reckoned[at] - reckoned[at - 1])
        estimate.correct(Passed(seen, along[middle], since), JITTER_M)
    assert estimate is not None
    return estimate, estimate.mean[:4] - [*points[-1], heading_rad, scale]


def test_the_covariance_is_that_of_the_errors() -> None:
    squares = []
    for seed in range(40):
        estimate, errors = drive(seed)
        squares.append(errors @ np.linalg.solve(estimate.covariance[:4, :4], errors) / 4)
    assert 0.4 <= np.mean(squares) <= 1.3, "1 where it is exact, less where it is cautious"


def test_matches_of_one_correlation_length_are_about_one_observation() -> None:
    along, points = winding(40)
    estimate = RouteEstimate.on_road(Passed(points[0], along[0], np.zeros(4)), 2.0, ERRORS)
    sigmas_m = []
    for at in range(30):
        estimate.predict(np.array([*(2 * along[at]), 0.0, 0.0]) if at else np.zeros(4))
        estimate.correct(Passed(points[at], along[at], np.zeros(4)), JITTER_M)
        sigmas_m.append(np.sqrt(along[at] @ estimate.covariance[:2, :2] @ along[at]))
    assert MATCH_M <= sigmas_m[-1] <= sigmas_m[0] <= 1.3 * sigmas_m[-1]


def test_the_road_bounds_what_is_not_known_across_and_never_more() -> None:
    passed = Passed(np.zeros(2), np.array([0.0, 1.0]), np.zeros(4))
    estimate = RouteEstimate.on_road(passed, 1.0, ERRORS)
    estimate.correct(passed, JITTER_M)
    for _ in range(100):
        estimate.keep_on_road(passed, 3.0)
    assert estimate.covariance[0, 0] == pytest.approx(1.0), "it was better known before"
    for _ in range(100):
        estimate.predict(np.array([0.0, 5.0, 0.0, 0.0]))
        passed = passed._replace(place_m=passed.place_m + np.array([0.0, 5.0]))
        estimate.keep_on_road(passed, 3.0)
    assert estimate.covariance[0, 0] == pytest.approx(9.0)
    assert np.sqrt(estimate.covariance[2, 2]) == pytest.approx(HEADING_RAD, rel=0.05), "it says nothing of the heading"


def test_gps_bounds_the_position_and_says_nothing_of_the_velocity_without_it() -> None:
    estimate = RouteEstimate(np.array([20.0, 0.0]), 30.0**2 * np.eye(2), ERRORS)
    for _ in range(200):
        estimate.predict(np.array([0.0, 5.0, 0.0, 0.0]))
        estimate.bound(np.array([0.0, 5.0 * (_ + 1)]), 3.0)
    assert np.sqrt(np.diag(estimate.covariance))[:2] == pytest.approx(3.0, rel=0.01), "however often it is seen"
    assert estimate.position_m == pytest.approx([0.0, 1000.0], abs=0.5)
    assert np.sqrt(np.diag(estimate.covariance))[2:4] == pytest.approx([HEADING_RAD, SCALE])


def test_another_drive_has_an_error_of_its_own() -> None:
    estimate, _ = drive(1)
    before = estimate.covariance[:2, :2].copy()
    estimate.begin_drive(MatchErrors(4.0, whole_m=3.0))
    assert np.allclose(estimate.covariance[:2, :2], before)
    assert estimate.mean[MATCH] == estimate.mean[MATCH + 1] == 0.0
    assert estimate.covariance[MATCH, MATCH] == pytest.approx(4.0 + 9.0)
    assert estimate.covariance[MATCH + 1, MATCH + 1] == pytest.approx(16.0)
    assert not estimate.covariance[MATCH:, :MATCH].any()


def test_displacements_are_turned_clockwise_and_scaled() -> None:
    estimate = RouteEstimate(np.zeros(2), np.eye(2), ERRORS)
    estimate.mean[2:4] = np.pi / 2, 0.1
    assert estimate.truly(np.array([0.0, 10.0, 0.0, 0.0])) == pytest.approx([11.0, 0.0])


def test_what_is_doubtful_was_driven_or_not_and_only_what_was_passed_since_it_began_says_which() -> None:
    """Reckoned are 40 m, of which wheels that spun are 12: the vehicle is between 28 and 40 m further."""
    for passed_m, since_m, sigma_m, at_m in (
        (0.0, (0.0, 40.0, 0.0, 12.0), (5.5, 7.0), (33.0, 35.0)),
        (28.0, (0.0, 0.0, 0.0, 0.0), (0.5, 1.5), (28.0, 29.0)),
    ):
        errors = VelocityErrors(HEADING_RAD, 0.01, MatchErrors(1.0))
        estimate = RouteEstimate(np.zeros(2), np.eye(2), errors)
        for _ in range(20):
            estimate.predict(np.array([0.0, 2.0, 0.0, 0.6]))
        estimate.correct(Passed(np.array([0.0, passed_m]), np.array([0.0, 1.0]), np.array(since_m)), 0.5)
        assert at_m[0] <= estimate.position_m[1] <= at_m[1]
        assert sigma_m[0] <= np.sqrt(estimate.covariance[1, 1]) <= sigma_m[1]


def test_a_scale_that_was_expected_too_surely_is_as_uncertain_again_as_if_it_never_was() -> None:
    """All that the state owes to it too, on a winding road."""
    _, points = winding(120)
    sure, unsure = (RouteEstimate(points[0], np.eye(2), ERRORS) for _ in range(2))
    sure.expect(Scale(0.03, 0.02))
    unsure.expect(Scale(0.03, SCALE))
    for estimate in (sure, unsure):
        for at in range(30):
            estimate.predict(np.array([*(points[at + 1] - points[at]), 0.0, 0.0]))
    before_m = np.sqrt(np.diag(sure.covariance)[:2])
    sure.doubt_scale()
    sigmas, wanted = (np.sqrt(np.diag(estimate.covariance)[:4]) for estimate in (sure, unsure))
    assert sigmas == pytest.approx(wanted, rel=0.25) and (before_m < 0.75 * wanted[:2]).any()
    assert sure.position_m == pytest.approx(unsure.position_m), "what was driven so far was by what was expected"


def test_what_gps_has_shown_of_the_scale_fades() -> None:
    estimate = RouteEstimate(np.zeros(2), np.eye(2), ERRORS)
    estimate.expect(Scale(0.03, 0.01))
    for _ in range(1000):
        estimate.predict(np.array([0.0, 2.0, 0.0, 0.0]))
    assert estimate.scale.mean == pytest.approx(0.0, abs=0.002) and estimate.scale.sigma == pytest.approx(
        SCALE, rel=0.02
    )
