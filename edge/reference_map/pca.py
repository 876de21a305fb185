"""Descriptors shrunk to fewer dimensions: the principal directions of a map's own normalized set.

Both regions share one matrix, so that their order can still be swapped. Directions are those in which places differ
most (PCA about 0, which is the mean of a normalized set), found by subspace iteration over blocks of the set: memory
grows with the dimensions and not with the map.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

SPARE = 16
"""More directions than asked for are followed, which makes the last of them come out right sooner."""
ITERATIONS = 2
SEED = 20180521


def principal_directions(
    blocks: Callable[[], Iterable[NDArray[np.float32]]], dimensions: int, kept: int
) -> NDArray[np.float32]:
    """(kept, dimensions) orthonormal rows of the set whose blocks (n, R, dimensions) `blocks()` goes through."""
    width = min(dimensions, kept + SPARE)
    basis = _orthonormal(np.random.default_rng(SEED).normal(size=(dimensions, width)).astype(np.float32))
    for _ in range(ITERATIONS):
        product = np.zeros_like(basis)
        for block in blocks():
            rows = block.reshape(-1, dimensions)
            product += rows.T @ (rows @ basis)
        basis = _orthonormal(product)
    # What is left is to turn the basis so that its first directions carry the most.
    carried = np.zeros((width, width))
    for block in blocks():
        rows = block.reshape(-1, dimensions) @ basis
        carried += rows.T @ rows
    _, turn = np.linalg.eigh(carried)
    return np.ascontiguousarray((basis @ turn[:, ::-1][:, :kept].astype(np.float32)).T)


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
