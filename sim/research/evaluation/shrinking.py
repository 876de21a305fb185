"""`lookback dev paper shrinking MAP`: what descriptors of fewer dimensions cost, measured on the map itself.

Every other place is removed from the map, as if another drive had recorded it, and searched for by sequences among the
rest: once with whole descriptors, once with descriptors shrunk to as many dimensions as the map's, along directions
found from the rest alone. No drive is easier, since it is of the same day and the same camera: the numbers say what
shrinking costs, not how often places will be recognized.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config, SequenceConfig
from edge.descriptor.normalize import normalize
from edge.errors import MapError
from edge.reference_map.costs import project
from edge.reference_map.store import ReferenceMap, open_map
from edge.sequence.evidence import Neighborhood
from edge.sequence.submap import RowMatcher
from sim.maps.shrinking import principal_directions
from sim.research.evaluation.matching import int8_matcher

LENGTH = 5
SEQUENCE = SequenceConfig(length=LENGTH, directions="forward")
MOST_PLACES = 4000
"""Of a larger map, its first places: the whole sample is held in memory."""


@dataclass(frozen=True)
class ShrinkingCost:
    """With whole and with shrunk descriptors.

    sequences: how many were searched for. right, right_shrunk: share of them that end within one place of the truth.
    same: share whose answers are equal. margin, margin_shrunk: median of the lowest cost outside a window around the
    best place, over the lowest cost.
    """

    sequences: int
    right: float
    right_shrunk: float
    same: float
    margin: float
    margin_shrunk: float

    def __str__(self) -> str:
        return (
            f"{self.sequences} sequences of {LENGTH} places, each searched for among every other place of the map\n"
            f"                            whole    shrunk\n"
            f"right within one place    {self.right:7.2%}   {self.right_shrunk:7.2%}\n"
            f"median uniqueness         {self.margin:7.3f}   {self.margin_shrunk:7.3f}\n"
            f"same answer               {self.same:7.2%}"
        )


def run(args: argparse.Namespace) -> int:
    """Measure and print; MapError for a map that is not shrunk, or too short to say anything."""
    reference_map = open_map(args.map, every_file=True)
    cost = cost_of_shrinking(reference_map)
    header = reference_map.header
    print(f"{args.map}: shrunk to {header.dimensions} of {header.model.dimensions} dimensions a region")
    print(cost)
    return 0


def cost_of_shrinking(reference_map: ReferenceMap) -> ShrinkingCost:
    """Measure it; MapError for a map that is not shrunk, or too short to say anything."""
    if reference_map.projection is None:
        raise MapError(f"{reference_map.path}: its descriptors are whole; build it with --dimensions to shrink them")
    too_short = MapError(f"{reference_map.path}: no segment of it is long enough for a sequence of {LENGTH} places")
    whole = _normalized(reference_map)
    pieces = [
        np.arange(segment.start, min(segment.end, len(whole)) - 1, 2) for segment in reference_map.header.segments
    ]
    kept = np.concatenate(pieces)
    segments = list(pairwise(np.cumsum([0, *(len(piece) for piece in pieces if len(piece))]).tolist()))
    if not segments:
        raise too_short
    place, margin = _search(whole[kept + 1], whole[kept], segments)
    # Directions of all places would know what was removed.
    directions = principal_directions(lambda: [whole[kept]], whole.shape[2], len(reference_map.projection))
    shrunk = project(whole, directions)
    shrunk_place, shrunk_margin = _search(shrunk[kept + 1], shrunk[kept], segments)
    tried = np.flatnonzero(place >= 0)
    if not tried.size:
        raise too_short

    def right(found: NDArray[np.intp]) -> float:
        # The k-th removed place lies between the k-th that was kept and the next.
        return float(np.isin(found[tried] - tried, (0, 1)).mean())

    return ShrinkingCost(
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
    return normalize(raw, *reference_map.statistics())


def _search(
    queries: NDArray[np.float32], kept: NDArray[np.float32], segments: list[tuple[int, int]]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Best place, -1 where no whole sequence ends, and margin of the sequence that ends at each query (n, R, D)."""
    costs, count = int8_matcher(kept), len(kept)
    segment_of = np.repeat(np.arange(len(segments), dtype=np.int32), [end - start for start, end in segments])
    acceptance = AcceptanceConfig(window_places=LENGTH)
    config = Config(sequence=SEQUENCE, acceptance=acceptance)
    near = Neighborhood(np.full((count, 2), np.nan), np.full(count, np.nan), segment_of, acceptance)
    matcher = RowMatcher(segments, ["front"] * len(segments), 1, near, config)
    place, margin = np.full(len(queries), -1), np.ones(len(queries))
    for start, end in segments:
        matcher.clear()
        for query in range(start, end):
            match = matcher.push(costs.costs(queries[query : query + 1])[:, :1])
            if match is not None:
                place[query], margin[query] = match.place, match.uniqueness
    return place, margin
