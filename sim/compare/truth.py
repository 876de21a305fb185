"""The ground truth: which rows of two traverses show the same place.

Each row is a point, and two rows show the same place if their points are no further apart than the tolerance:

    positions  meters east and north, of latitude and longitude (Oxford: 40 m), or of the data set's own meters (KITTI)
    route_m    meters along a route that both traverses share, from manual anchors (University Campus: 20 m) or from
               the simulator; the direction of travel does not matter
    rows       number of the frame, for traverses that were aligned frame by frame (Nordland, Gardens Point)

Or a file says it for each pair: a matrix, as VPR_Tutorial has it, or lists of places, as VPR-Bench has them.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.errors import ConfigError, FeedError
from edge.feed import Feed
from edge.geodesy import east_north
from sim.compare.plan import Pair
from sim.datasets import TruthKind
from sim.traverse import check_origins, is_local

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
    check_origins(query, [reference.header.origin or reference.header.name], are_local=is_local(reference))
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


NEITHER = np.nan
"""Error of a place that is neither right nor wrong."""


def matrix_errors(pair: Pair, shape: tuple[int, int], folder: Path) -> Floats:
    """Errors (Q, N) by the files that a pair names: 0 where a place is right, inf where it is wrong, else NEITHER."""
    right = _right_places(folder / pair.truth, shape, transposed=pair.transposed)
    errors = np.where(right, 0.0, np.inf)
    if pair.soft:
        errors[read_matrix(folder / pair.soft, shape, transposed=pair.transposed).astype(bool) & ~right] = NEITHER
    return errors


def read_matrix(path: Path, shape: tuple[int, int], *, transposed: bool = False) -> NDArray[Any]:
    """Numbers (Q, N) of a .npy file. ConfigError unless it has that shape, or (N, Q) where it is transposed."""
    matrix = read_array(path)
    if matrix.dtype.kind not in "biuf" or matrix.shape != (shape[::-1] if transposed else shape):
        wanted = f"{shape[0]} queries and {shape[1]} places"
        hint = "; set transposed" if matrix.shape == shape[::-1] and not transposed else ""
        raise ConfigError(f"{path}: {matrix.dtype} {matrix.shape}, and the pair has {wanted}{hint}")
    return matrix.T if transposed else matrix


def _right_places(path: Path, shape: tuple[int, int], *, transposed: bool) -> NDArray[np.bool_]:
    """What is right (Q, N), of a matrix, or of VPR-Bench's rows of a query and its places."""
    given = read_array(path)
    if not given.dtype.hasobject:
        return read_matrix(path, shape, transposed=transposed).astype(bool)
    right = np.zeros(shape, dtype=np.bool_)
    try:
        for query, places in given:
            right[int(query), np.asarray(places, dtype=np.intp)] = True
    except (IndexError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: not a list of [query, its places]: {error}") from None
    return right


class _Plain(pickle.Unpickler):
    """Unpickles arrays and lists of numbers, and runs nothing else that a file asks for."""

    def find_class(self, module: str, name: str) -> Any:
        """As Unpickler has it."""
        allowed = {"_reconstruct", "ndarray", "dtype", "scalar", "_frombuffer"}
        if module.partition(".")[0] == "numpy" and name in allowed:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"it asks for {module}.{name}, which is no array")


def read_array(path: Path) -> NDArray[Any]:
    """The array of a .npy file; of Python objects only lists and arrays of numbers. ConfigError names the file."""
    try:
        data = path.read_bytes()
        stream = io.BytesIO(data)
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
        if dtype.hasobject:
            return np.asarray(_Plain(stream).load(), dtype=object).reshape(shape)
        return np.asarray(np.load(path, allow_pickle=False))
    except (OSError, ValueError, EOFError, pickle.UnpicklingError, AttributeError, ImportError) as error:
        raise ConfigError(f"{path}: cannot read it as an array: {' '.join(str(error).split())}") from None
