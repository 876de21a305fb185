"""The points of all rows of a drive: which rows are near, where they are, and what they share.

Rows are where odometer and heading say, a step at a time, so an error of the map's positions moves a row as a whole,
and not its shape.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.matching import mutual_matches
from edge.keypoints.mount import Mount, mount_of_drive
from edge.keypoints.points import REACH_M, MapPoints, points_of
from edge.keypoints.pose import FEWEST_POINTS
from edge.keypoints.view_geometry import CameraModel

MOST_ROWS = 12
"""That take part, of those within REACH_M: places may lie closer than 2 m."""
SPARSE_ROWS, SPARSE_REACH_M = 4, 20.0
"""Where fewer rows are within REACH_M, so many of the nearest take part, up to this distance: of 27 pictures 4 to 11 m
apart, 23 have points in place of 10; of some 8 m apart 24 in place of 17."""
SHOWN_FROM_M = REACH_M / SPARSE_ROWS
"""Median distance of rows from which pictures show how two of them stand to each other, where headings are the course
of positions: of 27 pictures of a walk, by a phone's GPS, 26 have points in place of 0."""
SHOWN_SIGMAS = np.array([0.3, 2.0, np.radians(1.0), np.radians(1.0)])
"""Of such rows, as ROW_SIGMAS: how far they moved is known as well as positions are."""
FEWEST_SHOWN, AHEAD, EPIPOLAR_PX, CERTAINTY = 20, 0.8, 1.5, 0.999
"""Matches that agree with an essential matrix, the part of its direction that leads ahead, and how it is searched."""
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
    is_course: bool = False,
) -> Iterator[tuple[MapPoints, Mount]]:
    """What `points_of` has of some rows of a drive, one row after another.

    keypoints_of: of a row. route_m: driven so far, and heading: of the vehicle, clockwise in radians, each (N,). Where
    either is NaN, no distance is known. faces_back: the camera, which is a rear one. mount: as
    other rows of the drive have it. is_course: the headings are those of positions, which says little between sparse
    rows; where few points agree with that, their pictures say how they turn and where they move, and
    positions only how far.
    """
    kept = lru_cache(WINDOW)(keypoints_of)
    matched = lru_cache(WINDOW * MOST_ROWS)(
        lambda row, other: mutual_matches(*(kept(r).descriptors for r in (row, other)))
    )
    east_m, north_m = reckoned(route_m, heading)
    heading = heading + np.pi * faces_back
    steps_m = np.diff(route_m[np.isfinite(route_m)])
    is_shown = is_course and bool(steps_m.size) and bool(np.median(steps_m) > SHOWN_FROM_M)
    for row in rows:
        near = _near(route_m, heading, row)
        found = np.full((len(near), len(kept(row)), 2), np.nan)
        for at, other in enumerate(near):
            first, second = matched(min(row, other), max(row, other)).T
            mine, theirs = (first, second) if row < other else (second, first)
            found[at, mine] = camera.directions(kept(other).xy[theirs])
        seen_by = _beside(row, near, east_m, north_m, heading)
        own = camera.directions(kept(row).xy)
        points, of_row = points_of(own, found, seen_by, camera, mount)
        if is_shown and points.is_known.sum() < FEWEST_POINTS:
            by_pictures = _shown(own, found, seen_by, EPIPOLAR_PX / camera.network_focal_px)
            points, of_row = points_of(own, *by_pictures, camera, mount, SHOWN_SIGMAS, fewest=2)
        mount = mount_of_drive([of_row], mount)
        yield points, of_row


def _shown(
    own: NDArray[np.float64], matched: NDArray[np.float64], rows: NDArray[np.float64], limit: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Matches and rows as `points_of` gets them, by an essential matrix each: turned as `own`, and where they moved.

    Of matches further than `limit` from their epipolar lines, and of rows that are not seen so, nothing is left.
    """
    matched, rows = matched.copy(), rows.copy()
    for directions, at in zip(matched, rows, strict=True):
        both = np.flatnonzero(np.isfinite(directions).all(axis=-1))
        one, other = own[both], directions[both].copy()
        directions[:] = np.nan
        if len(both) < FEWEST_SHOWN:
            continue
        found, inliers = cv2.findEssentialMat(one, other, np.eye(3), cv2.RANSAC, CERTAINTY, limit)
        if found is None or found.shape != (3, 3) or (agree := np.ravel(inliers) > 0).sum() < FEWEST_SHOWN:
            continue
        *turns, moved = cv2.decomposeEssentialMat(found)
        turn = max(turns, key=np.trace)  # the other one is upside down
        ahead = -(turn.T @ moved).ravel()
        if abs(ahead[2]) < AHEAD:
            continue
        ahead *= np.sign(ahead[2] * at[1]) * np.hypot(*at[:2])
        at[:] = ahead[0], ahead[2], 0.0
        rays = np.column_stack([other[agree], np.ones(agree.sum())]) @ turn
        directions[both[agree]] = rays[:, :2] / rays[:, 2:]
    return matched, rows


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
