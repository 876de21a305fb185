"""Which points of two pictures are the most alike, each the nearest neighbor of the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEAST_COSINE = 0.82
"""Of two descriptors of one point; the authors' own (`XFeat.match`)."""


def mutual_matches(query: NDArray[np.int8], reference: NDArray[np.int8]) -> NDArray[np.int32]:
    """(M, 2): rows of descriptors (K, 64) and (N, 64) that are each other's most alike, over LEAST_COSINE."""
    if not (len(query) and len(reference)):
        return np.empty((0, 2), np.int32)
    cosines = query.astype(np.float32) @ reference.astype(np.float32).T
    best, rows = cosines.argmax(axis=1), np.arange(len(query))
    alike = (cosines.argmax(axis=0)[best] == rows) & (cosines[rows, best] > LEAST_COSINE * 127**2)
    return np.stack([rows[alike], best[alike]], axis=1).astype(np.int32)
