"""The directions along which the descriptors of a map are shrunk (PCA)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from edge_plugins.mapping.builder import Shrink

SPARE = 16
"""More directions than asked for are followed, which makes the last of them come out right sooner."""
ITERATIONS = 2
SEED = 20180521


def principal_directions(
    blocks: Callable[[], Iterable[NDArray[np.float32]]], dimensions: int, kept: int
) -> NDArray[np.float32]:
    """(kept, dimensions) orthonormal rows of the set whose blocks (n, R, dimensions) `blocks()` goes through.

    Both regions share them, so that their order can still be swapped. They are the directions in which places of a
    map's own normalized set differ most (PCA about 0, which is its mean), found by subspace iteration over blocks of
    the set: memory grows with the dimensions and not with the map.
    """
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


def shrink_to(kept: int, dimensions: int) -> Shrink | None:
    """What shrinks the network's descriptors to so many dimensions; None where they stay as they are."""
    return partial(principal_directions, dimensions=dimensions, kept=kept) if kept < dimensions else None


def _orthonormal(columns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Columns that span the same, by QR."""
    basis, _ = np.linalg.qr(columns)
    return np.asarray(basis, dtype=np.float32)
