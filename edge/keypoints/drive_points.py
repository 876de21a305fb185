"""The points of all rows of a drive: which rows are near, where they are, and what they share.

Rows are where odometer and heading say, a step at a time, so an error of the map's positions moves a row as a whole,
and not its shape.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.matching import mutual_matches
from edge.keypoints.mount import Mount, mount_of_drive
from edge.keypoints.points import REACH_M, MapPoints, points_of
from edge.keypoints.view_geometry import CameraModel

MOST_ROWS = 12
"""That take part, of those within REACH_M: places may lie closer than 2 m."""
SPARSE_ROWS, SPARSE_REACH_M = 4, 20.0
"""Where fewer rows are within REACH_M, so many of the nearest take part, up to this distance: of 27 pictures 4 to 11 m
apart, 23 have points in place of 10; of some 8 m apart 24 in place of 17."""
WINDOW = 64
"""Rows that are kept in memory."""


def points_of_drive(
    keypoints_of: Callable[[int], Keypoints],
    route_m: NDArray[np.float64],
    heading: NDArray[np.float64],
    camera: CameraModel,
    rows: Sequence[int],
    *,
    faces_back: bool = False,
    mount: Mount | None = None,
) -> Iterator[tuple[MapPoints, Mount]]:
    """What `points_of` has of some rows of a drive, one row after another.

    keypoints_of: of a row. route_m: driven so far, and heading: of the vehicle, clockwise in radians, each (N,). Where
    either is NaN, no distance is known. faces_back: the camera, which is a rear one. mount: as
    other rows of the drive have it.
    """
    kept = lru_cache(WINDOW)(keypoints_of)
    matched = lru_cache(WINDOW * MOST_ROWS)(
        lambda row, other: mutual_matches(*(kept(r).descriptors for r in (row, other)))
    )
    east_m, north_m = reckoned(route_m, heading)
    heading = heading + np.pi * faces_back
    for row in rows:
        near = _near(route_m, heading, row)
        found = np.full((len(near), len(kept(row)), 2), np.nan)
        for at, other in enumerate(near):
            first, second = matched(min(row, other), max(row, other)).T
            mine, theirs = (first, second) if row < other else (second, first)
            found[at, mine] = camera.directions(kept(other).xy[theirs])
        seen_by = _beside(row, near, east_m, north_m, heading)
        points, of_row = points_of(camera.directions(kept(row).xy), found, seen_by, camera, mount)
        mount = mount_of_drive([of_row], mount)
        yield points, of_row


def _near(route_m: NDArray[np.float64], heading: NDArray[np.float64], row: int) -> list[int]:
    """Rows within REACH_M of one, but for those at the same spot, at most MOST_ROWS, evenly chosen.

    Of sparse ones the SPARSE_ROWS nearest, up to SPARSE_REACH_M.
    """
    away_m = np.where(np.isfinite(heading) & np.isfinite(heading[row]), np.abs(route_m - route_m[row]), np.nan)
    away_m[away_m == 0] = np.nan
    near = np.flatnonzero(away_m <= REACH_M + 0.01)
    if len(near) < SPARSE_ROWS:
        nearest = np.argsort(away_m)[:SPARSE_ROWS]
        near = np.sort(nearest[away_m[nearest] <= SPARSE_REACH_M])
    chosen: list[int] = near[
        np.unique(np.linspace(0, len(near) - 1, min(len(near), MOST_ROWS)).round().astype(int))
    ].tolist()
    return chosen


def reckoned(
    route_m: NDArray[np.float64], heading: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Meters east and north of the first row, by steps in the middle of two headings; over what is not known: none."""
    turn = (np.diff(heading) + np.pi) % (2 * np.pi) - np.pi
    course, step_m = heading[:-1] + turn / 2, np.diff(route_m)
    moved = np.nan_to_num(step_m * np.stack([np.sin(course), np.cos(course)]))
    east_m, north_m = np.concatenate([np.zeros((2, 1)), moved.cumsum(axis=1)], axis=1)
    return east_m, north_m


def cameras_beside(
    rows: Sequence[int], route_m: NDArray[np.float64], heading: NDArray[np.float64], facing: int
) -> NDArray[np.float64]:
    """Rows of a drive as cameras (V, 3) in the frame of the first: meters right and ahead, turned clockwise.

    route_m, heading: as `points_of_drive`. facing: 1 for a front camera, -1 for a rear one.
    """
    return _beside(rows[0], list(rows), *reckoned(route_m, heading), heading + np.pi * (facing < 0))


def _beside(
    row: int,
    others: list[int],
    east_m: NDArray[np.float64],
    north_m: NDArray[np.float64],
    heading: NDArray[np.float64],
) -> NDArray[np.float64]:
    east, north = east_m[others] - east_m[row], north_m[others] - north_m[row]
    cos, sin = np.cos(heading[row]), np.sin(heading[row])
    turn = (heading[others] - heading[row] + np.pi) % (2 * np.pi) - np.pi
    return np.column_stack([east * cos - north * sin, east * sin + north * cos, turn])
