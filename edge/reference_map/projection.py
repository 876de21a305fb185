"""Descriptors shrunk to fewer dimensions: the principal directions of a map's own normalised set.

Both regions share one matrix, so that their order can still be swapped. Directions are those in which places differ
most (PCA about 0, which is the mean of a normalised set), found by subspace iteration over blocks of the set: memory
grows with the dimensions and not with the map.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

SPARE = 16
"""More directions than asked for are followed, which makes the last of them come out right sooner."""
ITERATIONS = 3
SEED = 20180521


def principal_directions(
    blocks: Callable[[], Iterable[NDArray[np.float32]]], dimensions: int, kept: int
) -> NDArray[np.float32]:
    """(kept, dimensions) orthonormal rows of the set whose blocks (n, R, dimensions) `blocks()` goes through."""
    width = min(dimensions, kept + SPARE)
    found = np.random.default_rng(SEED).normal(size=(dimensions, width)).astype(np.float32)
    for _ in range(ITERATIONS):
        basis = _orthonormal(found)
        found = np.zeros_like(basis)
        for block in blocks():
            rows = block.reshape(-1, dimensions)
            found += rows.T @ (rows @ basis)
    # Columns of Q R whose Q are ordered by what they carry: the singular directions of the last product.
    left, _, _ = np.linalg.svd(found.astype(np.float64), full_matrices=False)
    return np.ascontiguousarray(left[:, :kept].T, dtype=np.float32)


def project(rows: NDArray[np.float32], projection: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows (n, R, dimensions) along the directions (kept, dimensions): (n, R, kept).

    NaN and infinity count as 0, since here one of them would reach every dimension.
    """
    sound = np.nan_to_num(rows, nan=0.0, posinf=0.0, neginf=0.0)
    shrunk: NDArray[np.float32] = sound @ projection.T
    return shrunk


def _orthonormal(columns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Columns that span the same, by QR."""
    basis, _ = np.linalg.qr(columns)
    return np.asarray(basis, dtype=np.float32)
