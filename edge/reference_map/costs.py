"""Cosine distance of the query to every place, as integers, in both region orders (sections III-C and III-D).

The map keeps, instead of left and right regions, half their sum and half their difference. That is a rotation, which
no cosine sees, and swapping the regions of a query only turns the sign of its difference. So two dot products of D
values, of sums and of differences, are both region orders, and the map's bytes are read once, in one go each:

    same = s.S + d.D        swapped = s.S - d.D

Descriptors are int8 with one scale a row; dot products and squared norms are exact integers, and every step after
them is one correctly rounded float64 operation, then the fraction is cut off. So costs are the same to the bit on
every machine, and sums of them can be kept running without drift.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numkong
import numpy as np
from numpy.typing import NDArray

from edge.reference_map.store import ReferenceMap

# Its int8 kernels for ARM's SME gave wrong products under an emulator; all others, up to SVE2 and AVX-512, agree.
for _family in numkong.get_capabilities():
    if _family.startswith("sme"):
        numkong.disable_capability(_family)

COST_ONE = 1 << 14
"""Integer cost of a cosine distance of 1 (nothing in common); distances of 0 to 2 are 0 to 32768."""

BLOCK = 1 << 14
"""Costs made at a time: so many float64 stay in a core's own cache between one operation and the next."""

IN_CACHE = 1 << 13
"""Dimensions of a row that stay in a core's first cache while the places go through it: where they do not, tiles of
several places, each of which reads the row once, are faster (0.75 times as long at 32,768 dimensions, 0.85 at 16,384).
"""

FEW = 3
"""Rows that are shrunk one by one, as those of a frame: two take 0.55 to 0.7 times as long as in one product, which is
quicker from 4 rows on."""

NOTHING = 1e-36
"""A row with no larger value is all zero: 127 over less would overflow float32."""


def encode(descriptors: NDArray[np.float32]) -> NDArray[np.int8]:
    """Rows (n, R, D) float32 as a map keeps them, (R, n, D) int8: sums and differences, each row to its own scale.

    A row that is all zero stays so; NaN and infinity become 0, so that one bad number cannot poison a sequence.
    """
    # Halves first: no sum of two halves overflows.
    regions = np.where(np.isfinite(descriptors), descriptors, 0).swapaxes(0, 1) * np.float32(0.5)
    planes = np.empty(regions.shape, dtype=np.float32)
    if len(regions) == 2:
        np.add(regions[0], regions[1], out=planes[0])
        np.subtract(regions[0], regions[1], out=planes[1])
    else:
        planes[:] = regions
    largest = np.maximum(planes.max(axis=(0, 2), initial=0.0), -planes.min(axis=(0, 2), initial=0.0))
    scale = np.divide(np.float32(127), largest, out=np.zeros_like(largest), where=largest > NOTHING)
    planes *= scale[:, np.newaxis]
    encoded: NDArray[np.int8] = np.rint(planes, out=planes).astype(np.int8)
    return encoded


def squared_norms(encoded: NDArray[np.int8]) -> NDArray[np.int32]:
    """Exact squared length of every row: (R, n, D) int8 -> (n,) int32; 8192 * 127**2 fits with room."""
    rows = encoded.astype(np.int32)
    squares: NDArray[np.int32] = np.einsum("rnd,rnd->n", rows, rows, dtype=np.int32)
    return squares


