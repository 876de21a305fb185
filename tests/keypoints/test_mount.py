"""Cameras that look down or aside, against points and poses that are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.feed import FeedImages, read_feed
from edge.keypoints.drive_points import points_of_drive
from edge.keypoints.mount import Mount, mount_of_drive, yaw_of
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.points import points_of
from edge.keypoints.view_geometry import CameraModel
from tests.keypoints.street import CAMERA, ROWS, seen, street, with_noise


def mounted(directions: NDArray[np.float64], down_deg: float, right_deg: float) -> NDArray[np.float64]:
    """What a level camera sees in these directions (..., 2), as one sees it that is turned right, then down."""
    rays = np.concatenate([directions, np.ones((*directions.shape[:-1], 1))], axis=-1)
    right, down = np.radians([right_deg, down_deg])
    sideways = np.array([[np.cos(right), 0, -np.sin(right)], [0, 1, 0], [np.sin(right), 0, np.cos(right)]])
    nod = np.array([[1, 0, 0], [0, np.cos(down), -np.sin(down)], [0, np.sin(down), np.cos(down)]])
    turned = rays @ (nod @ sideways).T
    found: NDArray[np.float64] = turned[..., :2] / turned[..., 2:]
    return found


@pytest.mark.parametrize("mount_deg", [(0.0, 0.0), (3.0, 0.0), (0.0, -3.0), (0.0, 8.0), (-5.0, 5.0)])
def test_a_drive_shows_how_its_camera_is_mounted_and_its_points_are_as_by_a_level_one(
    mount_deg: tuple[float, float],
) -> None:
    rng, mounts = np.random.default_rng(1), []
    for _ in range(4):
        world_m = street(rng, 150)
        nods = [(*row, rng.normal(0, np.radians(0.3))) for row in ROWS]
        matched = np.stack([with_noise(rng, mounted(seen(world_m, row), *mount_deg), 0.7) for row in nods])
        matched[rng.random(matched.shape[:2]) < 0.3] = np.nan
        own = mounted(seen(world_m, (0, 0, 0, 0)), *mount_deg)
        points, of_row = points_of(with_noise(rng, own, 0.7), matched, ROWS, CAMERA)
        assert np.degrees(of_row.radians) == pytest.approx(mount_deg, abs=1.0)
        mounts.append(Mount(of_row.radians, 200 * of_row.information))
    mount = mount_of_drive(mounts)
    assert np.degrees(mount.radians) == pytest.approx(mount_deg, abs=0.3)
    known, level = points.is_known, points.turned(mount.rotation.T)
    assert known.mean() > 0.9
    assert level.places[known, :2] == pytest.approx(seen(world_m, (0, 0, 0, 0))[known], abs=0.02)
    assert np.median(np.abs(level.places[known, 2] * world_m[known, 2] - 1)) < 0.1


def test_wrong_matches_of_a_bending_street_turn_its_camera_by_little() -> None:
    """By 1.2 degrees where all matches within 2.5 pixels count alike, and all poses on such a map with it."""
    feed, network = read_feed(Path(__file__).parents[1] / "golden/recordings/elsewhere"), KeypointNetwork()
    images = FeedImages(feed)
    keypoints = [network.extract(images.read(row), 300) for row in range(len(feed.rows))]
    images.close()
    route_m, heading = np.array([(row.distance_m, np.radians(row.heading_deg or 0.0)) for row in feed.rows], float).T
    camera = CameraModel(feed.header.width, feed.header.height, CAMERA.fov_deg)
    found = points_of_drive(keypoints.__getitem__, route_m, heading, camera, range(len(route_m)), faces_back=True)
    assert np.degrees(mount_of_drive(of_row for _, of_row in found).radians[1]) == pytest.approx(0.0, abs=0.9)


def test_level_directions_are_those_of_rays_turned_back() -> None:
    mount, directions = Mount(np.array([0.1, -0.2]), np.eye(2)), np.array([[0.3, -0.1], [-0.5, 0.2]])
    assert mount.leveled(mounted(directions, np.degrees(0.1), np.degrees(-0.2))) == pytest.approx(directions)


def test_directions_of_both_say_how_far_a_camera_points_sideways() -> None:
    mount, directions = Mount(np.array([0.1, -0.2]), np.eye(2)), np.random.default_rng(0).uniform(-0.8, 0.8, (30, 2))
    assert yaw_of(directions, mount.leveled(directions)) == pytest.approx(-0.2)


def test_a_single_row_moves_the_mount_by_little_and_many_by_what_they_say() -> None:
    row = Mount(np.radians([3.0, 0.0]), np.eye(2) / np.radians(0.14) ** 2)
    assert np.degrees(mount_of_drive([row]).radians[0]) < 1.6
    many = mount_of_drive([row] * 200)
    assert np.degrees(many.radians) == pytest.approx((3.0, 0.0), abs=0.05)
    halves = mount_of_drive([row] * 100, mount_of_drive([row] * 100))
    assert halves.radians == pytest.approx(many.radians)
