"""The relative pose of a camera to keyframes of the map, by the map points that it sees of them (PnP).

Several keyframes together are a local map: each point stays in the frame of its own keyframe, in which its distance is
uncertain along its ray, and the pose is in the frame of one of them. The unknowns are meters to the right and ahead of
that one's camera, the turn, and two nuisance parameters: the pitch, since cars nod, and the roll, since copters bank.
And each point's inverse distance, which is uncertain in the map: it is estimated with the pose. With the map's
distances as they are, poses are biased towards where the map was driven (errors in variables), 3.5 m cross-track by
0.25 m and 0.4 degrees in the mean; so by 0.05 m and 0.1 degrees. Gauss and Newton with the robust cost of Geman and
McClure, from several starts at once.
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
from edge.keypoints.reprojection import KERNEL, WIDEST, Array, Rays, costs_of, step_of, whitened
from edge.keypoints.view_geometry import CameraModel, Intrinsics

STARTS = np.array([(right, ahead, 0.0) for right in (-3.5, 0.0, 3.5) for ahead in (-6.0, 0.0, 6.0)])
"""Right and ahead in meters, and turned, where the vehicle is not followed."""
FEWEST_POINTS = 12
"""That agree on a pose."""
CAUTION, CAUTION_TOGETHER = -1.5, -1.0
"""The power of the share of points that agree by which errors exceed the sigmas of least squares: matches nearby, and
points of the same rows, err alike, and where many disagree, those that agree are worse. Set on
the roads 9701 and 9702; docs/keypoints.md has what it is worth on others. Of several keyframes together more matches
disagree: on the roads 979 and 12201 (night, 0 to 6 m beside, 135 pictures) rms over sigma was 0.56 cross-track, 0.45
along-track and 0.72 of the heading by the former power, and is 0.84, 0.69 and 1.04 by the latter."""
SHARP = 0.9
"""Sharpness of a picture below which variances grow as it falls. Out of focus by disks of 3 and 4 pixels of 224 (two
roads, dusk, 200 pictures), rms over sigma was 1.2 to 1.7 without, and is 0.8 to 1.1; shaken, it is as of sharp ones."""
CAMERA_CAUTION = 2.0
"""By which variances exceed those of least squares where they are due to the camera: its first pictures are the
worst."""
KERNELS = tuple(KERNEL * max(1.0, WIDEST / step) for step in range(1, 9))
"""Of each step near a pose."""
FIRST_STEPS, LAST_STEPS = 5, 4
"""From several starts, after which only the best go on; and how many those then have."""
FURTHER = 1.8
"""Times a step with the last kernel, since robust weights make it too short: what is left of 355 poses with the camera
is 0.009 sigma (median; 95 %: 0.26) after 8 such steps, and was 0.08 (0.67) after 12 plain ones; of 260 without it 0.003
(0.19) after 9, and was 0.007 (0.20) after 12."""
GO_ON = 2
PITCH_SIGMA, ROLL_SIGMA = float(np.radians(2.0)), float(np.radians(3.0))
"""Of one picture against another. Of 159 pictures of a copter that pitches by up to 21 degrees and rolls by up to 10,
103 had a pose from level starts without roll, rms over sigma 1.5 cross-track, 20 of them over 2 m off; now 156, 1.2, 8.
"""
LEVEL = 2.0
"""Of these, up to which a pose is sought from a level camera: where few points agree, the median of all misleads."""
MOST_RIGHT_M, MOST_AHEAD_M, MOST_TURN_RAD = 8.0, 8.0, float(np.radians(25))
"""Of a pose on the road of its place: in another lane, between two places, in a bend."""


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

    def scaled(self, focal_sigma: float, sharpness: float) -> RelativePose:
        """As wide as a picture of this sharpness makes it, and as the map's focal length may be wrong.

        One factor of that is in all meters to the side, and in turns.
        """
        off = np.array([self.right_m, 0.0, self.turn_rad]) * focal_sigma
        return replace(self, covariance=self.covariance * max(1.0, SHARP / sharpness) + np.outer(off, off))

    def mixed(self, other: RelativePose, share: float, doubt: float) -> RelativePose:
        """This one, or the other: their mean by the share of that, the spread about it by how probable that is."""
        apart = (other.start - self.start)[0]
        right_m, ahead_m, turn = (self.start[0] + share * apart).tolist()
        off = (1 - doubt) * share**2 + doubt * (1 - share) ** 2
        spread = (1 - doubt) * self.covariance + doubt * other.covariance + off * np.outer(apart, apart)
        return replace(self, right_m=right_m, ahead_m=ahead_m, turn_rad=turn, covariance=spread)

    @property
    def start(self) -> NDArray[np.float64]:
        """From which one near it is found (1, 3)."""
        return np.array([[self.right_m, self.ahead_m, self.turn_rad]])

    @property
    def inliers(self) -> int:
        """Points that agree."""
        return int(self.inlier_mask.sum())

    @property
    def support(self) -> float:
        """Of a pose on the road: its points, each as much as those agree that it is one of; else 0."""
        is_beside = (np.abs(self.start) <= (MOST_RIGHT_M, MOST_AHEAD_M, MOST_TURN_RAD)).all()
        return self.inliers * float(self.inlier_mask.mean()) ** 2 if is_beside else 0.0


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

    starts: (S, 3) meters right and ahead, and turned; a single one where the vehicle is followed; or (S, 4), with what
    is added to the logarithm of the focal length, all of which go on. known: of the focal length and k1, which are
    solved for as well; None: they are as the camera says. frames: (n, 3) the camera of each point's keyframe in the
    frame of the pose; None where that is this one.
    """
    if len(seen) < FEWEST_POINTS:
        return None
    rays = Rays.of(points, seen, np.zeros((len(seen), 3)) if frames is None else frames, camera)
    before = _before(known)
    cameras = np.tile(before[0], (len(starts), 1))
    unknowns = cameras.shape[1]
    cameras[:, :3] = starts[:, :3]
    cameras[:, 5 : 2 + starts.shape[1]] += starts[:, 3:]
    pitch = float(np.median(np.arctan(seen[:, 1]) - np.arctan(points.places[:, 1])))
    cameras[:, 3] = pitch if abs(pitch) > LEVEL * PITCH_SIGMA else 0.0
    inverse = np.repeat(rays.inverse[np.newaxis], len(cameras), axis=0)
    first = KERNELS[:FIRST_STEPS] if len(cameras) > GO_ON and starts.shape[1] == 3 else ()
    then = KERNELS if unknowns > 5 or not first else KERNELS[-LAST_STEPS:]
    for step, kernel in enumerate((*first, *then), 1):
        off, jacobian, inverse = whitened(cameras, inverse, rays)
        free = unknowns if step > len(first) else 5  # the camera near a pose: with it, more starts end elsewhere
        further = FURTHER if kernel == KERNEL else 1.0
        cameras[:, :free] += further * step_of(cameras, off, jacobian, kernel, before, free)[0]
        if step == len(first):
            most_likely = np.argsort(costs_of(off, kernel))[:GO_ON]
            cameras, inverse = cameras[most_likely], inverse[most_likely]
    off, jacobian, _ = whitened(cameras, inverse, rays)
    costs = costs_of(off, KERNEL)
    best = int(costs.argmin())
    agrees = np.square(off[best]).sum(axis=0) < (2 * KERNEL) ** 2
    if agrees.sum() < FEWEST_POINTS:
        return None
    _, found = step_of(cameras, off, jacobian, KERNEL, before, unknowns)
    worse = float(agrees.mean()) ** (2 * (CAUTION if frames is None or not frames.any() else CAUTION_TOGETHER))
    likely = np.exp((costs[best] - costs) * len(seen) * KERNEL**2 / (2 * worse))
    likely, away = likely / likely.sum(), cameras - cameras[best]
    spread = np.einsum("s,si,sj->ij", likely, away, away)
    covariance = worse * np.einsum("s,sij->ij", likely, _covariances(found)) + spread[:3, :3]
    right_m, ahead_m, turn = cameras[best, :3].tolist()
    right = float((seen[agrees, 0] > 0).mean())
    even = 2 * min(right, 1 - right)
    alone = known and replace(_alone(cameras[best, 5:], found[best], known, worse, spread[5:, 5:]), even=even)
    return RelativePose(right_m, ahead_m, turn, covariance, agrees, float(costs[best]), intrinsics=alone)


