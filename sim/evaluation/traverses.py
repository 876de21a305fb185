"""Traverses of a plan, and how far each query's true position is from each place of the reference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.camera.feed import Feed, FeedRow, read_feed
from edge.config import SamplingConfig
from edge.errors import ConfigError, FeedError
from edge.reference_map.route import east_north
from edge.traverse import driven_m, traverse
from sim.evaluation.plan import Pair, TraversePlan
from sim.evaluation.seqslam import describe


@dataclass(frozen=True)
class Traverse:
    """The frames of a feed that the sampling chose; `path` is what it was read from.

    rows: (n,) of the feed. pixels: (n, 32, 64) float32, as SeqSLAM sees them (taken here, since every picture is
    decoded here once to find out which are readable).
    """

    name: str
    path: Path
    feed: Feed
    sampling: SamplingConfig
    rows: NDArray[np.intp]
    pixels: NDArray[np.float32]
    external: dict[str, Path]

    def feed_rows(self) -> list[FeedRow]:
        """The chosen rows as the feed has them."""
        return [self.feed.rows[row] for row in self.rows]


def load_traverse(
    name: str, plan: TraversePlan, path: Path, sampling: SamplingConfig, beside: Path = Path()
) -> Traverse:
    """Read a feed and choose its frames; paths of external descriptors are relative to `beside`.

    FeedError if fewer than 2 frames are left, or the feed has no distance to choose by.
    """
    feed = read_feed(path)
    last = len(feed.rows) - 1 if plan.last_row is None else plan.last_row
    chosen = [
        (item.frame.index, describe(item.frame.image))
        for item in traverse(feed, sampling, must_have_distance=sampling.by == "distance")
        if plan.first_row <= item.frame.index <= last
    ]
    if len(chosen) < 2:
        raise FeedError(f"{path}: the sampling leaves {len(chosen)} frame(s); a traverse needs at least 2")
    rows, pixels = zip(*chosen, strict=True)
    external = {source: beside / file for source, file in plan.external.items()}
    return Traverse(name, path, feed, sampling, np.array(rows), np.stack(pixels), external)


def true_errors(reference: Traverse, query: Traverse, pair: Pair) -> NDArray[np.float64]:
    """Distance from each query's true position to each place, (Q, N), metres or frames as `Pair.truth` has it.

    NaN throughout the row of a query whose true position is not known, inf where a place's is not. ConfigError if the
    feeds do not have what `truth` needs.
    """
    if pair.truth == "positions":
        places, positions = _positions(reference, query, pair)
        offsets = positions[:, np.newaxis] - places
        return np.asarray(np.hypot(offsets[..., 0], offsets[..., 1]))
    if pair.truth == "route_m":
        there, at = _column(query, pair), _column(reference, pair)
        away = np.abs(there[:, np.newaxis] - at)
        away[:, np.isnan(at)] = np.inf
        away[np.isnan(there)] = np.nan
        return np.asarray(away)
    if pair.truth == "rows":
        return np.asarray(np.abs(query.rows[:, np.newaxis] - reference.rows).astype(np.float64))
    return anchored_errors(pair, query.rows, reference.rows)


def anchored_errors(pair: Pair, query_rows: NDArray[np.intp], rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """(Q, N) rows of the reference between each place and the query's true row, interpolated between anchors."""
    at, there = np.array(pair.anchors, dtype=np.float64).T
    true_row = np.interp(query_rows, at, there, left=np.nan, right=np.nan)
    away = np.abs(true_row[:, np.newaxis] - rows)
    if pair.loop:
        away %= pair.loop
        away = np.minimum(away, pair.loop - away)
    return np.asarray(away)


def place_coordinates(reference: Traverse, pair: Pair) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the places are, for `Neighbourhood`: (N, 2) on the ground and (N,) along the drive, NaN where unknown.

    In metres, or in frames where the truth is: a loop is then a circle of so many frames.
    """
    count = len(reference.rows)
    if pair.truth == "positions":
        metres = driven_m(reference.feed) or [np.nan] * len(reference.feed.rows)
        return _positions(reference, reference, pair)[0], np.array(metres)[reference.rows]
    if pair.truth == "route_m":
        return np.full((count, 2), np.nan), _column(reference, pair)
    along = reference.rows.astype(np.float64)
    if not pair.loop:
        return np.full((count, 2), np.nan), along
    angle = along * (2 * np.pi / pair.loop)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * (pair.loop / (2 * np.pi)), along


def _positions(reference: Traverse, query: Traverse, pair: Pair) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Metres east and north of both traverses, from one origin: (N, 2), (Q, 2)."""
    degrees = []
    for one in (reference, query):
        known = [(row.lat_deg, row.lon_deg) for row in one.feed_rows() if row.lat_deg is not None]
        if len(known) < len(one.rows):
            raise ConfigError(f'pair {pair.name!r}: truth = "positions", but {one.feed.path} has rows without one')
        degrees.append(np.array(known, dtype=np.float64))
    lat_deg, lon_deg = np.concatenate(degrees).T
    metres = east_north(lat_deg, lon_deg)
    return metres[: len(reference.rows)], metres[len(reference.rows) :]


def _column(one: Traverse, pair: Pair) -> NDArray[np.float64]:
    try:
        return np.array([float(row.extra["route_m"] or "nan") for row in one.feed_rows()])
    except (KeyError, ValueError):
        raise ConfigError(f'pair {pair.name!r}: truth = "route_m", but {one.feed.path} has no such column') from None
