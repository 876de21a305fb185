"""What pictures say of a camera whose config is wrong, or right."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.keypoints.intrinsics import DOUBTFUL, RIGHT, UNSEEN, WRONG, CameraEvidence, by_any_camera
from edge.keypoints.pose import PointMatches, solve_pnp
from edge.keypoints.view_geometry import Intrinsics, bend
from edge.sequence.keyframe_consensus import ENOUGH
from tests.keypoints.street import CAMERA, row_points, seen, street, with_noise


def drive(fov_deg: float, k1: float, pictures: int, pixels: float = 1.0) -> tuple[CameraEvidence, NDArray[np.float64]]:
    """Pictures by such a camera under a config of 80 degrees: what they say, and poses (n, 3) off by so many sigmas."""
    evidence, off = UNSEEN, []
    for number in range(pictures):
        rng = np.random.default_rng(number)
        world_m, at = street(rng, 120), (*rng.uniform((-4, -4, -0.05), (4, 4, 0.05)), 0.01)
        points = row_points(rng, world_m, pixels=0.7, turned_deg=0.3)
        must_be = _bent(seen(world_m, at), [math.log(_longer(fov_deg)), k1])
        picture = with_noise(rng, must_be, pixels)
        picture[rng.random(len(picture)) < 0.2] = rng.uniform(-0.8, 0.8, 2)
        known = points.is_known & (np.abs(must_be) < (0.84, 0.63)).all(axis=1)
        pose = solve_pnp(points[known], picture[known], CAMERA, known=evidence.known)
        assert pose is not None
        own = solve_pnp(points[known], picture[known], CAMERA, pose.start, evidence.open)
        assert own is not None and own.intrinsics is not None
        evidence = evidence.with_picture(own.intrinsics)
        off.append((pose.start[0] - at[:3]) / np.sqrt(np.diag(pose.covariance)))
    return evidence, np.array(off)


def _bent(directions: NDArray[np.float64], values: list[float]) -> NDArray[np.float64]:
    return np.asarray(bend(directions.T[np.newaxis], np.zeros((1, 2, 2, len(directions))), np.array([values]))[0].T)


def _longer(fov_deg: float) -> float:
    return math.tan(math.radians(CAMERA.fov_deg) / 2) / math.tan(math.radians(fov_deg) / 2)


@pytest.mark.parametrize(("fov_deg", "k1"), [(70.0, 0.0), (88.0, 0.0), (90.0, 0.0), (80.0, -0.15), (76.0, -0.08)])
def test_another_camera_is_found_and_no_pose_is_beyond_its_sigma(fov_deg: float, k1: float) -> None:
    evidence, off = drive(fov_deg, k1, 30)
    camera = evidence.difference(CAMERA.fov_deg)
    assert camera is not None and camera.is_another
    assert camera.configured_deg == 80.0
    assert camera.fov_deg == pytest.approx(fov_deg, abs=4 * camera.fov_sigma_deg) == pytest.approx(fov_deg, abs=2.0)
    assert camera.k1 == pytest.approx(k1, abs=4 * camera.k1_sigma) == pytest.approx(k1, abs=0.05)
    assert np.abs(off).max() < 4.0


@pytest.mark.parametrize(("fov_deg", "k1"), [(70.0, 0.0), (90.0, 0.0), (80.0, -0.15)])
def test_a_handful_of_pictures_is_enough_to_doubt_a_config_and_more_replace_it(fov_deg: float, k1: float) -> None:
    assert drive(fov_deg, k1, 5)[0].doubt == WRONG
    assert drive(fov_deg, k1, 14)[0].doubt > WRONG


def test_no_camera_is_found_by_few_pictures_nor_by_those_with_points_on_one_side() -> None:
    wrong = Intrinsics(np.array([0.0, -0.175]), np.diag([1e4, 1e4]))
    right, evidence = Intrinsics(np.zeros(2), np.diag([2500.0, 2500.0])), UNSEEN.with_picture(wrong, share=0.0)
    assert evidence.doubt < 0.1
    for said in [wrong] * 5 + [right] * 40:
        evidence = evidence.with_picture(said)
        assert evidence.doubt <= WRONG
    assert evidence.doubt < DOUBTFUL
    for _ in range(200):
        evidence = evidence.with_picture(replace(wrong, even=0.2))
        assert evidence.doubt <= WRONG
    camera = evidence.difference(CAMERA.fov_deg)
    assert camera is not None and not camera.is_another


def test_points_on_one_side_are_counted() -> None:
    rng = np.random.default_rng(5)
    world_m, at = street(rng, 120), (1.0, 0.5, 0.0, 0.0)
    points, picture = row_points(rng, world_m, pixels=0.7, turned_deg=0.3), seen(world_m, at)
    for shown, even in ((points.is_known, 0.7), (points.is_known & (picture[:, 0] > 0), 0.0)):
        pose = solve_pnp(points[shown], picture[shown], CAMERA, known=UNSEEN.open)
        assert pose is not None and pose.intrinsics is not None
        assert pose.intrinsics.even == pytest.approx(even, abs=0.3 * (even > 0))


def test_a_camera_as_configured_is_not_in_doubt_after_a_few_pictures() -> None:
    assert UNSEEN.difference(CAMERA.fov_deg) is None
    assert drive(80.0, 0.0, 1)[0].doubt < 1 / (1 + RIGHT)
    for pictures in (12, 30):
        evidence, off = drive(80.0, 0.0, pictures)
        assert evidence.doubt < DOUBTFUL
    camera = evidence.difference(CAMERA.fov_deg)
    assert camera is not None and not camera.is_another
    assert camera.fov_deg == pytest.approx(80.0, abs=1.0)
    assert np.abs(off).max() < 4.0


def test_noise_does_not_make_a_focal_length_longer() -> None:
    """It would by 2 % where points are off in directions, which a longer one makes smaller."""
    evidence, _ = drive(80.0, 0.0, 40, pixels=2.5)
    assert np.abs(evidence.known.values / np.sqrt(np.diag(evidence.known.covariance))).max() < 2.0
    assert evidence.known.values[0] == pytest.approx(0.0, abs=0.01)


def test_pictures_that_contradict_what_earlier_ones_said_are_heard_in_the_end() -> None:
    evidence = UNSEEN
    for focal in [0.0] * 100 + [0.1] * 120:
        evidence = evidence.with_picture(Intrinsics(np.array([focal, 0.0]), np.diag([2500.0, 625.0])))
    assert evidence.known.values == pytest.approx([0.1, 0.0], abs=0.005)


def test_bent_directions_move_as_their_derivatives_say() -> None:
    straight, values, small = np.array([[0.5, -0.3], [0.0, 0.0], [-0.8, 0.1]]), [0.1, -0.15], 1e-6
    derivatives = np.zeros((1, 4, 2, 3))
    derivatives[0, 0, 0] = derivatives[0, 1, 1] = 1.0
    found = bend(straight.T[np.newaxis], derivatives, np.array([values]))[0].T
    away_sq = np.square(straight).sum(axis=1, keepdims=True)
    assert found == pytest.approx(math.exp(0.1) * (1 - 0.15 * away_sq) * straight)
    for row, moved in enumerate(np.eye(4) * small):
        further = _bent(straight + moved[:2], (values + moved[2:]).tolist())
        assert (further - found) / small == pytest.approx(derivatives[0, row].T, abs=1e-5)


def test_first_pictures_of_which_half_the_matches_are_wrong_are_as_wide_as_they_are_off() -> None:
    """Any focal length explains them nearly as well: by least squares from one start, rms over sigma was 1.8."""
    off, evidence = [], UNSEEN
    for number in range(100):
        rng = np.random.default_rng(number)
        evidence = evidence if number % 10 else UNSEEN
        world_m, at = street(rng, 120), (*rng.uniform((-1, -4, -0.05), (1, 4, 0.05)), 0.01)
        points, must_be = row_points(rng, world_m, pixels=0.7, turned_deg=0.3), seen(world_m, at) * _longer(70.0)
        picture = with_noise(rng, must_be, 1.0)
        picture[rng.random(len(picture)) < 0.55] = rng.uniform(-0.8, 0.8, 2)
        known = points.is_known & (np.abs(must_be) < (0.84, 0.63)).all(axis=1)
        frames = np.zeros((int(known.sum()), 3))
        matches = PointMatches(points[known], picture[known], frames, frames.astype(np.int32), CAMERA)
        if pose := matches.pose():
            wide, evidence = by_any_camera(matches, pose, evidence, ENOUGH)
            off.append((wide.start[0] - at[:3]) / np.sqrt(np.diag(wide.covariance)))
    assert np.sqrt(np.square(off).mean(axis=0)).max() < 1.3
