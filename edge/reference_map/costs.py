"""Cosine distance of the query to every place, as integers, in both region orders (sections III-C and III-D).

Descriptors are int8 with one scale a row, which the cosine does not see; dot products and squared norms are exact
integers, and every step after them is one correctly rounded float64 operation. So costs are the same to the bit on
every machine, and sums of them can be kept running without drift.
"""

from __future__ import annotations

from collections.abc import Sequence

import numkong
import numpy as np
from numpy.typing import NDArray

COST_ONE = 1 << 14
"""Integer cost of a cosine distance of 1 (nothing in common); distances of 0 to 2 are 0 to 32768."""


def quantize(descriptors: NDArray[np.float32]) -> NDArray[np.int8]:
    """Rows (n, R, D) or (n, R * D) float32 as int8 of the same shape, each row scaled to its own largest value.

    A row that is all zero stays so; NaN and infinity become 0, so that one bad number cannot poison a sequence.
    """
    rows = np.nan_to_num(descriptors, nan=0.0, posinf=0.0, neginf=0.0).reshape(len(descriptors), -1)
    largest = np.abs(rows).max(axis=1, keepdims=True)
    scale = np.divide(127.0, largest, out=np.zeros_like(largest), where=largest > 0)
    quantized: NDArray[np.int8] = np.rint(rows * scale).astype(np.int8).reshape(descriptors.shape)
    return quantized


def squared_norms(quantized: NDArray[np.int8]) -> NDArray[np.int32]:
    """Exact squared length of every row: (n, ...) int8 -> (n,) int32; 8192 * 127**2 fits with room."""
    rows = quantized.reshape(len(quantized), -1).astype(np.int32)
    squares: NDArray[np.int32] = np.einsum("ij,ij->i", rows, rows, dtype=np.int32)
    return squares


class CostMatcher:
    """Matches queries against the int8 descriptors of a map, straight from the memory map."""

    def __init__(self, descriptors: NDArray[np.int8], norms_sq: NDArray[np.int32], regions: int) -> None:
        """descriptors (N, R * D) int8, norms_sq (N,) int32; with R = 2 both region orders are tried."""
        self._descriptors = descriptors
        self._norms = np.sqrt(norms_sq.astype(np.float64))
        self._regions = regions
        self.orders = regions

    def costs(self, query: NDArray[np.float32], ranges: Sequence[tuple[int, int]] | None = None) -> NDArray[np.int32]:
        """Normalised query rows (n, R, D) -> costs (n, orders, N) int32; order 0 is "same", order 1 "swapped".

        With `ranges`, [start, end) of places, only those are read and N is their number together. A query that is
        all zero has no direction: its cost is COST_ONE to every place, as if unrelated.
        """
        quantized = quantize(query)
        # The map keeps left-right; the query is tried left-right and right-left. The norm is the same for both.
        orders = [quantized, quantized[:, ::-1]] if self._regions == 2 else [quantized]
        stacked = np.stack(orders, axis=1).reshape(len(query) * self.orders, -1)
        packed = numkong.dots_pack(np.ascontiguousarray(stacked), "int8")
        lengths = np.repeat(np.sqrt(squared_norms(quantized).astype(np.float64)), self.orders)
        parts = [
            _cosine_costs(np.asarray(numkong.dots_packed(self._descriptors[start:end], packed)), norms, lengths)
            for start, end in ranges or [(0, len(self._norms))]
            for norms in (self._norms[start:end],)
        ]
        costs = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return np.ascontiguousarray(costs.T).reshape(len(query), self.orders, -1)


def _cosine_costs(
    dots: NDArray[np.int32], norms: NDArray[np.float64], lengths: NDArray[np.float64]
) -> NDArray[np.int32]:
    """Integer costs (N, q) of dot products (N, q) and the lengths of places (N,) and queries (q,)."""
    product = norms[:, np.newaxis] * lengths
    cosine = np.divide(dots, product, out=np.zeros(dots.shape), where=product > 0)
    costs: NDArray[np.int32] = np.rint((1.0 - cosine) * COST_ONE).astype(np.int32)
    return costs