def _covariances(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of right, ahead and turned (S, 3, 3), by the information (S, U, U) of all unknowns."""
    covariance = np.linalg.inv(information)[:, :3, :3]
    if information.shape[1] == 5:
        return np.asarray(covariance)
    with_camera_known = np.linalg.inv(information[:, :5, :5])[:, :3, :3]
    return np.asarray(covariance + (CAMERA_CAUTION - 1) * (covariance - with_camera_known))


def _before(known: Intrinsics | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The unknowns (U,) before anything is seen, and their information (U, U)."""
    values, information = np.zeros(5), np.diag([1e-3, 1e-3, 1e-3, PITCH_SIGMA**-2, ROLL_SIGMA**-2])
    if known is None:
        return values, information
    nothing = np.zeros((5, 2))
    both = np.block([[information, nothing], [nothing.T, known.information]])
    return np.concatenate([values, known.values]), both


def _alone(found: Array, information: Array, known: Intrinsics, worse: float, spread: Array) -> Intrinsics:
    """What a picture says of its camera (2,) without what was known before; information: (7, 7) with that.

    spread: (2, 2) of other cameras that explain it nearly as well.
    """
    of_pose, shared, of_camera = information[:5, :5], information[:5, 5:], information[5:, 5:]
    both = of_camera - shared.T @ np.linalg.solve(of_pose, shared)
    own = both - known.information
    own = (own + own.T) / 2 + np.eye(2) * 1e-6
    values = np.linalg.solve(own, both @ found - known.information @ known.values)
    return Intrinsics(np.asarray(values), np.asarray(np.linalg.inv(np.linalg.inv(own / worse) + spread)))


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
