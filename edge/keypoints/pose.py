"""The relative pose of a camera to keyframes of the map, by the map points that it sees of them (PnP).

Several keyframes together are a local map: each point stays in the frame of its own keyframe, in which its distance is
uncertain along its ray, and the pose is in the frame of one of them. The unknowns are meters to the right and ahead of
that one's camera, the turn, and the pitch, a nuisance parameter: cars nod. And each point's inverse distance, which is
uncertain in the map: it is estimated with the pose. With the map's distances as they are, poses are biased towards
where the map was driven (errors in variables), 3.5 m cross-track by 0.25 m and 0.4 degrees in the mean; so by 0.05 m
and 0.1 degrees. Gauss and Newton with the robust cost of Geman and McClure, from several starts at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.matching import mutual_matches
from edge.keypoints.points import MapPoints
from edge.keypoints.view_geometry import CameraModel, Intrinsics, Projection, bent

STARTS = np.array([(right, ahead, 0.0) for right in (-3.5, 0.0, 3.5) for ahead in (-6.0, 0.0, 6.0)])
"""Right and ahead in meters, and turned, where the vehicle is not followed."""
FEWEST_POINTS = 12
"""That agree on a pose."""
PIXEL_SIGMA = 1.0
"""Of a match between drives."""
CAUTION, CAUTION_TOGETHER = -1.5, -1.0
"""The power of the share of points that agree by which errors exceed the sigmas of least squares: matches nearby, and
points of the same rows, err alike, and where many disagree, those that agree are worse. Set on
the roads 9701 and 9702; docs/keypoints.md has what it is worth on others. Of several keyframes together more matches
disagree: on the roads 979 and 12201 (night, 0 to 6 m beside, 135 pictures) rms over sigma was 0.56 cross-track, 0.45
along-track and 0.72 of the heading by the former power, and is 0.84, 0.69 and 1.04 by the latter."""
CAMERA_CAUTION = 2.0
"""By which variances exceed those of least squares where they are due to the camera: its first pictures are the
worst."""
KERNEL = 2.0
"""Sigmas at which a match has a quarter of its weight; it agrees up to twice that."""
WIDEST = 4.0
"""By which the kernel is wider at first."""
STEPS = 12
FIRST_STEPS = 5
"""After which only the best starts go on."""
GO_ON = 2
PITCH_SIGMA = float(np.radians(2.0))
"""Of one picture against another."""
NEAREST = 0.05
"""Depth, of the distance in the row's picture, below which a point is behind the camera, or as good as."""
FARTHEST = 1e-4
"""1/m, of what is at the horizon."""


@dataclass(frozen=True, eq=False)
class RelativePose:
    """The relative pose of a camera to a keyframe (PnP): meters to the right and ahead of it, and radians clockwise.

    covariance: (3, 3) of these; where another minimum explains the points nearly as well, with the way to it.
    inlier_mask: (n,) which points do; cost: the mean of all their robust costs, 0 to 1. pairs: see `PointMatches`.
    intrinsics: what this picture alone says of its camera, where that was asked.
    """

    right_m: float
    ahead_m: float
    turn_rad: float
    covariance: NDArray[np.float64]
    inlier_mask: NDArray[np.bool_]
    cost: float
    pairs: NDArray[np.int32] | None = None
    intrinsics: Intrinsics | None = None

    def turned(self, turn: float) -> RelativePose:
        """In the frame of a camera at the same place that looks so much further clockwise."""
        cos, sin = np.cos(turn), np.sin(turn)
        frame = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        right_m, ahead_m, own = (frame @ [self.right_m, self.ahead_m, self.turn_rad - turn]).tolist()
        return replace(
            self, right_m=right_m, ahead_m=ahead_m, turn_rad=own, covariance=frame @ self.covariance @ frame.T
        )

    def scaled(self, focal_sigma: float) -> RelativePose:
        """As wide as the map's focal length may be wrong: one factor is in all meters to the side, and in turns."""
        off = np.array([self.right_m, 0.0, self.turn_rad]) * focal_sigma
        return replace(self, covariance=self.covariance + np.outer(off, off))

    def mixed(self, other: RelativePose, share: float) -> RelativePose:
        """This one, or with this probability the other: mean and spread of both, with the points of this one."""
        apart = (other.start - self.start)[0]
        right_m, ahead_m, turn = (self.start[0] + share * apart).tolist()
        spread = (1 - share) * self.covariance + share * other.covariance + share * (1 - share) * np.outer(apart, apart)
        return replace(self, right_m=right_m, ahead_m=ahead_m, turn_rad=turn, covariance=spread)

    @property
    def start(self) -> NDArray[np.float64]:
        """From which one near it is found (1, 3)."""
        return np.array([[self.right_m, self.ahead_m, self.turn_rad]])

    @property
    def inliers(self) -> int:
        """Points that agree."""
        return int(self.inlier_mask.sum())


