"""What pictures say of their own camera: focal length and k1.

A picture against a keyframe: moving ahead spreads what is near and leaves what is far away, a longer focal length
spreads all, and k1 what is at the edge most. So one picture of points of known distances tells the three apart, and
what all pictures of a drive say is pooled (`CameraEvidence`).

Successive pictures of a drive (`UnknownCamera`, in place of a mount): turns that are known by the heading show the
focal length, and points that pass show k1. On a straight road the focal length is not known: a longer one makes all
that stands there higher.

What points are off by counts in the picture: in directions, a longer focal length would make all errors smaller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from edge.keypoints.mount import ROW_SIGMA, Mount
from edge.keypoints.pose import PointMatches, RelativePose
from edge.keypoints.view_geometry import FARTHEST_BENT_SQ, Intrinsics

UNKNOWN_SIGMA = 0.12, 0.1
"""Of the logarithm of the focal length, and of k1, where they are not known: 70 to 90 degrees for 80."""
ITERATIONS, LEAST_SLOPE = 5, 0.2
"""To a direction without k1, and of what that does to the distance from the middle."""
CONFIGURED_SIGMA = 0.004, 0.006
"""The same of a config that is right: a third of a degree."""
RIGHT = 10.0
"""The odds that it is, before any picture."""
DOUBTFUL, WRONG, BEYOND_DOUBT = 0.004, 0.5, 0.99
"""How probable it is that it is wrong, from where on poses are wider, are by the camera found, and people are told."""
KNOWN_SIGMA, TELLS = 0.03, (0.015, 0.03)
"""Of the focal length, from which on people are told; and by what at least focal length or k1 is wrong then."""
SHARED, KEPT = 2.0, 32
"""Pictures that count as one, since neighbors err alike; and those that count."""
AGREE_CHI2, OUTLIER_CHI2, ROUNDS = 4.0, 16.0, 3
"""Up to which a picture agrees; at which it has a quarter of its weight (Geman and McClure); and of least squares."""
SCATTER = 0.008, 0.012
"""Of what pictures say beside their sigmas, where a pose is in another minimum or points of the map err alike."""
NOTHING = np.eye(2) * 1e-6
"""Information before any picture."""
FEWEST = 8.0
"""Pictures that agree, each as much as its points are on both sides, before a camera is taken for another one: until
then a pose is as wide as the two are apart. Single pictures of a camera that is right say -0.2 for k1, to 0.03: of
1,349 starts on five roads 28 had another camera within 40 pictures where the first few were enough, none since."""
FOCAL_STARTS = np.array([0.0, -0.15, 0.15])
"""Beside the logarithm of the focal length so far. Where half of the matches are wrong, a picture shows it only to 0.2,
which least squares from one start took for 0.03. On the road 9603, 36 of 1,401 poses by other cameras were beyond 4
sigma by one start and the pictures' doubt alone; 5 are by three starts, and a config in doubt until FEWEST agree."""


