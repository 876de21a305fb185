"""Traverses of a plan, and how far each query's true position is from each place of the reference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.errors import ConfigError, FeedError
from edge.feed import Feed, FeedRow, read_feed
from edge.feed.traverse import driven_m, traverse
from sim.datasets import TruthKind
from sim.datasets.truth import Truth, truth_between
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
    """Distance from each query's true position to each place, (Q, N), meters or frames as `Pair.truth` has it.

    NaN throughout the row of a query whose true position is not known, inf where a place's is not. ConfigError names
    the pair and the feed that does not have what `truth` needs.
    """
    if pair.truth == "anchors":
        return anchored_errors(pair, query.rows, reference.rows)
    return _truth(pair.truth, reference, query, pair).errors()


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
    """Where the places are, for `Neighborhood`: (N, 2) on the ground and (N,) along the drive, NaN where unknown.

    In meters, or in frames where the truth is: a loop is then a circle of so many frames.
    """
    unknown = np.full((len(reference.rows), 2), np.nan)
    if pair.truth != "anchors":
        at = _truth(pair.truth, reference, reference, pair).reference_at
        if pair.truth != "positions":
            return unknown, at[:, 0]
        meters = driven_m(reference.feed) or [np.nan] * len(reference.feed.rows)
        return at, np.array(meters)[reference.rows]
    along = reference.rows.astype(np.float64)
    if not pair.loop:
        return unknown, along
    angle = along * (2 * np.pi / pair.loop)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * (pair.loop / (2 * np.pi)), along


def _truth(kind: TruthKind, reference: Traverse, query: Traverse, pair: Pair) -> Truth:
    """The truth between the chosen rows; ConfigError names the pair that asks for it."""
    try:
        between = truth_between(kind, reference.feed, query.feed, pair.tolerance)
    except FeedError as error:
        raise ConfigError(f'pair {pair.name!r}: truth = "{kind}": {error}') from None
    return between.take(query.rows, reference.rows)
