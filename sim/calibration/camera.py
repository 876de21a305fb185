"""The field of view and the lens of a camera, by the pictures of one drive: `lookback calibrate camera FEED`."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError, FrameError
from edge.feed import Feed, FeedImages
from edge.keypoints import CameraModel, Keypoints
from edge.keypoints.drive_points import points_of_drive
from edge.keypoints.intrinsics import AS_CONFIGURED, PRIOR, UnknownCamera
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.points import REACH_M
from edge_plugins.mapping.keypoint_rows import MOST_OF_PLACE, NO_KEYPOINTS
from sim.traverse import driven_m, with_course

log = logging.getLogger(__name__)

BEGUN_DEG = 80.0
"""Where no field of view is known."""
APART_M, MOST_ROWS, FEWEST_ROWS = 10.0, 60, 8
"""Of the pictures that are compared with those up to REACH_M before and after: from each other, and how many."""
PASSES, SETTLED = 4, 0.3
"""At most, each from what the one before found, since a wrong field of view explains fewer points; and the sigmas by
which the last one moves."""
SHARED_SIGMAS = 0.01, 0.03
"""Of the focal length, as a share, and k1, alike in all rows. On four simulated drives it was 0.9 % short; on five
others of a pinhole k1 was -.047, -.047, -.026, -.023 and .006: .034 rms, where rows differ by .013."""
OUTLIER, REWEIGHTED = 4.0, 4
"""Times what half of the rows are off by at most, squared, from which on one counts less; and how often that is
asked."""
WIDEST_SIGMA = 0.03
"""Of the focal length, as a share, beyond which nothing is said: at 80 degrees 1.7 degrees."""


Said: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Of down, right, logarithm of the focal length, k1: information (4, 4), after the same times the values (4,)."""


@dataclass(frozen=True)
class FoundCamera:
    """Degrees across the picture without what the lens bends, k1 of the lens (OpenCV), and their sigmas."""

    fov_deg: float
    fov_sigma_deg: float
    k1: float
    k1_sigma: float

    @property
    def distortion(self) -> tuple[float, ...]:
        """For `[camera]`; none where k1 does not differ from 0 by more than twice its sigma."""
        return (round(self.k1, 3), 0.0, 0.0, 0.0) if abs(self.k1) > 2 * self.k1_sigma else ()


def measure_camera(feed: Feed) -> FoundCamera:
    """The camera of a recorded drive. FeedError, in one line, where it does not show it; ModelError."""
    distances_m, frames = driven_m(feed), feed.path / ("" if feed.pictures else "frames.csv")
    if feed.header.lens == "fisheye":
        raise FeedError(f"{feed.path}: a fisheye has four factors, which a drive does not show; use a chessboard")
    if distances_m is None:
        raise FeedError(f"{frames}: the camera needs the way: distance_m in every row, or positions")
    feed = with_course(feed)
    heading = np.radians(np.array([row.heading_deg for row in feed.rows], dtype=np.float64))
    if np.isnan(heading).mean() > 0.5:
        raise FeedError(f"{frames}: the camera needs turns: heading_deg, or positions, in most rows")
    route_m = np.array(distances_m)
    rows = _spread(route_m, heading)
    if len(rows) < FEWEST_ROWS:
        raise FeedError(f"{frames}: {route_m[-1] - route_m[0]:.0f} m are too short; 300 m with bends show a camera")
    width, height, begun_deg = feed.header.width, feed.header.height, feed.header.fov_deg or BEGUN_DEG
    found = AS_CONFIGURED
    with closing(FeedImages(feed)) as images:
        begun, faces_back = CameraModel(width, height, begun_deg), feed.header.view == "rear"
        pictures = _Pictures(images, route_m, heading, begun, faces_back=faces_back)
        for _ in range(PASSES):
            before = found.optics
            found, sigmas = _pooled(list(pictures.said(rows, found)))
            if (np.abs(found.optics - before) < SETTLED * sigmas).all():
                break
    of_focal, of_k1 = sigmas.tolist()
    if of_focal > WIDEST_SIGMA:
        raise FeedError(
            f"{feed.path}: the field of view stays unknown, to {100 * of_focal:.0f} %; record a drive with more bends,"
            " by daylight, with the compass or gyro in heading_deg"
        )
    focal, k1 = found.optics.tolist()
    half = math.tan(math.radians(begun_deg) / 2) / math.exp(focal)
    fov_sigma_deg = math.degrees(2 * half / (1 + half**2)) * of_focal
    return FoundCamera(math.degrees(2 * math.atan(half)), fov_sigma_deg, k1, of_k1)


