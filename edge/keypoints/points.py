"""The map points of a keyframe: distances of its keypoints, by all keyframes within 10 m of it at once.

Made from pairs of keyframes, distances were so uncertain that poses were biased to where the map was driven: by +1.2 m
cross-track and -1.4 degrees in the mean, since distant points fix only the sum of the two. Here each keypoint is a
point that its matches in all keyframes around must see: least squares over its direction and its inverse distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.keypoints.mount import ROW_SIGMA, Mount, unknown
from edge.keypoints.view_geometry import CameraModel, Projection

REACH_M = 10.0
"""Rows this far along the drive, to either side of a row, take part."""
FEWEST_ROWS = 3
"""That see a point, its own included."""
MOST_OFF_PX = 4.0
"""Matches further from where the point must be seen are dropped."""
KERNEL = 2.0
"""Sigmas at which a match has a quarter of its weight (Geman and McClure). Where all up to 2.5 pixels counted alike,
wrong ones turned the mounts of six maps by 0.50 degrees (rms; 0.87 at most), and with them each pose. Now: 0.18 (0.25).
"""
PIXEL_SIGMA = 0.7
"""Of a keypoint in pictures of one drive."""
INVERSES = np.geomspace(1 / 250, 1 / 2.5, 16)
"""Of the distances (1/m) that are tried before the least squares."""
ROW_SIGMAS = np.array([0.05, 0.05, np.radians(0.5), np.radians(0.5)])
"""Of where rows are in the frame of their neighbor: right and ahead in meters, turn and pitch."""
WIDER = (3.0, 2.0, 1.5, 1.0, 1.0, 1.0, 1.0, 1.0)
"""Times MOST_OFF_PX, of each step of Gauss and Newton: a degree of a turn is 3.3 pixels."""


@dataclass(frozen=True, eq=False)
class MapPoints:
    """Map points (K,): keypoints of a keyframe in its own frame, of a camera that faces level along the road.

    places: (K, 3) direction (x / z, y / z), and 1 / z in 1/m, NaN where the distance is not known. sigma: (K,) of
    1 / z.
    """

    places: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def __getitem__(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> MapPoints:
        """Some of them."""
        return MapPoints(self.places[chosen], self.sigma[chosen])

    def turned(self, rotation: NDArray[np.float64]) -> MapPoints:
        """In the frame of a camera at the same place that has rays turned by a matrix (3, 3)."""
        rays = np.column_stack([self.places[:, :2], np.ones(len(self.places))]) @ rotation.T
        return MapPoints(np.column_stack([rays[:, :2], self.places[:, 2]]) / rays[:, 2:], self.sigma / rays[:, 2])

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """(K,) whether the distance is known."""
        return np.isfinite(self.sigma)


def points_of(
    own: NDArray[np.float64],
    matched: NDArray[np.float64],
    rows: NDArray[np.float64],
    camera: CameraModel,
    of_drive: Mount | None = None,
    sigmas: NDArray[np.float64] = ROW_SIGMAS,
    fewest: int = FEWEST_ROWS,
) -> tuple[MapPoints, Mount]:
    """The keypoints of a row with directions `own` (K, 2), by those of their matches (V, K, 2) in V rows, NaN: none.

    rows: (V, 3) the cameras of those rows in the row's own frame: meters right and ahead, turned clockwise in radians.
    They are corrected by what they see (a bundle adjustment), since what a compass is off by from row to row would make
    distances wrong by a tenth for each degree. So is the frame: a camera that looks down by 3 degrees sees the way
    it moves above its middle. The points are in the frame of the camera as it is mounted; and how it is by this row.
    of_drive: how it is mounted by other rows, from which the adjustment starts. sigmas: as ROW_SIGMAS. fewest: rows
    that see a point.
    """
    limit = MOST_OFF_PX / camera.network_focal_px
    mount = begun = (of_drive or unknown(ROW_SIGMA)).begun()
    raw = np.concatenate([own[np.newaxis], matched])
    matches = np.isfinite(raw).all(axis=-1)
    tried = np.flatnonzero(matches.sum(axis=0) >= fewest)
    places = np.column_stack([own, np.full(len(own), np.nan)])
    sigma = np.full(len(own), np.nan)
    if not tried.size:
        return MapPoints(places, sigma), mount
    raw, matches = raw[:, tried], matches[:, tried]
    at = np.zeros((len(raw), 1, 4))
    at[1:, 0, :3] = rows
    seen = mount.leveled(raw)
    cameras, points = at.copy(), _started(seen, matches, at, limit)
    for wider in WIDER:
        kept = matches & _agree(points, seen, cameras, wider * limit)
        kept &= kept.sum(axis=0) >= fewest
        pixel = PIXEL_SIGMA / camera.network_focal_px
        step = _adjusted(points, cameras, at, sigmas, seen, kept, pixel, KERNEL, mount, begun)
        points, cameras, mount, variance = step
        seen = mount.leveled(raw)
    kept &= _agree(points, seen, cameras, limit)
    known = kept[0] & (kept.sum(axis=0) >= fewest) & (points[:, 2] > INVERSES[0] / 4)
    mounted = MapPoints(points[known], np.sqrt(variance[known])).turned(mount.rotation)
    places[tried[known]], sigma[tried[known]] = mounted.places, mounted.sigma
    return MapPoints(places, sigma), mount


def _started(
    seen: NDArray[np.float64], matches: NDArray[np.bool_], cameras: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """Points (K, 3) at those of INVERSES at which most matches are where they must be."""
    tried = np.empty((len(INVERSES), seen.shape[1], 3))
    tried[..., :2], tried[..., 2] = seen[0], INVERSES[:, np.newaxis]
    off = Projection(cameras[1:, np.newaxis], tried).directions - seen[1:, np.newaxis]
    cost = np.minimum(np.square(off).sum(axis=-1), (2 * limit) ** 2)
    best = np.where(matches[1:, np.newaxis], cost, 0.0).sum(axis=0).argmin(axis=0)
    found: NDArray[np.float64] = tried[best, np.arange(seen.shape[1])]
    return found


def _agree(
    points: NDArray[np.float64], seen: NDArray[np.float64], cameras: NDArray[np.float64], limit: float
) -> NDArray[np.bool_]:
    """Which directions (1 + V, K) are where they must be."""
    projected = Projection(cameras, points)
    found: NDArray[np.bool_] = (np.square(seen - projected.directions).sum(axis=-1) < limit**2) & (projected.depth > 0)
    return found


def _adjusted(
    points: NDArray[np.float64],
    cameras: NDArray[np.float64],
    at: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    seen: NDArray[np.float64],
    kept: NDArray[np.bool_],
    pixel: float,
    kernel: float,
    mount: Mount,
    begun: Mount,
) -> tuple[NDArray[np.float64], NDArray[np.float64], Mount, NDArray[np.float64]]:
    """A step of Gauss and Newton for points (K, 3), cameras (1 + V, 1, 4) and the mount together.

    And the variance of 1 / z (K,). The row's own camera is fixed but for the mount. at: of the cameras as they are
    known, as is `begun` of the mount. seen: as leveled by the mount so far. Points are eliminated (Schur).
    """
    projected, size, others = Projection(cameras, points), len(points), len(cameras) - 1
    seen, must_be = (np.where(kept[..., np.newaxis], one, 0.0) for one in (seen, projected.directions))
    weight = kept[..., np.newaxis] / pixel * mount.pixels(must_be)
    off = (seen - must_be) * weight
    robust = 1 / (1 + np.square(off).sum(axis=-1, keepdims=True) / kernel**2)
    weight, off = weight * robust, off * robust
    by_point, by_camera = (
        projected.by_point() * weight[..., np.newaxis],
        (projected.by_camera() * weight[..., np.newaxis])[1:],
    )
    by_mount = mount.derivatives(seen, must_be) * weight[..., np.newaxis]
    shared = by_mount.shape[-1]
    # (K, 3, 3), (K, 3, 1) of the points, (V, 4, 4), (V, 4) of the cameras, (K, 3, 4 V + S) of both and the mount
    flat, mounted = (one.swapaxes(0, 1).reshape(size, 2 * len(seen), -1) for one in (by_point, by_mount))
    of_points = flat.transpose(0, 2, 1)
    spread = np.linalg.inv(of_points @ flat + np.eye(3) * 1e-6)
    gradient = of_points @ off.swapaxes(0, 1).reshape(size, 2 * len(seen), 1)
    both = (by_point[1:].swapaxes(-1, -2) @ by_camera).transpose(1, 2, 0, 3).reshape(size, 3, 4 * others)
    both = np.concatenate([both, of_points @ mounted], axis=-1)
    own, all_mounted = by_camera.reshape(others, 2 * size, 4), by_mount.reshape(-1, shared)
    of_cameras = own.transpose(0, 2, 1)
    information = np.zeros((4 * others + shared, 4 * others + shared))
    for row, block in enumerate(of_cameras @ own):
        information[4 * row : 4 * row + 4, 4 * row : 4 * row + 4] = block + np.diag(sigmas**-2)
    information[:-shared, -shared:] = (of_cameras @ by_mount[1:].reshape(others, 2 * size, shared)).reshape(-1, shared)
    information[-shared:, :-shared] = information[:-shared, -shared:].T
    information[-shared:, -shared:] = all_mounted.T @ all_mounted + begun.information
    wanted = (of_cameras @ off[1:].reshape(others, 2 * size, 1)).ravel()
    wanted += ((at - cameras)[1:, 0] / sigmas**2).ravel()
    wanted = np.concatenate([wanted, all_mounted.T @ off.ravel() + begun.information @ (begun.values - mount.values)])
    solved = (spread @ both).reshape(-1, len(information))
    across = both.reshape(solved.shape).T
    rows = np.linalg.inv(information - across @ solved)
    moved = rows @ (wanted - across @ (spread @ gradient).ravel())
    step = (spread @ gradient).ravel() - solved @ moved
    by_shared = solved.reshape(size, 3, -1)[:, 2]
    variance = spread[:, 2, 2] + ((by_shared @ rows) * by_shared).sum(axis=1)
    corrected = cameras.copy()
    corrected[1:, 0] += moved[:-shared].reshape(-1, 4)
    found = mount.moved(moved[-shared:], np.linalg.inv(rows[-shared:, -shared:]))
    return points + step.reshape(-1, 3), corrected, found, variance
