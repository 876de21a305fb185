"""The ground truth: which rows of two traverses show the same place.

Each row is a point, and two rows show the same place if their points are no further apart than the tolerance:

    positions  meters east and north, of latitude and longitude (Oxford: 40 m), or of the data set's own meters (KITTI)
    route_m    meters along a route that both traverses share, from manual anchors (University Campus: 20 m) or from
               the simulator; the direction of travel does not matter
    rows       number of the frame, for traverses that were aligned frame by frame (Nordland, Gardens Point)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edge.errors import FeedError
from edge.feed import Feed, FeedRow
from edge.geodesy import east_north
from sim.datasets import TruthKind

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Truth:
    """The point of every row, and the tolerance.

    query_at: (Q, k) float64, reference_at: (N, k) float64, in `unit` ("m" or "frames"); NaN where it is not known.
    """

    query_at: Floats
    reference_at: Floats
    tolerance: float
    unit: str

    def error(self, query_rows: ArrayLike, reference_rows: ArrayLike) -> Floats:
        """Distance of rows, in `unit`, for arrays of rows that broadcast.

        NaN where the query row's point is not known, inf where only the reference row's is not.
        """
        query_at, reference_at = self.query_at[np.asarray(query_rows)], self.reference_at[np.asarray(reference_rows)]
        apart = np.linalg.norm(query_at - reference_at, axis=-1)
        lost = np.isnan(reference_at).any(axis=-1) & ~np.isnan(query_at).any(axis=-1)
        return np.where(lost, np.inf, apart)

    def errors(self) -> Floats:
        """`error` of each query row and each reference row, (Q, N)."""
        return self.error(np.arange(len(self.query_at))[:, np.newaxis], np.arange(len(self.reference_at)))

    def true_rows(self, query_row: int) -> Rows:
        """All reference rows that are right for a query row, ascending; empty if it is off the map."""
        return np.flatnonzero(self.error(query_row, np.arange(len(self.reference_at))) <= self.tolerance)

    def take(self, query_rows: ArrayLike, reference_rows: ArrayLike) -> Truth:
        """The truth between some of the rows, which are counted from 0 again."""
        return replace(
            self,
            query_at=self.query_at[np.asarray(query_rows)],
            reference_at=self.reference_at[np.asarray(reference_rows)],
        )


def _known(points: Floats) -> Rows:
    return np.flatnonzero(np.isfinite(points).all(axis=1))


def truth_between(kind: TruthKind, reference: Feed, query: Feed, tolerance: float) -> Truth:
    """The truth between two feeds; tolerance in meters, or in frames if kind is "rows".

    FeedError names the feed that does not have what this kind of truth needs.
    """
    if not tolerance >= 0:
        raise FeedError(f"tolerance: {tolerance:g} is not 0 or more")
    points = {"positions": _by_positions, "route_m": _by_route, "rows": _by_rows}[kind]
    reference_at, query_at = points(reference, query)
    return Truth(query_at, reference_at, tolerance, "frames" if kind == "rows" else "m")


def _by_positions(reference: Feed, query: Feed) -> tuple[Floats, Floats]:
    degrees = [_points(feed.rows, lambda row: (row.lat_deg, row.lon_deg)) for feed in (reference, query)]
    if not any(_known(points).size for points in degrees):
        return _by_columns(reference, query, ("local_x_m", "local_y_m"), "no positions")
    _must_be_known(degrees, (reference, query), "no positions")
    # One origin for both, so that the points can be compared.
    meters = east_north(*np.concatenate(degrees).T)
    return meters[: len(degrees[0])], meters[len(degrees[0]) :]


def _by_route(reference: Feed, query: Feed) -> tuple[Floats, Floats]:
    return _by_columns(reference, query, ("route_m",), "no column route_m")


def _by_columns(reference: Feed, query: Feed, columns: tuple[str, ...], lack: str) -> tuple[Floats, Floats]:
    def point(row: FeedRow) -> tuple[float | None, ...]:
        return tuple(_number(row.extra.get(column)) for column in columns)

    points = [_points(feed.rows, point) for feed in (reference, query)]
    _must_be_known(points, (reference, query), lack)
    return points[0], points[1]


def _must_be_known(points: Sequence[Floats], feeds: Sequence[Feed], lack: str) -> None:
    for of_feed, feed in zip(points, feeds, strict=True):
        if not _known(of_feed).size:
            raise FeedError(f"{feed.path / 'frames.csv'}: {lack} in any row; use another kind of ground truth")


def _by_rows(reference: Feed, query: Feed) -> tuple[Floats, Floats]:
    if all("source_frame" in feed.rows[0].extra for feed in (reference, query)):
        return _by_columns(reference, query, ("source_frame",), "no source_frame")
    return (
        np.arange(len(reference.rows), dtype=np.float64)[:, None],
        np.arange(len(query.rows), dtype=np.float64)[:, None],
    )


def _points(rows: Sequence[FeedRow], point: Callable[[FeedRow], tuple[float | None, ...]]) -> Floats:
    return np.array([[np.nan if value is None else value for value in point(row)] for row in rows], dtype=np.float64)


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        return None
