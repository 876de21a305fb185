"""What descriptors of fewer dimensions cost, measured on the map itself.

Every other place of the map is taken out of it, as another drive would have seen it, and looked for by sequences among
the rest: once with whole descriptors, once shrunk to as many dimensions as the map's, along directions found from the
rest alone. It is the easiest of drives, of the same day and the same camera, so the numbers tell what shrinking loses
and not how often places will be recognised.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.normalize import normalize
from edge.reference_map.costs import CostMatcher, encode, squared_norms
from edge.reference_map.pca import principal_directions, project
from edge.reference_map.store import STATISTICS, ReferenceMap
from edge.sequence.search import NO_LINE, SequenceSearch, slopes_around_diagonal

LENGTH = 5
MOST_PLACES = 4000
"""Of a larger map, its first places: the whole sample is held in memory."""


@dataclass(frozen=True)
class Price:
    """right, right_shrunk: shares of sequences that end beside their true place. same: shares of equal answers.

    margin, margin_shrunk: medians of the lowest cost elsewhere over the lowest cost. sequences: how many were tried.
    """

    sequences: int
    right: float
    right_shrunk: float
    same: float
    margin: float
    margin_shrunk: float

    def __str__(self) -> str:
        return (
            f"every other place looked for among the rest, {self.sequences} sequences of {LENGTH}: right to a place"
            f" {self.right:.2%} with whole descriptors, {self.right_shrunk:.2%} with shrunk ones; the same answer in"
            f" {self.same:.2%}; median uniqueness {self.margin:.3f} and {self.margin_shrunk:.3f}"
        )


def price_of_shrinking(reference_map: ReferenceMap) -> Price | None:
    """Measure it; None for a map that is not shrunk, or too short to say anything."""
    if reference_map.projection is None:
        return None
    whole = _normalized(reference_map)
    pieces = [
        np.arange(segment.start, min(segment.end, len(whole)) - 1, 2) for segment in reference_map.header.segments
    ]
    kept = np.concatenate(pieces)
    segments = list(pairwise(np.cumsum([0, *(len(piece) for piece in pieces if len(piece))]).tolist()))
    if not segments:
        return None
    place, margin = _looked_for(whole[kept + 1], whole[kept], segments)
    # Directions of all places would know what was taken out.
    directions = principal_directions(lambda: [whole[kept]], whole.shape[2], len(reference_map.projection))
    shrunk = project(whole, directions)
    shrunk_place, shrunk_margin = _looked_for(shrunk[kept + 1], shrunk[kept], segments)
    tried = np.flatnonzero(place >= 0)
    if not tried.size:
        return None

    def right(found: NDArray[np.intp]) -> float:
        # The k-th place left out lies between the k-th that was kept and the next.
        return float(np.isin(found[tried] - tried, (0, 1)).mean())

    return Price(
        sequences=len(tried),
        right=right(place),
        right_shrunk=right(shrunk_place),
        same=float((place == shrunk_place)[tried].mean()),
        margin=float(np.median(margin[tried])),
        margin_shrunk=float(np.median(shrunk_margin[tried])),
    )


def _normalized(reference_map: ReferenceMap) -> NDArray[np.float32]:
    """Whole descriptors (n, R, D) of the sample, as they were before they were shrunk."""
    raw = reference_map.raw()[:MOST_PLACES].astype(np.float32)
    if reference_map.header.regions.normalization == "none":
        return raw
    mean, deviation = np.fromfile(reference_map.path / STATISTICS, dtype="<f8").reshape(2, *raw.shape[1:])
    return normalize(raw, mean, deviation)


def _looked_for(
    queries: NDArray[np.float32], kept: NDArray[np.float32], segments: list[tuple[int, int]]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Best place, -1 where no whole sequence ends, and margin of the sequence that ends at each query (n, R, D)."""
    encoded = encode(kept)
    matcher = CostMatcher(encoded, squared_norms(encoded))
    search = SequenceSearch(segments, [("forward", "same")], LENGTH, slopes_around_diagonal(0.2, 21))
    place, margin = np.full(len(queries), -1), np.ones(len(queries))
    for start, end in segments:
        search.clear()
        for query in range(start, end):
            search.push(matcher.costs(queries[query : query + 1])[0, :1])
            lines = search.lines()
            if lines is None or lines.costs.min() == NO_LINE:
                continue
            best = int(lines.costs.argmin())
            elsewhere = np.concatenate([lines.costs[: max(0, best - LENGTH)], lines.costs[best + LENGTH + 1 :]])
            place[query] = best
            margin[query] = elsewhere.min(initial=NO_LINE) / max(1, int(lines.costs[best]))
    return place, margin
