"""Fewer points of a line, none of the others further from it than a tolerance (Douglas and Peucker, 1973)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def simplified(points_m: NDArray[np.float64], tolerance_m: float) -> NDArray[np.int64]:
    """Indices of the points (N, 2) to keep, in order, both ends among them."""
    keep = np.zeros(len(points_m), dtype=bool)
    keep[[0, -1]] = True
    pieces = [(0, len(points_m) - 1)]
    while pieces:
        first, last = pieces.pop()
        if last - first < 2:
            continue
        away_m = distances_m(points_m[first + 1 : last], points_m[first], points_m[last])
        furthest = int(away_m.argmax())
        if away_m[furthest] > tolerance_m:
            middle = first + 1 + furthest
            keep[middle] = True
            pieces += [(first, middle), (middle, last)]
    return np.flatnonzero(keep)


def distances_m(
    points_m: NDArray[np.float64], start_m: NDArray[np.float64], end_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance (N,) of points (N, 2) from a straight piece; not from the line that goes on beyond its ends."""
    away_m = points_m - nearest_on(points_m, start_m, end_m)
    return np.hypot(away_m[:, 0], away_m[:, 1])


def nearest_on(
    points_m: NDArray[np.float64], starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The nearest point of a straight piece to a point; arrays (..., 2), which are broadcast."""
    along_m = ends_m - starts_m
    length_sq = np.maximum((along_m**2).sum(axis=-1), 1e-12)
    share = (((points_m - starts_m) * along_m).sum(axis=-1) / length_sq).clip(0.0, 1.0)
    nearest: NDArray[np.float64] = starts_m + share[..., None] * along_m
    return nearest