class Keyframe(NamedTuple):
    """A keyframe of a local map: its keypoints, their points, and its camera in the frame of the pose (3,).

    at: meters right and ahead, turned clockwise.
    """

    place: Keypoints
    points: MapPoints
    at: NDArray[np.float64] = np.zeros(3)


def solve_pnp(
    points: MapPoints,
    seen: NDArray[np.float64],
    camera: CameraModel,
    starts: NDArray[np.float64] = STARTS,
    known: Intrinsics | None = None,
    frames: NDArray[np.float64] | None = None,
) -> RelativePose | None:
    """The pose from which points (n,) of known distance are seen in directions (n, 2); None if too few of them agree.

    starts: (S, 3) meters right and ahead, and turned; a single one where the vehicle is followed. known: of the focal
    length and k1, which are solved for as well; None: they are as the camera says. frames: (n, 3) the camera of each
    point's keyframe in the frame of the pose; None where that is this one.
    """
    if len(seen) < FEWEST_POINTS:
        return None
    frames = np.zeros((len(seen), 3)) if frames is None else frames
    pixel = PIXEL_SIGMA / camera.network_focal_px
    before, information = _before(known)
    cameras = np.tile(before, (len(starts), 1))
    cameras[:, :3] = starts
    inverse = np.repeat(points.places[np.newaxis, :, 2], len(cameras), axis=0)
    free = 4 if len(cameras) > GO_ON else len(before)  # the camera near a pose: with it, more starts end elsewhere
    for step in range(STEPS):
        off, jacobian, inverse = _whitened(cameras, inverse, points, seen, pixel, frames)
        since = step - FIRST_STEPS if step > FIRST_STEPS and free > 4 else 1 + step
        kernel = KERNEL * max(1.0, WIDEST / since)
        cameras[:, :free] += _step(cameras, off, jacobian, kernel, before, information, free)[0]
        if step == FIRST_STEPS:
            free = cameras.shape[1]
            most_likely = np.argsort(_costs(off, kernel))[:GO_ON]
            cameras, inverse = cameras[most_likely], inverse[most_likely]
    off, jacobian, _ = _whitened(cameras, inverse, points, seen, pixel, frames)
    costs = _costs(off, KERNEL)
    best = int(costs.argmin())
    agrees = np.square(off[best]).sum(axis=-1) < (2 * KERNEL) ** 2
    if agrees.sum() < FEWEST_POINTS:
        return None
    _, found = _step(cameras, off, jacobian, KERNEL, before, information, len(before))
    worse = float(agrees.mean()) ** (2 * (CAUTION_TOGETHER if frames.any() else CAUTION))
    likely = np.exp((costs[best] - costs) * len(seen) * KERNEL**2 / (2 * worse))
    away = (cameras - cameras[best])[:, :3]
    each = worse * _covariances(found) + away[:, :, np.newaxis] * away[:, np.newaxis]
    covariance = np.einsum("s,sij->ij", likely / likely.sum(), each)
    right_m, ahead_m, turn = cameras[best, :3].tolist()
    alone = None if known is None else _alone(cameras[best, 4:], found[best], known, worse)
    return RelativePose(right_m, ahead_m, turn, covariance, agrees, float(costs[best]), intrinsics=alone)


