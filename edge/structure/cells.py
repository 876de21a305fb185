"""Points beside a path, counted in cells of a meter, and where those of one drive fit those of another. Pure.

Cells are (along, left, up). A match is the greatest cosine of what is more and less than usual on the map's stretch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
CELL_M = 1.0
WIDE_M, SIDEWAYS_M = 12.0, 6.0
"""To each side of the path of a window, and by how much that may lie beside the path of the map."""
LOW_M, HIGH_M = -2.0, 10.0
"""Below and above the cameras."""
USUAL_M = 60.0
"""Of the map's drive, to each side of what is searched: by which cells are normalized."""
APART, CLEAR = 6, 0.04
"""Cells to another place, and by how much a window must fit less there."""
LEAST_SIGMA_M, NOISE, FLAT = (0.3, 0.25), 0.018, 0.004
"""Standard deviation along and to the left: its least, and what divided by cosine and root of the bend adds to that."""
QUIET = 0.3
"""Added to the standard deviation of a cell, in logarithms of counts."""


class DriveCells(NamedTuple):
    """Cells (S, L, U) along a drive of the map, less the mean over the deviation (L, U) of all of them."""

    cells: Floats
    mean: Floats
    deviation: Floats

    @classmethod
    def of(cls, cells: Floats) -> DriveCells:
        """Of logarithms of counts (S, L, U)."""
        mean, deviation = cells.mean(axis=0), cells.std(axis=0) + QUIET
        return cls((cells - mean) / deviation, mean, deviation)


class Fit(NamedTuple):
    """How far along the map's drive a window's middle lies, and to the left of it; sigma_m: of both. score: cosine."""

    along_m: float
    left_m: float
    sigma_m: tuple[float, float]
    score: float


def best_fit(points: Floats, stretch: Floats, about_m: float, window_m: float, search_m: float) -> Fit | None:
    """Where points (n, 3) about the middle of a window fit those of a stretch (m, 3) of the map's drive.

    Within search_m of about_m; what is usual is judged by USUAL_M more to each side. None if another place, APART_M or
    more away, fits nearly as well.
    """
    first_m = np.floor(about_m - search_m - window_m / 2)
    places = int(np.ceil(2 * search_m / CELL_M)) + 1
    last_m = first_m + window_m + (places - 1) * CELL_M
    window = cells_of(points, -window_m / 2, window_m / 2, WIDE_M)
    usual = DriveCells.of(cells_of(stretch, first_m - USUAL_M, last_m + USUAL_M, WIDE_M + SIDEWAYS_M))
    scores = scores_of(window, usual, int(USUAL_M / CELL_M), places)
    at = np.unravel_index(scores.argmax(), scores.shape)
    row, column = int(at[0]), int(at[1])
    elsewhere = np.concatenate([scores[: max(0, row - APART)], scores[row + APART + 1 :]])
    score = float(scores[row, column])
    inside = 0 < row < len(scores) - 1 and 0 < column < scores.shape[1] - 1
    if not inside or score - elsewhere.max(initial=-1.0) < CLEAR:
        return None
    (along, along_sigma_m), (left, left_sigma_m) = (
        _peak(around, least_m)
        for around, least_m in zip(
            (scores[row - 1 : row + 2, column], scores[row, column - 1 : column + 2]), LEAST_SIGMA_M, strict=True
        )
    )
    along_m = first_m + window_m / 2 + (row + along) * CELL_M
    return Fit(float(along_m), (column + left) * CELL_M - SIDEWAYS_M, (along_sigma_m, left_sigma_m), score)


def cells_of(points: Floats, from_m: float, to_m: float, wide_m: float = WIDE_M) -> Floats:
    """Logarithms of counts (S, L, U) of points (n, 3), from and to so many meters along."""
    lows, highs = np.array([from_m, -wide_m, LOW_M]), np.array([to_m, wide_m, HIGH_M])
    size = np.rint((highs - lows) / CELL_M).astype(np.intp)
    at = np.floor((points - lows) / CELL_M).astype(np.intp)
    at = at[((at >= 0) & (at < size)).all(axis=1)]
    counts = np.bincount(np.ravel_multi_index(tuple(at.T), tuple(size)), minlength=int(size.prod()))
    return np.log1p(counts).reshape(size)


def scores_of(window: Floats, stretch: DriveCells, skipped: int, places: int, least_energy: float = 0.0) -> Floats:
    """Cosines (along, left) of a window (S, L, U) at so many places of a stretch, after those that are skipped.

    least_energy: that a place counts as having, as a share of the median: of one with less little is known.
    """
    size, wide = len(window), window.shape[1]
    usual = stretch.cells[skipped : skipped + places + size - 1]
    found = np.zeros((places, stretch.cells.shape[1] - wide + 1))
    for left in range(found.shape[1]):
        side = slice(left, left + wide)
        own = ((window - stretch.mean[side]) / stretch.deviation[side]).reshape(size, -1).astype(usual.dtype)
        there = usual[:, side].reshape(len(usual), -1)
        products = own @ there.T
        energy = np.concatenate([[0.0], np.square(there).sum(axis=1).cumsum()])
        energy = energy[size:] - energy[:-size]
        sums = sum(products[row, row : row + places] for row in range(size))
        least = least_energy * float(np.median(energy))
        found[:, left] = sums / np.sqrt(np.square(own).sum() * np.maximum(energy, least) + 1e-9)
    return found


def _peak(scores: Floats, least_m: float) -> tuple[float, float]:
    """Offset of the top of a parabola through three scores about the greatest, in cells, and its sigma in meters."""
    before, here, after = scores.tolist()
    bend = 2 * here - before - after
    return (after - before) / 2 / max(bend, 1e-9), math.hypot(
        least_m, NOISE * CELL_M / here / math.sqrt(max(bend, FLAT))
    )
