"""A map along its own principal directions and learned ones, see `sim.research.evaluation.directions`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from edge.reference_map.builder import Blocks, Shrink
from sim.maps.shrinking import principal_directions

OWN, WEIGHT = 384, 0.5
"""Principal directions of a map's own, and the weight of the learned ones beside them. With a weight of 1, or with the
simulator's principal directions in place of the map's own, wrong places are believed on real streets."""
Rows = NDArray[np.float32]


def beside_own(learned: Rows, own: int = OWN, weight: float = WEIGHT) -> Shrink:
    """What shrinks a map along `own` principal directions of its set, and along the learned ones (K, D)."""

    def shrink(blocks: Blocks) -> Rows:
        parts = principal_directions(blocks, learned.shape[1], own), learned
        principal, other = (part / carried(map(regions, blocks()), part) for part in parts)
        return np.concatenate([principal, np.float32(weight) * other])

    return shrink


def carried(blocks: Iterable[Rows], directions: Rows) -> np.float32:
    """Root of the mean square of rows (n, D) along some directions, all together."""
    total, count = 0.0, 0
    for rows in blocks:
        total += float(np.square(rows @ directions.T).sum(dtype=np.float64))
        count += len(rows)
    return np.float32(np.sqrt(total / max(1, count)))


def regions(rows: Rows) -> Rows:
    """The regions of rows, each alone: (n, R, D) -> (n R, D)."""
    return rows.reshape(-1, rows.shape[2])
