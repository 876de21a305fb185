"""From descriptors to places: similarities, the best place of each frame, sequences, and what to believe."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edge.config import CameraConfig, Config, SamplingConfig, SequenceConfig
from edge.descriptor import NormalizedRows
from edge.feed import View
from edge.reference_map import COST_ONE, ModelKey
from edge.reference_map.costs import CostMatcher, encode
from edge.sequence import MotionPrior
from edge_plugins.mapping.builder import Place
from lookback import checks
from sim.compare.as_run import run_on
from sim.compare.matching import Matches, as_costs, match, match_alone, open_matcher
from sim.compare.temporary_map import MappedDrive


def compare(
    query: NDArray[np.floating], reference: NDArray[np.floating], *, orders: bool = False
) -> NDArray[np.float32]:
    """Cosine similarity (Q, N) of descriptors (Q, R, D) and (N, R, D), or (Q, D) and (N, D); 1 is the same.

    Of two regions, the left may show what the right showed on a drive the other way (section III-D): the more similar
    order counts. orders: both instead, (2, Q, N): as they are, and swapped. Values are of int8 descriptors, as on a
    vehicle: they differ from those of float32 by about 0.005.

    >>> similarity = compare(np.array([[1.0, 0.0], [3.0, 4.0]]), np.array([[2.0, 0.0]]))
    >>> similarity.shape, round(float(similarity[1, 0]), 2)
    ((2, 1), 0.6)
    """
    rows, places = checks.descriptors(query), checks.descriptors(reference)
    checks.same_kind(rows, places)
    costs = CostMatcher.of_encoded(encode(places)).costs(rows)
    similarity = (1 - costs.swapaxes(0, 1) / COST_ONE).astype(np.float32)
    return similarity if orders else np.asarray(similarity.max(axis=0))


def nearest(similarity: ArrayLike) -> Matches:
    """The most similar place of each frame alone, by S (Q, N) or (2, Q, N); the similarity is the confidence.

    >>> nearest(np.array([[0.1, 0.9], [0.8, 0.2]])).place.tolist()
    [1, 0]
    """
    return match_alone(of_better_order(checks.similarities(similarity)))


def of_better_order(similarity: NDArray[np.floating]) -> NDArray[np.floating]:
    """S (Q, N) of both orders (2, Q, N), or as it is."""
    return similarity if similarity.ndim == 2 else np.asarray(similarity.max(axis=0))


def search(
    similarity: NDArray[np.floating],
    length: int = 20,
    *,
    window: float = 10.0,
    views: tuple[View, View] = ("front", "front"),
) -> Matches:
    """The place of each frame by the sequence that ends there, by S (Q, N) or both orders (2, Q, N) of `compare`.

    Lines through the last `length` rows, within 0.2 rad of the diagonal, along the reference and against it (eq. 2 and
    3). The confidence is the uniqueness (section IV-B): cost of the best line over `window` places away, over that of
    the best. No answer (place -1) before the first `length` frames. views: which way the cameras of reference and query
    look; with both orders, only those that this allows are searched.

    Frames and places are to be about as far apart. S of other methods serves as well, higher being more similar.

    >>> similarity = np.eye(30)[5:25]
    >>> found = search(similarity, length=5)
    >>> int(found.place[-1]), bool(found.reverse[-1])
    (24, False)
    >>> bool(search(similarity[::-1], length=5).reverse[-1])  # the same road, driven back
    True
    """
    given, length = checks.similarities(similarity), checks.count("length", length, checks.LONGEST)
    costs = as_costs(given)
    by_frame = costs[:, np.newaxis] if given.ndim == 2 else costs.swapaxes(0, 1)
    places = given.shape[-1]
    matcher = open_matcher(
        np.full((places, 2), np.nan),
        np.arange(places, dtype=np.float64),
        checks.number("window", window, least=0),
        SequenceConfig(length=length),
        regions=by_frame.shape[1],
        views=checks.views(views),
    )
    rows = (NormalizedRows(row[np.newaxis]) for row in by_frame)
    return match(rows, lambda row: row.astype(np.int32), matcher)


def believe(
    query: NDArray[np.floating],
    reference: NDArray[np.floating],
    length: int = 20,
    *,
    query_m: NDArray[np.floating] | None = None,
    reference_m: NDArray[np.floating] | None = None,
    views: tuple[View, View] = ("front", "front"),
) -> Matches:
    """Places with the probability that each is right, as Lookback's daemon believes them (docs/method.md).

    query, reference: descriptors (Q, R, D) and (N, R, D) as `describe` gives them: they are normalized here. query_m,
    reference_m: meters driven at each (Q,), (N,), never falling; without them, frames and places are to be equally far
    apart. views: which way the cameras of reference and query look. The confidence is the probability that the place is
    right for a vehicle that is as often off the reference's road as on it; the daemon publishes from 0.92 on.

    >>> drive = np.random.default_rng(0).random((60, 2, 64), dtype=np.float32)
    >>> found = believe(drive[20:], drive, length=10)
    >>> int(found.place[-1]), bool(found.confidence[-1] > 0.9)
    (59, True)
    """
    rows, places = checks.descriptors(query), checks.descriptors(reference)
    checks.same_kind(rows, places)
    length, views = checks.count("length", length, checks.LONGEST), checks.views(views)
    is_metric = query_m is not None and reference_m is not None
    along, driven = np.full(len(places), np.nan), list[float | None]([None] * len(rows))
    if query_m is not None and reference_m is not None:
        along = checks.meters("reference_m", reference_m, len(places))
        driven = list(checks.meters("query_m", query_m, len(rows)))
    elif query_m is not None or reference_m is not None:
        raise ValueError("query_m and reference_m are given together, or neither is")
    spacing_m = float(np.median(np.diff(along))) if is_metric else 2.0
    config = Config(
        camera=CameraConfig(view=views[1]),
        sampling=SamplingConfig(by="distance", spacing_m=spacing_m) if is_metric else SamplingConfig(by="frames"),
        sequence=SequenceConfig(length=length),
    )
    mapped = [Place(row, route_m=float(at_m)) for row, at_m in enumerate(along)]
    travel = [MotionPrior(None if at_m is None else float(at_m)) for at_m in driven]
    model = ModelKey("described", "0" * 64, "array", places.shape[2])
    return run_on([MappedDrive(places, mapped, views[0])], rows, travel, {0}, config, model, "belief")