def _spread(route_m: NDArray[np.float64], heading: NDArray[np.float64]) -> list[int]:
    """Rows that lie APART_M or more apart, at most MOST_ROWS, evenly along the drive."""
    known = np.flatnonzero(np.isfinite(heading))
    first_m, last_m = route_m[known[0]] + REACH_M / 2, route_m[known[-1]] - REACH_M / 2
    count = min(MOST_ROWS, int(max(0.0, last_m - first_m) / APART_M) + 1)
    return sorted({int(known[np.abs(route_m[known] - m).argmin()]) for m in np.linspace(first_m, last_m, count)})


class _Pictures:
    """The keypoints of a drive's pictures, and what they say of the camera."""

    def __init__(
        self,
        images: FeedImages,
        route_m: NDArray[np.float64],
        heading: NDArray[np.float64],
        model: CameraModel,
        *,
        faces_back: bool,
    ) -> None:
        self._images, self._network = images, KeypointNetwork()
        self._drive = partial(
            points_of_drive, lru_cache(None)(self._keypoints), route_m, heading, model, faces_back=faces_back
        )

    def said(self, rows: Sequence[int], begun: UnknownCamera) -> Iterator[Said]:
        """By each of some rows alone."""
        for row in rows:
            ((_, found),) = self._drive([row], mount=begun)
            own = found.information - PRIOR
            if np.isfinite(own).all() and np.isfinite(found.values).all():
                yield own @ found.values + PRIOR @ (found.values - begun.values), own

    def _keypoints(self, row: int) -> Keypoints:
        try:
            return self._network.extract(self._images.read(row), MOST_OF_PLACE)
        except FrameError as error:
            log.warning("%s; skipped", error)
            return NO_KEYPOINTS


def _pooled(said: Sequence[Said]) -> tuple[UnknownCamera, NDArray[np.float64]]:
    """What all rows say together, and sigmas (2,) of the focal length and k1.

    By how much rows differ, neighbors, which share pictures, together (the sandwich of Newey and West 1987): least
    squares alone would say a third of that.
    """
    weights, vectors = np.ones(len(said)), np.array([vector for vector, _ in said]).reshape(-1, 4)
    matrices = np.array([matrix for _, matrix in said]).reshape(-1, 4, 4)
    for _ in range(REWEIGHTED):
        information = (weights[:, np.newaxis, np.newaxis] * matrices).sum(axis=0) + PRIOR
        wanted = (weights[:, np.newaxis] * vectors).sum(axis=0)
        values = np.linalg.solve(information, wanted)
        left = vectors - matrices @ values
        chi2 = np.einsum("ri,rij,rj->r", left, np.linalg.pinv(matrices), left)
        weights = 1 / np.maximum(1.0, chi2 / (OUTLIER * max(float(np.median(chi2)), 1e-9)))
    left *= weights[:, np.newaxis]
    spread = left.T @ left + (left[1:].T @ left[:-1] + left[:-1].T @ left[1:]) / 2
    inverse = np.linalg.inv(information)
    covariance = inverse @ spread @ inverse * len(said) / max(len(said) - 4, 1) + inverse
    return UnknownCamera(values[:2], information, values[2:]), np.hypot(np.sqrt(np.diag(covariance))[2:], SHARED_SIGMAS)