def _covariances(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of right, ahead and turned (S, 3, 3), by the information (S, U, U) of all unknowns."""
    covariance = np.linalg.inv(information)[:, :3, :3]
    if information.shape[1] == 4:
        return np.asarray(covariance)
    with_camera_known = np.linalg.inv(information[:, :4, :4])[:, :3, :3]
    return np.asarray(covariance + (CAMERA_CAUTION - 1) * (covariance - with_camera_known))


def _before(known: Intrinsics | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The unknowns (U,) before anything is seen, and their information (U, U)."""
    values, information = np.zeros(4), np.diag([1e-3, 1e-3, 1e-3, PITCH_SIGMA**-2])
    if known is None:
        return values, information
    nothing = np.zeros((4, 2))
    both = np.block([[information, nothing], [nothing.T, known.information]])
    return np.concatenate([values, known.values]), both


def _alone(found: NDArray[np.float64], information: NDArray[np.float64], known: Intrinsics, worse: float) -> Intrinsics:
    """What a picture says of its camera (2,) without what was known before; information: (6, 6) with that."""
    of_pose, shared, of_camera = information[:4, :4], information[:4, 4:], information[4:, 4:]
    both = of_camera - shared.T @ np.linalg.solve(of_pose, shared)
    own = both - known.information
    own = (own + own.T) / 2 + np.eye(2) * 1e-6
    values = np.linalg.solve(own, both @ found - known.information @ known.values)
    return Intrinsics(np.asarray(values), own / worse)


class PointMatches(NamedTuple):
    """Which points of keyframes a picture sees: n of them, each keypoint of the picture once.

    seen: (n, 2) directions in the picture. frames: see `solve_pnp`. pairs: (n, 3) the row among the picture's
    keypoints, the keyframe, and the row among its keypoints. camera: of the picture.
    """

    points: MapPoints
    seen: NDArray[np.float64]
    frames: NDArray[np.float64]
    pairs: NDArray[np.int32]
    camera: CameraModel

    def pose(self, starts: NDArray[np.float64] = STARTS, known: Intrinsics | None = None) -> RelativePose | None:
        """As `solve_pnp`."""
        found = solve_pnp(self.points, self.seen, self.camera, starts, known, self.frames)
        return found and replace(found, pairs=self.pairs)


def match_keyframes(query: Keypoints, keyframes: Sequence[Keyframe], camera: CameraModel) -> PointMatches:
    """The points of some keyframes that a picture sees, each of its keypoints by the keyframe that is most alike there.

    camera: of the query, whose pixels count as so many as the camera says.
    """
    matched, first = [], 0
    for number, (place, points, _) in enumerate(keyframes):
        pairs = mutual_matches(query.descriptors, place.descriptors)
        mine, theirs = pairs[points.is_known[pairs[:, 1]]].T
        alike = np.einsum("md,md->m", query.descriptors[mine], place.descriptors[theirs], dtype=np.int32)
        matched.append(np.column_stack([mine, np.full_like(mine, number), theirs, first + theirs, -alike]))
        first += len(place)
    pairs = np.concatenate(matched)
    pairs = pairs[np.argsort(pairs[:, 4], kind="stable")]
    pairs = pairs[np.unique(pairs[:, 0], return_index=True)[1]]
    seen = camera.directions(query.xy[pairs[:, 0]] * (camera.width / query.size[1]))
    ahead = np.isfinite(seen).all(axis=1)
    pairs, seen = pairs[ahead], seen[ahead]
    places, sigma = (np.concatenate([getattr(one.points, name) for one in keyframes]) for name in ("places", "sigma"))
    frames = np.array([one.at for one in keyframes])[pairs[:, 1]]
    return PointMatches(MapPoints(places, sigma)[pairs[:, 3]], seen, frames, pairs[:, :3], camera)


def pose_to_keyframe(query: Keypoints, place: Keypoints, points: MapPoints, camera: CameraModel) -> RelativePose | None:
    """The pose of a picture's camera by the points of one keyframe that it sees; None if those are too few."""
    return match_keyframes(query, [Keyframe(place, points)], camera).pose()


def _whitened(
    cameras: NDArray[np.float64],
    inverse: NDArray[np.float64],
    points: MapPoints,
    seen: NDArray[np.float64],
    pixel: float,
    frames: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """What points are off by (S, n, 2) in sigmas, its derivatives (S, n, 2, U) by the cameras, and better distances.

    inverse: (S, n) of the points' distances so far. Their unknown part is eliminated: what it moves a point by in this
    picture counts as much less as it is uncertain, along that line only (Sherman and Morrison).
    """
    places = np.broadcast_to(points.places, (*inverse.shape, 3)).copy()
    places[..., 2] = inverse
    cos, sin = np.cos(frames[:, 2]), np.sin(frames[:, 2])
    into = np.stack([cos, -sin, sin, cos], axis=-1).reshape(-1, 2, 2)
    own = np.repeat(cameras[:, np.newaxis, :4], len(frames), axis=1)
    own[..., :3] -= frames
    own[..., :2] = (into @ own[..., :2, np.newaxis])[..., 0]
    projected = Projection(own, places)
    must_be, by_inverse, jacobian = projected.directions, projected.by_inverse() / pixel, projected.by_camera() / pixel
    jacobian[..., :2] = jacobian[..., :2] @ into
    if cameras.shape[1] > 4:
        must_be, slope, by_lens = bent(must_be, cameras[:, np.newaxis, 4:])
        by_inverse = (slope @ by_inverse[..., np.newaxis])[..., 0]
        jacobian = np.concatenate([slope @ jacobian, by_lens / pixel], axis=-1)
    known, sigma = points.places[:, 2], points.sigma
    off = (seen - must_be) / pixel + by_inverse * (inverse - known)[..., np.newaxis]
    along = by_inverse * sigma[:, np.newaxis]
    length_sq = np.square(along).sum(axis=-1)
    share = ((1 - 1 / np.sqrt(1 + length_sq)) / np.maximum(length_sq, 1e-12))[..., np.newaxis] * along
    found = known + sigma * (along * off).sum(axis=-1) / (1 + length_sq)
    jacobian -= share[..., np.newaxis] * (along[..., np.newaxis, :] @ jacobian)
    off -= share * (along * off).sum(axis=-1, keepdims=True)
    off[projected.depth < NEAREST] = 10 * WIDEST * KERNEL
    return off, jacobian, np.maximum(found, FARTHEST)


def _step(
    cameras: NDArray[np.float64],
    off: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    kernel: float,
    before: NDArray[np.float64],
    known: NDArray[np.float64],
    free: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A step (S, F) of Gauss and Newton for the first unknowns of some cameras, and the information (S, F, F) there.

    before, known: the unknowns (U,) before anything was seen, and the information of that (U, U).
    """
    weight = 1 / (1 + np.square(off).sum(axis=-1, keepdims=True) / kernel**2)
    starts, flat, jacobian = len(cameras), off.shape[1] * 2, jacobian[..., :free]
    weighted = (jacobian * weight[..., np.newaxis] ** 2).reshape(starts, flat, free).transpose(0, 2, 1)
    information = weighted @ jacobian.reshape(starts, flat, free) + known[:free, :free]
    gradient = weighted @ off.reshape(starts, flat, 1)
    gradient[:, 3:, 0] += (before - cameras)[:, 3:free] @ known[3:free, 3:free]
    return np.linalg.solve(information, gradient)[..., 0].clip(-5, 5), information


def _costs(off: NDArray[np.float64], kernel: float) -> NDArray[np.float64]:
    """The mean robust cost (S,) of all points, 0 to 1."""
    off_sq = np.square(off).sum(axis=-1)
    found: NDArray[np.float64] = (off_sq / (off_sq + kernel**2)).mean(axis=1)
    return found
