"""The ground truth: which rows of two traverses show the same place.

Each row is a point, and two rows show the same place if their points are no further apart than the tolerance:

    positions  meters east and north, of latitude and longitude (Oxford: 40 m), or of the data set's own meters (KITTI)
    route_m    meters along a route that both traverses share, from manual anchors (University Campus: 20 m) or from
               the simulator; the direction of travel does not matter
    rows       number of the frame, for traverses that were aligned frame by frame (Nordland, Gardens Point)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError
from edge.feed import Feed
from edge.geodesy import east_north
from sim.datasets import TruthKind

Floats = NDArray[np.float64]


def errors_between(reference_at: Floats, query_at: Floats) -> Floats:
    """Distances (Q, N) of points (N, k) and (Q, k): NaN of a query that is not known, else inf of such a reference."""
    apart = np.linalg.norm(query_at[:, np.newaxis] - reference_at, axis=-1)
    lost = np.isnan(reference_at).any(axis=1, keepdims=True).T & ~np.isnan(query_at).any(axis=1, keepdims=True)
    return np.where(lost, np.inf, apart)


def points_of(kind: TruthKind, reference: Feed, query: Feed) -> tuple[Floats, Floats]:
    """The points (N, k) and (Q, k) of two feeds' rows, in meters, or in frames if kind is "rows"; NaN where not known.

    FeedError names the feed that does not have what this kind of truth needs.
    """
    feeds = reference, query
    if kind == "route_m":
        return _columns(feeds, ("route_m",), "no column route_m")
    if kind == "rows":
        if all("source_frame" in feed.rows[0].extra for feed in feeds):
            return _columns(feeds, ("source_frame",), "no source_frame")
        numbers = (np.arange(len(feed.rows), dtype=np.float64)[:, np.newaxis] for feed in feeds)
        return next(numbers), next(numbers)
    degrees = [np.array([(row.lat_deg, row.lon_deg) for row in feed.rows], dtype=np.float64) for feed in feeds]
    if all(np.isnan(points).any(axis=1).all() for points in degrees):
        return _columns(feeds, ("local_x_m", "local_y_m"), "no positions")
    _must_be_known(degrees, feeds, "no positions")
    # One origin for both, so that the points can be compared.
    meters = east_north(*np.concatenate(degrees).T)
    return meters[: len(degrees[0])], meters[len(degrees[0]) :]


def _columns(feeds: Sequence[Feed], names: Sequence[str], lack: str) -> tuple[Floats, Floats]:
    """Numbers of the feeds' own columns."""
    points = [np.array([[_number(row.extra.get(name)) for name in names] for row in feed.rows]) for feed in feeds]
    _must_be_known(points, feeds, lack)
    return points[0], points[1]


def _must_be_known(points: Sequence[Floats], feeds: Sequence[Feed], lack: str) -> None:
    for of_feed, feed in zip(points, feeds, strict=True):
        if np.isnan(of_feed).any(axis=1).all():
            raise FeedError(f"{feed.path / 'frames.csv'}: {lack} in any row; use another kind of ground truth")


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return np.nan
