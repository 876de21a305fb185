"""Poses from one picture, against cameras whose place is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.points import MapPoints
from edge.keypoints.pose import FEWEST_POINTS, SHARP, RelativePose, pose_to_keyframe, solve_pnp
from tests.keypoints.street import CAMERA, row_points, seen, street, with_noise

HOME = (3.5, 1.0, 0.05, 0.02)


def one_pose(
    seed: int, camera: tuple[float, ...], roll: float = 0.0, *, wrong: float = 0.3
) -> tuple[RelativePose | None, NDArray[np.float64]]:
    """A pose, and how far it is off in sigmas: right, ahead, turned. roll: in radians. wrong: share of the matches."""
    rng = np.random.default_rng(seed)
    world_m = street(rng, 120)
    points = row_points(rng, world_m, pixels=0.7, turned_deg=0.5)
    picture = with_noise(rng, seen(world_m, camera), 1.0)
    picture[rng.random(len(picture)) < wrong] = rng.uniform(-0.8, 0.8, 2)
    picture = picture @ np.array([[np.cos(roll), np.sin(roll)], [-np.sin(roll), np.cos(roll)]])
    known = points.is_known
    pose = solve_pnp(points[known], picture[known], CAMERA)
    if pose is None:
        return None, np.full(3, np.nan)
    off = np.array([pose.right_m, pose.ahead_m, pose.turn_rad]) - camera[:3]
    return pose, off / np.sqrt(np.diag(pose.covariance))


@pytest.mark.parametrize("camera", [HOME, (-0.5, -4.0, 0.0, 0.0), (0.0, 6.0, -0.1, -0.03), (3.5, 1.0, 0.05, -0.35)])
def test_one_keyframe_gives_the_pose_to_its_covariance(camera: tuple[float, ...]) -> None:
    poses = [one_pose(seed, camera, 0.1 * (seed % 2)) for seed in range(12)]
    assert all(pose is not None and pose.inliers > 50 for pose, _ in poses)
    rms = np.sqrt(np.mean([off**2 for _, off in poses], axis=0))
    assert (rms < 1.6).all(), rms
    sharp, blurred = ([np.diag(one.scaled(0.0, of).covariance) for one, _ in poses if one] for of in (1.0, SHARP / 4))
    assert (np.median(np.sqrt(sharp), axis=0) < [0.5, 0.5, 0.02]).all()
    np.testing.assert_allclose(blurred, 4 * np.array(sharp))


def test_a_pose_aside_is_not_pulled_to_where_the_map_was_driven() -> None:
    off = np.mean([one_pose(seed, HOME, wrong=0.0)[1] for seed in range(30)], axis=0)
    assert np.abs(off[[0, 2]]).max() < 0.7, off


def test_where_two_poses_explain_as_many_points_each_is_within_the_other_s_covariance() -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        world_m, cameras = street(rng, 120), np.array([HOME, (0.0, 1.0, 0.0, 0.02)])
        points = row_points(rng, world_m, pixels=0.5, turned_deg=0.0)
        picture = np.where(np.arange(120)[:, np.newaxis] % 2, *(seen(world_m, tuple(one)) for one in cameras))
        known = points.is_known
        starts = np.array([(3.5, 0.0, 0.0), (0.0, 0.0, 0.0)])
        pose = solve_pnp(points[known], with_noise(rng, picture, 0.5)[known], CAMERA, starts)
        assert pose is not None
        found = [pose.right_m, pose.ahead_m, pose.turn_rad]
        for off in found - cameras[:, :3]:
            assert off @ np.linalg.solve(pose.covariance, off) < 11.3, "99 of 100"


def test_too_few_points_and_points_of_another_place_give_none() -> None:
    rng = np.random.default_rng(5)
    world_m = street(rng, 60)
    points = row_points(rng, world_m, pixels=0.5, turned_deg=0.0)
    few = np.flatnonzero(points.is_known)[: FEWEST_POINTS - 1]
    assert solve_pnp(points[few], seen(world_m, HOME)[few], CAMERA) is None
    known = points.is_known
    assert solve_pnp(points[known], rng.uniform(-0.8, 0.8, (known.sum(), 2)), CAMERA) is None


def test_points_of_several_keyframes_each_in_its_own_frame_give_one_pose() -> None:
    rng = np.random.default_rng(8)
    world_m, ahead = street(rng, 160), (1.0, 6.0, 0.2)
    turned = np.array([[np.cos(0.2), 0, -np.sin(0.2)], [0, 1, 0], [np.sin(0.2), 0, np.cos(0.2)]])
    own_m = np.concatenate([world_m[:80], (world_m[80:] - [1.0, 0, 6.0]) @ turned.T])
    both = [row_points(rng, own_m[half], pixels=0.5, turned_deg=0.0) for half in (slice(80), slice(80, 160))]
    points = MapPoints(*(np.concatenate([getattr(one, name) for one in both]) for name in ("places", "sigma")))
    known, frames = points.is_known, np.repeat([(0.0, 0.0, 0.0), ahead], 80, axis=0)
    picture = with_noise(rng, seen(world_m, HOME), 0.5)[known]
    pose = solve_pnp(points[known], picture, CAMERA, frames=frames[known])
    assert pose is not None and pose.inliers > 0.9 * known.sum()
    assert pose.start[0] == pytest.approx(HOME[:3], abs=0.2)


def test_a_followed_vehicle_needs_one_start() -> None:
    rng = np.random.default_rng(6)
    world_m = street(rng, 100)
    points = row_points(rng, world_m, pixels=0.5, turned_deg=0.0)
    known = points.is_known
    picture = seen(world_m, HOME)[known]
    cold, followed = (
        solve_pnp(points[known], picture, CAMERA, *starts) for starts in ((), (np.array([(3.0, 0.0, 0.0)]),))
    )
    assert cold is not None
    assert followed is not None
    assert (followed.right_m, followed.ahead_m) == pytest.approx((cold.right_m, cold.ahead_m), abs=0.05)


@pytest.mark.parametrize("scale", [1, 2])
def test_descriptors_match_in_a_picture_of_any_size(scale: int) -> None:
    rng = np.random.default_rng(7)
    world_m = street(rng, 100)
    points = row_points(rng, world_m, pixels=0.5, turned_deg=0.0)
    descriptors = rng.normal(size=(100, 64))
    descriptors = np.rint(127 * descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)).astype(np.int8)

    def keypoints(camera: tuple[float, ...], order: NDArray[np.intp], scale: int) -> Keypoints:
        xy = (seen(world_m, camera) * CAMERA.focal_px + CAMERA.middle)[order] * scale
        return Keypoints(
            xy.astype(np.float32), np.ones(100, np.float32), descriptors[order], (240 * scale, 320 * scale)
        )

    query, place = keypoints(HOME, rng.permutation(100), scale), keypoints((0, 0, 0, 0), np.arange(100), 1)
    pose = pose_to_keyframe(query, place, points, CAMERA)
    assert pose is not None
    assert (pose.right_m, pose.ahead_m, pose.turn_rad) == pytest.approx(HOME[:3], abs=0.2)
    other = Keypoints(query.xy, query.scores, np.flip(query.descriptors, axis=1), query.size)
    assert pose_to_keyframe(other, place, points, CAMERA) is None
