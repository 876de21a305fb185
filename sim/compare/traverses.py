"""Traverses of a plan, and how far each query's true position is from each place of the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.errors import ConfigError, FeedError
from edge.feed import Feed, FeedImages, FeedRow, Pictures
from sim.compare.plan import Pair, TraversePlan
from sim.compare.seqslam import describe
from sim.compare.truth import errors_between, matrix_errors, points_of
from sim.datasets import TruthKind
from sim.datasets.found import read_drive
from sim.datasets.pictures import JoinedPictures
from sim.traverse import driven_m, traverse


@dataclass(frozen=True)
class MethodTraverse:
    """The frames of a feed, or of several, that the sampling chose; `paths` are what they were read from.

    rows: (n,) of the feed. drive_of: (n,) number of the feed in `paths`. distance_m: (n,) driven since the first row of
    the drive, NaN where it is not known. missed: (n,) places passed before each without a frame. pixels: (n, 32, 64)
    float32, as SeqSLAM sees them (read here, since every picture is decoded here once to find out which are readable);
    pixels_ms: what that took a frame.
    """

    name: str
    paths: tuple[Path, ...]
    feed: Feed
    sampling: SamplingConfig
    rows: NDArray[np.intp]
    drive_of: NDArray[np.intp]
    distance_m: NDArray[np.float64]
    missed: NDArray[np.intp]
    pixels: NDArray[np.float32]
    pixels_ms: float = float("nan")

    def feed_rows(self) -> list[FeedRow]:
        """The chosen rows as the feed has them."""
        return [self.feed.rows[row] for row in self.rows]

    def drives(self) -> list[slice]:
        """The chosen rows of each drive."""
        bounds = [0, *(np.flatnonzero(np.diff(self.drive_of)) + 1).tolist(), len(self.rows)]
        return [slice(start, end) for start, end in pairwise(bounds)]


def read_feeds(paths: Sequence[Path]) -> Feed:
    """One feed, or several as if they were one; each row then has its number in its own feed as `source_frame`."""
    feeds = [read_drive(path) for path in paths]
    if len(feeds) == 1:
        return feeds[0]
    if len({feed.header.view for feed in feeds}) > 1:
        raise FeedError(f"{paths[0]}: the feeds of one traverse need cameras that look the same way")
    rows = [
        replace(row, extra={"source_frame": str(number), **row.extra})
        for feed in feeds
        for number, row in enumerate(feed.rows)
    ]
    return Feed(paths[0].parent, feeds[0].header, tuple(rows), lambda: _joined(feeds))


def _joined(feeds: Sequence[Feed]) -> Pictures:
    return JoinedPictures([FeedImages(feed) for feed in feeds], [len(feed.rows) for feed in feeds])


def open_pictures(feed: Feed) -> Pictures:
    """The pictures of what `read_feeds` read."""
    return feed.pictures() if feed.pictures else FeedImages(feed)


def load_traverse(name: str, plan: TraversePlan, paths: Sequence[Path], sampling: SamplingConfig) -> MethodTraverse:
    """Read the feeds and choose their frames.

    FeedError if fewer than 2 frames of a feed are left, or it has no distance to choose by.
    """
    items: list[tuple[int, int, float | None, int]] = []
    pixels: list[NDArray[np.float32]] = []
    before, took_s = 0, 0.0
    for drive, path in enumerate(paths):
        feed, count = read_drive(path), len(items)
        last = len(feed.rows) - 1 if plan.last_row is None else plan.last_row
        for item in traverse(feed, sampling, must_have_distance=sampling.by == "distance"):
            if item.frame.index <= last:
                items.append((before + item.frame.index, drive, item.distance_m, item.missed))
                began_s = process_time()
                pixels.append(describe(item.frame.image))
                took_s += process_time() - began_s
        if len(items) < count + 2:
            raise FeedError(f"{path}: the sampling leaves {len(items) - count} frame(s); a traverse needs at least 2")
        before += len(feed.rows)
    rows, drive_of, distance_m, missed = zip(*items, strict=True)
    return MethodTraverse(
        name,
        tuple(paths),
        read_feeds(paths),
        sampling,
        np.array(rows),
        np.array(drive_of),
        distance_m=np.array(distance_m, dtype=np.float64),
        missed=np.array(missed),
        pixels=np.stack(pixels),
        pixels_ms=1e3 * took_s / len(pixels),
    )


def true_errors(
    reference: MethodTraverse, query: MethodTraverse, pair: Pair, ahead: float = 0.0, folder: Path = Path()
) -> NDArray[np.float64]:
    """Distance from each query's right place to each place, (Q, N), meters or frames as `Pair.truth` has it.

    The right place is where the query is `ahead` later on its own drive. NaN throughout the row of a query whose true
    position is not known, inf where a place's is not. folder: of matrices, see `matrix_errors`. ConfigError names the
    pair and the feed that does not have what `truth` needs.
    """
    if pair.truth.endswith(".npy"):
        return matrix_errors(pair, (len(query.rows), len(reference.rows)), folder)
    if pair.truth == "anchors":
        return anchored_errors(pair, query.rows, reference.rows, ahead)
    reference_at, query_at = _points(reference, query, pair)
    at = np.concatenate([moved_ahead(query_at[drive], ahead) for drive in query.drives()])
    errors = errors_between(reference_at, at)
    if pair.truth == "rows" and len(reference.paths) > 1:
        errors[~np.isnan(errors) & (query.drive_of[:, np.newaxis] != reference.drive_of)] = np.inf
    for name, rows in pair.loops.items():
        drives = [number for number, path in enumerate(reference.paths) if path.name == name]
        if pair.truth != "rows" or not drives:
            raise ConfigError(f'pair {pair.name!r}: loops.{name}: no feed of {reference.name}, or truth is not "rows"')
        closed = np.ix_(np.isin(query.drive_of, drives), np.isin(reference.drive_of, drives))
        errors[closed] = np.minimum(errors[closed], np.abs(rows - errors[closed]))
    return errors


def anchored_errors(
    pair: Pair, query_rows: NDArray[np.intp], rows: NDArray[np.intp], ahead: float = 0.0
) -> NDArray[np.float64]:
    """(Q, N) rows of the reference between each place and the query's right row, interpolated between anchors."""
    at, there = np.array(pair.anchors, dtype=np.float64).T
    true_row = np.interp(query_rows, at, there, left=np.nan, right=np.nan)
    away = np.abs(moved_ahead(true_row[:, np.newaxis], ahead) - rows)
    if pair.loop:
        away %= pair.loop
        away = np.minimum(away, pair.loop - away)
    return np.asarray(away)


