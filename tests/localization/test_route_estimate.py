"""What the Kalman filter knows across the road, on another drive, and of a scale that is in doubt."""

from __future__ import annotations

import numpy as np
import pytest

from edge.localization.odometer import Scale
from edge.localization.route_estimate import (
    MATCH,
    MatchErrors,
    Passed,
    RouteEstimate,
    VelocityErrors,
)

HEADING_RAD, SCALE, MATCH_M, JITTER_M = 0.035, 0.05, 2.5, 1.0
ERRORS = VelocityErrors(HEADING_RAD, SCALE, MatchErrors(MATCH_M))


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


def test_another_drive_has_an_error_of_its_own() -> None:
    passed = Passed(np.zeros(2), np.array([0.0, 1.0]), np.zeros(4))
    estimate = RouteEstimate.on_road(passed, 2.0, ERRORS)
    estimate.correct(passed._replace(place_m=np.array([0.0, 3.0])), JITTER_M)
    assert estimate.mean[MATCH] != 0.0 != estimate.covariance[MATCH, 1]
    before = estimate.covariance[:2, :2].copy()
    estimate.begin_drive(MatchErrors(4.0, whole_m=3.0))
    assert np.allclose(estimate.covariance[:2, :2], before)
    assert estimate.mean[MATCH] == estimate.mean[MATCH + 1] == 0.0
    assert estimate.covariance[MATCH, MATCH] == pytest.approx(4.0 + 9.0)
    assert estimate.covariance[MATCH + 1, MATCH + 1] == pytest.approx(16.0)
    assert not estimate.covariance[MATCH:, :MATCH].any()


def test_a_scale_that_was_expected_too_surely_is_as_uncertain_again_as_if_it_never_was() -> None:
    """All that the state owes to it too, on a winding road of 2 m steps."""
    heading = 0.7 * np.sin(np.arange(31) * 2 * np.pi / 260)
    steps = 2 * np.column_stack([np.sin(heading), np.cos(heading), np.zeros((31, 2))])
    sure, unsure = (RouteEstimate(steps[0, :2], np.eye(2), ERRORS) for _ in range(2))
    sure.expect(Scale(0.03, 0.02))
    unsure.expect(Scale(0.03, SCALE))
    for estimate in (sure, unsure):
        for step in steps[1:]:
            estimate.predict(step)
    before_m = np.sqrt(np.diag(sure.covariance)[:2])
    sure.doubt_scale()
    sigmas, wanted = (np.sqrt(np.diag(estimate.covariance)[:4]) for estimate in (sure, unsure))
    assert sigmas == pytest.approx(wanted, rel=0.25) and (before_m < 0.75 * wanted[:2]).any()
    assert sure.position_m == pytest.approx(unsure.position_m), "what was driven so far was by what was expected"


@pytest.mark.parametrize("forgets", ["nothing", "doubt", "gps"])
def test_what_gps_has_shown_of_the_scale_stays_until_it_is_doubted_or_gps_is_back(forgets: str) -> None:
    estimate = RouteEstimate(np.zeros(2), np.eye(2), ERRORS)
    estimate.expect(Scale(0.03, 0.01, 0.02))
    if forgets == "doubt":
        estimate.doubt_scale()
    elif forgets == "gps":
        estimate.bound(np.zeros(2), 3.0)
    for _ in range(1000):
        estimate.predict(np.array([0.0, 2.0, 0.0, 0.0]))
    wanted = (0.03, np.hypot(0.01, 0.02)) if forgets == "nothing" else (0.0, SCALE)
    assert estimate.scale[:2] == pytest.approx(wanted, rel=0.02, abs=0.002)
