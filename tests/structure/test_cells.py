"""Where two drives fit each other, by poles whose places are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.keypoints import MapPoints
from edge.structure.cells import Fit, best_fit
from edge.structure.path import DrivePath

LENGTH_M, WINDOW_M, SEARCH_M = 300.0, 40.0, 20.0


def poles(rng: np.random.Generator, each_m: float = 0.0) -> NDArray[np.float64]:
    """Poles (n, 3) along a road, which repeat after some meters if each_m is not 0; every one is some points."""
    at = np.column_stack([rng.uniform(0, each_m or LENGTH_M, 200), rng.uniform(-10, 10, 200), rng.uniform(-1, 6, 200)])
    if each_m:
        at = np.concatenate([at + np.array([start_m, 0, 0]) for start_m in np.arange(0, LENGTH_M, each_m)])
    return np.repeat(at, 3, axis=0)


def fitted(along_m: float, left_m: float, believed_m: float, each_m: float = 0.0) -> Fit | None:
    """A window whose middle lies there, where the vehicle is believed to be so much further."""
    rng = np.random.default_rng(1)
    world_m = poles(rng, each_m)
    here, there = (world_m[rng.random(len(world_m)) < 0.5] for _ in range(2))
    return best_fit(here - (along_m, left_m, 0.0), there, along_m + believed_m, WINDOW_M, SEARCH_M)


@pytest.mark.parametrize(("left_m", "believed_m"), [(0.0, 7.0), (-3.0, -12.0), (2.5, 0.0)])
def test_a_window_is_found_along_and_beside_the_drive_of_the_map(left_m: float, believed_m: float) -> None:
    fit = fitted(150.0, left_m, believed_m)
    assert fit is not None
    assert (fit.along_m, fit.left_m) == pytest.approx((150.0, left_m), abs=0.5)


def test_two_places_that_fit_alike_are_no_match() -> None:
    assert fitted(150.0, 0.0, 3.0, each_m=15.0) is None


def test_a_window_at_the_edge_of_what_is_searched_is_no_match() -> None:
    assert fitted(150.0, 0.0, SEARCH_M + 3.0) is None


def test_a_street_without_points_is_no_match() -> None:
    assert best_fit(np.empty((0, 3)), np.empty((0, 3)), 150.0, WINDOW_M, SEARCH_M) is None


def test_points_lie_beside_the_path_which_bends_and_beyond_its_ends_goes_on_straight() -> None:
    """A quarter of a circle of 50 m to the left; a point 20 m before the camera of its last row, and one behind it."""
    angle = np.linspace(0, np.pi / 2, 40)
    ground_m = 50 * np.column_stack([np.cos(angle) - 1, np.sin(angle)])
    path = DrivePath(50 * angle, ground_m, -angle)
    points = MapPoints(np.array([[0.1, -0.05, 1 / 20], [0.0, 0.0, np.nan], [0.0, 0.0, 1 / 60]]), np.full(3, 1e-4))
    ahead = path.points_of(39, points, faces_back=False)
    assert ahead == pytest.approx(np.array([[path.along_m[-1] + 20, -2.0, 1.0]]), abs=0.5)
    (behind,) = path.points_of(39, points, faces_back=True)
    east_m, north_m = -30.0, 48.0  # it went to the west at last
    assert behind[1] == pytest.approx(50 - np.hypot(east_m + 50, north_m), abs=0.1)
    assert behind[0] == pytest.approx(50 * np.arctan2(north_m, east_m + 50), abs=0.5)