class CostMatcher:
    """Matches queries against the int8 descriptors of a map, straight from the memory map."""

    def __init__(
        self, descriptors: NDArray[np.int8], inverse: NDArray[np.float64], projection: NDArray[np.float32] | None = None
    ) -> None:
        """descriptors (R, N, D) int8 as `encode` makes them; inverse (N,) as `inverse_lengths`. Both may change later.

        With R = 2 both orders are tried. projection: (D, dimensions of the network), of a map with shrunk descriptors.
        """
        self._planes, self._inverse = descriptors, inverse
        self.projection = projection
        self.orders = len(descriptors)

    @classmethod
    def of(cls, reference_map: ReferenceMap) -> CostMatcher:
        """The matcher of an open map."""
        inverse = inverse_lengths(reference_map.places["norm_sq"])
        return cls(reference_map.descriptors, inverse, reference_map.projection)

    @classmethod
    def of_encoded(cls, descriptors: NDArray[np.int8]) -> CostMatcher:
        """The matcher of descriptors (R, N, D) as `encode` makes them."""
        return cls(descriptors, inverse_lengths(squared_norms(descriptors)))

    def costs(self, query: NDArray[np.float32], ranges: Sequence[tuple[int, int]] | None = None) -> NDArray[np.int32]:
        """Normalized query rows (n, R, D) -> costs (n, orders, N) int32; order 0 is "same", order 1 "swapped".

        With `ranges`, [start, end) of places, only those are read and N is their number together. A query that is
        all zero has no direction: its cost is COST_ONE to every place, as if unrelated.
        """
        return self.costs_of_encoded(self.encoded(query), ranges)

    def encoded(self, query: NDArray[np.float32]) -> NDArray[np.int8]:
        """Normalized query rows (n, R, D) as the map keeps its own: (R, n, D) int8, shrunk if the map is."""
        return encode(query if self.projection is None else project(query, self.projection))

    def costs_of_encoded(
        self, query: NDArray[np.int8], ranges: Sequence[tuple[int, int]] | None = None
    ) -> NDArray[np.int32]:
        """The same for rows as the map keeps them, (R, n, D) int8."""
        inverse = 1.0 / _lengths(squared_norms(query))[:, np.newaxis]
        ranges = ranges or [(0, len(self._inverse))]
        count = query.shape[1]
        costs = np.empty((count, self.orders, sum(end - start for start, end in ranges)), dtype=np.int32)
        at = 0
        for start, end in _blocks(ranges, max(1, BLOCK // count)):
            scale = inverse * self._inverse[start:end]
            shares = [_dots(plane[start:end], rows) for plane, rows in zip(self._planes, query, strict=True)]
            for share in shares:
                np.multiply(share, scale, out=share)
            into = costs[:, :, at : at + end - start]
            # Nothing is below 0, so that cutting the fraction off what half was added to rounds.
            rest = np.subtract(COST_ONE + 0.5, shares[0], out=shares[0])
            if self.orders == 1:
                into[:, 0] = rest
            else:
                np.subtract(rest, shares[1], out=into[:, 0], casting="unsafe")
                np.add(rest, shares[1], out=into[:, 1], casting="unsafe")
            at += end - start
        return costs


def _blocks(ranges: Sequence[tuple[int, int]], size: int) -> Iterator[tuple[int, int]]:
    """The ranges in pieces of at most `size` places."""
    for start, end in ranges:
        for at in range(start, end, size):
            yield at, min(at + size, end)


def _dots(plane: NDArray[np.int8], rows: NDArray[np.int8]) -> NDArray[np.float64]:
    """Exact dot products (n, N) of rows (n, D) with places (N, D), as float64."""
    if len(rows) == 1 and rows.shape[1] <= IN_CACHE:
        # One place after another is as fast as the memory; tiles of several places at once are not.
        return np.asarray(numkong.cdist(plane, np.ascontiguousarray(rows), "dot")).reshape(1, -1)
    packed = numkong.dots_pack(np.ascontiguousarray(rows), "int8")
    return np.ascontiguousarray(np.asarray(numkong.dots_packed(plane, packed)).T, dtype=np.float64)


def inverse_lengths(norms_sq: NDArray[np.int32]) -> NDArray[np.float64]:
    """COST_ONE over the lengths (n,) of a map's rows, from their squares."""
    return COST_ONE / _lengths(norms_sq)


def _lengths(norms_sq: NDArray[np.int32] | NDArray[np.int64]) -> NDArray[np.float64]:
    """Lengths (n,) of rows; 1 for a row that is all zero, so that its cosine to anything is 0."""
    return np.sqrt(np.maximum(norms_sq, 1).astype(np.float64))


def project(rows: NDArray[np.float32], projection: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows (n, R, dimensions) along the directions (kept, dimensions): (n, R, kept).

    NaN and infinity count as 0, since here one of them would reach every dimension.
    """
    sound = np.nan_to_num(rows, nan=0.0, posinf=0.0, neginf=0.0)
    flat = sound.reshape(-1, sound.shape[-1])
    # Many as one product: NumPy multiplies a stack row by row, which reads the directions again for each of its rows.
    shrunk = np.stack([projection @ row for row in flat]) if len(flat) <= FEW else flat @ projection.T
    return shrunk.reshape(*rows.shape[:-1], len(projection))