def moved_ahead(points: NDArray[np.float64], ahead: float) -> NDArray[np.float64]:
    """Where a drive through points (n, k) is `ahead` later, counted along itself; straight on beyond its ends.

    NaN where a point is not known.
    """
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    line = points[known]
    driven = np.concatenate([[0.0], np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum()])
    reach = abs(ahead)
    if not reach or len(line) < 2 or not driven[-1]:
        return points
    share = reach / min(reach, driven[-1])

    def at(where: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([np.interp(where, driven, column) for column in line.T])

    ends = line[[0, -1]] + (line[[0, -1]] - at(np.array([reach, driven[-1] - reach]))) * share
    line = np.concatenate([ends[:1], line, ends[1:]])
    driven = np.concatenate([[-reach], driven, [driven[-1] + reach]])
    out = np.full_like(points, np.nan)
    out[known] = at(driven[1:-1] + ahead)
    return out


def place_coordinates(reference: MethodTraverse, pair: Pair) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the places are, for `Neighborhood`: (N, 2) on the ground and (N,) along the drive, NaN where unknown.

    In meters, or in frames where the truth is: a loop is then a circle of so many frames.
    """
    unknown = np.full((len(reference.rows), 2), np.nan)
    if pair.truth != "anchors" and not pair.truth.endswith(".npy"):
        at, _ = _points(reference, reference, pair)
        if pair.truth != "positions":
            return unknown, at[:, 0]
        meters = driven_m(reference.feed) or [np.nan] * len(reference.feed.rows)
        return at, np.array(meters)[reference.rows]
    along = reference.rows.astype(np.float64)
    if not pair.loop:
        return unknown, along
    angle = along * (2 * np.pi / pair.loop)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * (pair.loop / (2 * np.pi)), along


def _points(
    reference: MethodTraverse, query: MethodTraverse, pair: Pair
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The points of the chosen rows; ConfigError names the pair that asks for them."""
    kind: TruthKind = pair.truth  # type: ignore[assignment]  # a plan's names were checked
    try:
        reference_at, query_at = points_of(kind, reference.feed, query.feed)
    except FeedError as error:
        raise ConfigError(f'pair {pair.name!r}: truth = "{kind}": {error}') from None
    return reference_at[reference.rows], query_at[query.rows]