@dataclass(frozen=True, eq=False)
class UnknownCamera(Mount):
    """A mount, and (2,) by how much the logarithm of the focal length and k1 differ from those of a camera model.

    information: (4, 4) of all four.
    """

    optics: NDArray[np.float64]

    @property
    def values(self) -> NDArray[np.float64]:
        """Down, right, logarithm of the focal length, k1 (4,)."""
        return np.concatenate([self.radians, self.optics])

    def begun(self) -> UnknownCamera:
        """As `Mount` has it."""
        return UnknownCamera(self.radians, PRIOR, self.optics)

    def moved(self, step: NDArray[np.float64], information: NDArray[np.float64]) -> UnknownCamera:
        """As `Mount` has it."""
        return UnknownCamera(self.radians + step[:2], information, self.optics + step[2:])

    def leveled(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `Mount` has it, without what this camera does otherwise than its model."""
        focal, k1 = math.exp(self.optics[0]), self.optics[1]
        bent = directions / focal
        found = bent
        for _ in range(ITERATIONS):  # Newton, by the distance from the middle
            away_sq = np.square(found).sum(axis=-1, keepdims=True)
            slope = np.maximum(1 + 3 * k1 * away_sq, LEAST_SLOPE)
            found = found - (found * (1 + k1 * away_sq) - bent) / slope
        return super().leveled(found)

    def derivatives(self, seen: NDArray[np.float64], must_be: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `Mount` has it. By what must be seen: what is, and its noise, would make the focal length too long."""
        away_sq = np.square(must_be).sum(axis=-1, keepdims=True)
        by_optics = np.stack([must_be, must_be * np.minimum(away_sq, FARTHEST_BENT_SQ)], axis=-1)
        return np.concatenate([super().derivatives(must_be, must_be), by_optics], axis=-1)

    def pixels(self, must_be: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `Mount` has it: else a longer focal length, by which all is nearer, would explain everything."""
        away_sq = np.square(must_be).sum(axis=-1, keepdims=True)
        return np.asarray(math.exp(self.optics[0]) * (1 + 2 * self.optics[1] * np.minimum(away_sq, FARTHEST_BENT_SQ)))


PRIOR: NDArray[np.float64] = np.diag(np.power([ROW_SIGMA, ROW_SIGMA, *UNKNOWN_SIGMA], -2.0))
"""Information (4, 4) with which each row begins."""
AS_CONFIGURED = UnknownCamera(np.zeros(2), PRIOR, np.zeros(2))
"""Before anything was seen."""


@dataclass(frozen=True)
class CameraDifference:
    """What pictures say of the camera: its horizontal field of view, and its k1 beside that of the config's lens.

    configured_deg: by the config, or by the map where it has none. Sigmas are standard deviations. is_another: whether
    pictures contradict the config, so much that it matters.
    """

    configured_deg: float
    fov_deg: float
    fov_sigma_deg: float
    k1: float
    k1_sigma: float
    is_another: bool


@dataclass(frozen=True, eq=False)
class CameraEvidence:
    """What the newest pictures have said of a camera by themselves, and the share of each that is news."""

    pictures: tuple[tuple[Intrinsics, float], ...] = ()

    def with_picture(self, said: Intrinsics, share: float = 1 / SHARED) -> CameraEvidence:
        """After a further one, which said this by itself; share: of it that is news."""
        return CameraEvidence((*self.pictures, (said, share))[-KEPT:])

    @cached_property
    def said(self) -> Intrinsics:
        """What most of them say, without what was known before; even: the sum of those that do."""
        if not self.pictures:
            return Intrinsics(np.zeros(2), NOTHING, even=0.0)
        values = np.array([one.values for one, _ in self.pictures])
        own = np.linalg.inv([one.covariance + np.diag(np.square(SCATTER)) for one, _ in self.pictures])
        even, share = np.array([(one.even, share) for one, share in self.pictures]).T
        found = np.median(values, axis=0)
        for _ in range(ROUNDS):
            chi2 = np.einsum("ni,nij,nj->n", values - found, own, values - found)
            weighted = own * (share / np.square(1 + chi2 / OUTLIER_CHI2))[:, np.newaxis, np.newaxis]
            information = weighted.sum(axis=0) + NOTHING
            found = np.linalg.solve(information, np.einsum("nij,nj->i", weighted, values))
        counted = (even * np.minimum(1, share * SHARED))[chi2 < AGREE_CHI2]
        return Intrinsics(np.asarray(found), information, float(counted.sum()))

    @cached_property
    def known(self) -> Intrinsics:
        """With what is known of any camera, so that a pose can be solved for with it."""
        prior = np.diag(np.power(UNKNOWN_SIGMA, -2.0))
        information = self.said.information + prior
        values = np.linalg.solve(information, self.said.information @ self.said.values)
        return Intrinsics(np.asarray(values), information)

    @property
    def open(self) -> Intrinsics:
        """From which a picture begins that is to say by itself what camera it is of."""
        return Intrinsics(self.known.values, np.diag(np.power(UNKNOWN_SIGMA, -2.0)))

    @property
    def is_confirmed(self) -> bool:
        """Whether pictures say that the config is right."""
        return self.said.even >= FEWEST and self.doubt < DOUBTFUL

    @cached_property
    def doubt(self) -> float:
        """How probable it is that the config is wrong, by how likely what was said is where it is right and wrong.

        Hardly less than before any picture until FEWEST agree, and no more than even until then.
        """
        logs = []
        for sigma in (CONFIGURED_SIGMA, UNKNOWN_SIGMA):
            spread = self.said.covariance + np.diag(np.square(sigma))
            chi2 = float(self.said.values @ np.linalg.solve(spread, self.said.values))
            logs.append((chi2 + float(np.linalg.slogdet(spread)[1])) / 2)
        doubt = 1 / (1 + RIGHT * math.exp(min(logs[1] - logs[0], 500.0)))
        return min(max(doubt, self.few / (1 + RIGHT)), WRONG) if self.few else doubt

    @property
    def few(self) -> float:
        """1 before any picture, 0 once FEWEST agree."""
        return max(0.0, 1 - self.said.even / FEWEST)

    def difference(self, configured_deg: float) -> CameraDifference | None:
        """The pictures' camera, where the config's has a horizontal field of view; None: not known."""
        known = self.known
        of_focal, of_k1 = np.sqrt(np.diag(known.covariance)).tolist()
        if of_focal > KNOWN_SIGMA:
            return None
        focal, k1 = known.values.tolist()
        half = math.tan(math.radians(configured_deg) / 2) / math.exp(focal)
        fov_deg, sigma_deg = math.degrees(2 * math.atan(half)), math.degrees(2 * half / (1 + half**2)) * of_focal
        is_another = self.doubt > BEYOND_DOUBT and bool((np.abs(known.values) >= TELLS).any())
        return CameraDifference(configured_deg, fov_deg, sigma_deg, k1, of_k1, is_another)


UNSEEN = CameraEvidence()
"""Before any picture."""


def by_any_camera(
    matches: PointMatches, pose: RelativePose, evidence: CameraEvidence, enough: float
) -> tuple[RelativePose, CameraEvidence]:
    """A pose that is as wide as its camera is in doubt, by earlier pictures and this one; and what both say of it.

    Solved for by any camera as well, since points that are off by the one so far would say that it is right. Until
    FEWEST pictures agree, its covariance doubts the config more than its mean does. enough: support from which on a
    picture counts whole.
    """
    focal = FOCAL_STARTS[:1] if evidence.is_confirmed else FOCAL_STARTS
    starts = np.column_stack([np.repeat(pose.start, len(focal), axis=0), focal])
    own = matches.pose(starts, evidence.open)
    if own is None or own.intrinsics is None:
        return pose, evidence
    share = min(1.0, own.support / enough)
    after, doubt = (evidence.with_picture(own.intrinsics, one) for one in (share / SHARED, share))
    if evidence.doubt > WRONG or doubt.doubt < DOUBTFUL:
        return pose, after  # or already by the camera that was found
    other = matches.pose(starts, evidence.known)
    return pose if other is None else pose.mixed(other, doubt.doubt, max(doubt.doubt, WRONG * doubt.few)), after
