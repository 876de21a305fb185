"""How far away what a row of the map shows is, by all rows within 10 m of it at once.

Made from pairs of rows, distances were so uncertain that poses were pulled to where the map was driven: by +1.2 m
across and -1.4 degrees in the mean, since distant points fix only the sum of the two. Here each keypoint of a row is
a point that its matches in all rows around must see: least squares over its direction and its inverse distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.keypoints.view_geometry import Camera, Sight

REACH_M = 10.0
"""Rows this far along the drive, to either side of a row, take part."""
FEWEST_ROWS = 3
"""That see a point, its own included."""
MOST_OFF_PX = 2.5
"""Matches further from where the point must be seen are dropped."""
PIXEL_SIGMA = 0.7
"""Of a keypoint in pictures of one drive."""
INVERSES = np.geomspace(1 / 250, 1 / 2.5, 16)
"""Of the distances (1/m) that are tried before the least squares."""
ROW_SIGMAS = np.array([0.05, 0.05, np.radians(0.5), np.radians(0.5)])
"""Of where rows are in the frame of their neighbor: right and ahead in meters, turn and pitch."""
WIDER = (3.0, 2.0, 1.5, 1.0, 1.0, 1.0)
"""Times MOST_OFF_PX, of each step of Gauss and Newton: a degree of a turn is 3.3 pixels."""


@dataclass(frozen=True, eq=False)
class Points:
    """Keypoints (K,) of a row as points in the row's own frame: its camera, upright.

    places: (K, 3) direction (x / z, y / z), and 1 / z in 1/m, NaN where the distance is not known. sigma: (K,) of
    1 / z.
    """

    places: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def __getitem__(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> Points:
        """Some of them."""
        return Points(self.places[chosen], self.sigma[chosen])

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """(K,) whether the distance is known."""
        return np.isfinite(self.sigma)


def points_of(
    own: NDArray[np.float64], matched: NDArray[np.float64], rows: NDArray[np.float64], camera: Camera
) -> Points:
    """The keypoints of a row with directions `own` (K, 2), by those of their matches (V, K, 2) in V rows, NaN: none.

    rows: (V, 3) the cameras of those rows in the row's own frame: meters right and ahead, turned clockwise in radians.
    They are corrected by what they see (a bundle adjustment), since what a compass is off by from row to row would make
    distances wrong by a tenth for each degree.
    """
    limit = MOST_OFF_PX / camera.focal_px
    seen = np.concatenate([own[np.newaxis], matched])
    matches = np.isfinite(seen).all(axis=-1)
    tried = np.flatnonzero(matches.sum(axis=0) >= FEWEST_ROWS)
    places = np.column_stack([own, np.full(len(own), np.nan)])
    sigma = np.full(len(own), np.nan)
    if not tried.size:
        return Points(places, sigma)
    seen, matches = seen[:, tried], matches[:, tried]
    at = np.zeros((len(seen), 1, 4))
    at[1:, 0, :3] = rows
    cameras, points, kept = at.copy(), _started(seen, matches, at, limit), matches
    for wider in WIDER:
        kept = matches & _agree(points, seen, cameras, wider * limit)
        kept &= kept.sum(axis=0) >= FEWEST_ROWS
        points, cameras, variance = _adjusted(points, cameras, at, seen, kept, PIXEL_SIGMA / camera.focal_px)
    kept &= _agree(points, seen, cameras, limit)
    known = kept[0] & (kept.sum(axis=0) >= FEWEST_ROWS) & (points[:, 2] > INVERSES[0] / 4)
    places[tried[known]] = points[known]
    sigma[tried[known]] = np.sqrt(variance[known])
    return Points(places, sigma)


def _started(
    seen: NDArray[np.float64], matches: NDArray[np.bool_], cameras: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """Points (K, 3) at those of INVERSES at which most matches are where they must be."""
    tried = np.empty((len(INVERSES), seen.shape[1], 3))
    tried[..., :2], tried[..., 2] = seen[0], INVERSES[:, np.newaxis]
    off = Sight(cameras[1:, np.newaxis], tried).directions - seen[1:, np.newaxis]
    cost = np.minimum(np.square(off).sum(axis=-1), (2 * limit) ** 2)
    best = np.where(matches[1:, np.newaxis], cost, 0.0).sum(axis=0).argmin(axis=0)
    found: NDArray[np.float64] = tried[best, np.arange(seen.shape[1])]
    return found


def _agree(
    points: NDArray[np.float64], seen: NDArray[np.float64], cameras: NDArray[np.float64], limit: float
) -> NDArray[np.bool_]:
    """Which directions (1 + V, K) are where they must be."""
    sight = Sight(cameras, points)
    found: NDArray[np.bool_] = (np.square(seen - sight.directions).sum(axis=-1) < limit**2) & (sight.depth > 0)
    return found


def _adjusted(
    points: NDArray[np.float64],
    cameras: NDArray[np.float64],
    at: NDArray[np.float64],
    seen: NDArray[np.float64],
    kept: NDArray[np.bool_],
    pixel: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """A step of Gauss and Newton for points (K, 3) and cameras (1 + V, 1, 4) together, and the variance of 1 / z (K,).

    The row's own camera is fixed. at: of the cameras as they are known. Points are eliminated (Schur).
    """
    sight, count = Sight(cameras, points), 4 * (len(cameras) - 1)
    weight = kept[..., np.newaxis] / pixel
    off = np.where(kept[..., np.newaxis], seen - sight.directions, 0.0) / pixel
    by_point, by_camera = sight.by_point() * weight[..., np.newaxis], (sight.by_camera() * weight[..., np.newaxis])[1:]
    # (K, 3, 3), (K, 3, 1) of the points, (V, 4, 4), (V, 4) of the cameras, (K, 3, 4 V) of both
    flat = by_point.transpose(1, 0, 2, 3).reshape(len(points), 2 * len(seen), 3)
    of_points = flat.transpose(0, 2, 1)
    spread = np.linalg.inv(of_points @ flat + np.eye(3) * 1e-6)
    gradient = of_points @ off.transpose(1, 0, 2).reshape(len(points), 2 * len(seen), 1)
    both = (by_point[1:].swapaxes(-1, -2) @ by_camera).transpose(1, 2, 0, 3).reshape(len(points), 3, count)
    own = by_camera.reshape(len(cameras) - 1, 2 * len(points), 4)
    of_cameras = own.transpose(0, 2, 1)
    information = np.diag(np.tile(ROW_SIGMAS**-2, len(own)))
    for row, block in enumerate(of_cameras @ own):
        information[4 * row : 4 * row + 4, 4 * row : 4 * row + 4] += block
    wanted = (of_cameras @ off[1:].reshape(len(own), 2 * len(points), 1)).ravel()
    wanted += ((at - cameras)[1:, 0] / ROW_SIGMAS**2).ravel()
    solved = (spread @ both).reshape(-1, count)
    across = both.reshape(-1, count).T
    rows = np.linalg.inv(information - across @ solved)
    moved = rows @ (wanted - across @ (spread @ gradient).ravel())
    step = (spread @ gradient).ravel() - solved @ moved
    shared = solved.reshape(len(points), 3, count)[:, 2]
    variance = spread[:, 2, 2] + ((shared @ rows) * shared).sum(axis=1)
    corrected = cameras.copy()
    corrected[1:, 0] += moved.reshape(-1, 4)
    return points + step.reshape(-1, 3), corrected, variance
