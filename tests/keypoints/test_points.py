"""Distances of a row's keypoints, against points whose distance is known."""

from __future__ import annotations

import numpy as np
import pytest

from edge.keypoints.points import points_of
from edge.keypoints.view_geometry import CameraModel, Projection
from tests.keypoints.street import CAMERA, row_points, seen, street


def test_a_camera_looks_straight_ahead_at_its_middle_and_half_its_view_at_its_edge() -> None:
    directions = CameraModel(320, 240, 90.0).directions(np.array([[159.5, 119.5], [319.5, 119.5]]))
    assert directions == pytest.approx(np.array([[0, 0], [1, 0]]))


@pytest.mark.parametrize("camera", [(0.7, 2.0, 0.3, 0.05), (-3.0, -4.0, -0.2, -0.03)])
def test_sights_are_those_of_rotation_matrices_and_their_derivatives_are_differences(camera: tuple[float, ...]) -> None:
    world_m = street(np.random.default_rng(1), 20)
    places = np.column_stack([seen(world_m, (0, 0, 0, 0)), 1 / world_m[:, 2]])
    sight = Projection(np.array(camera), places)
    assert sight.directions == pytest.approx(seen(world_m, camera))
    small = 1e-7
    for axis in range(4):
        moved = Projection(np.array(camera) + small * np.eye(4)[axis], places).directions
        assert (moved - sight.directions) / small == pytest.approx(sight.by_camera()[..., axis], abs=1e-4)
    for axis in range(3):
        moved = Projection(np.array(camera), places + small * np.eye(3)[axis]).directions
        assert (moved - sight.directions) / small == pytest.approx(sight.by_point()[..., axis], abs=1e-4)


def test_distances_are_as_well_known_as_stated_though_headings_are_a_degree_off() -> None:
    rng = np.random.default_rng(2)
    world_m = street(rng, 200)
    found = row_points(rng, world_m, pixels=0.7, turned_deg=1.0)
    known = found.is_known
    off = (found.places[known, 2] - 1 / world_m[known, 2]) / found.sigma[known]
    assert known.mean() > 0.9
    assert np.median(np.abs(off)) < 1.2  # 0.67 of what is normal; turns that were corrected are shared
    assert np.median(found.sigma[known] * world_m[known, 2]) < 0.1


def test_points_that_fewer_than_three_rows_see_have_no_distance_and_keep_their_direction() -> None:
    world_m = street(np.random.default_rng(3), 30)
    own = seen(world_m, (0, 0, 0, 0))
    matched = np.full((3, 30, 2), np.nan)
    matched[:, :20] = [seen(world_m[:20], (0, ahead_m, 0, 0)) for ahead_m in (2, 4, 6)]
    matched[1:, :5] = np.nan
    found = points_of(own, matched, np.array([(0, 2, 0), (0, 4, 0), (0, 6, 0)]), CAMERA)[0]
    assert found.is_known.tolist() == [False] * 5 + [True] * 15 + [False] * 10
    assert found.places[~found.is_known, :2] == pytest.approx(own[~found.is_known])
    assert np.isnan(found.places[~found.is_known, 2]).all()
    assert found.places[found.is_known, 2] == pytest.approx(1 / world_m[found.is_known, 2], rel=0.01)


def test_no_match_is_no_point() -> None:
    found = points_of(np.zeros((4, 2)), np.full((2, 4, 2), np.nan), np.array([(0, 2, 0), (0, 4, 0)]), CAMERA)[0]
    assert not found.is_known.any()
