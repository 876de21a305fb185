"""SeqSLAM (Milford and Wyeth, ICRA 2012) as in OpenSeqSLAM: the paper's baseline, with a search of its own.

gray 64x32 -> patch normalization -> sum of absolute differences -> local contrast -> trajectories -> uniqueness

A match for query N looks at ds/2 frames after N, as the published program does; its indices and ratios equal that
program's.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE_PX = (64, 32)
PATCH_PX = 8
CONTRAST_WINDOW, WINDOW = 10, 10
"""The published parameters: places (`Rwindow` of the enhancement), and those around the best whose scores are not the
second best; both even."""
SLOPES = (0.8, 1.2)
"""Least and greatest, places a frame."""


def describe(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Image (H, W, 3) uint8 BGR -> (32, 64) float32: gray, downsampled, each 8x8 patch at mean 0 and deviation 1.

    Rounded to whole deviations, as the published program does. A patch of one gray becomes 0, its mean; there it
    would stand for black.
    """
    gray = cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), SIZE_PX, interpolation=cv2.INTER_AREA)
    rows, columns = SIZE_PX[1] // PATCH_PX, SIZE_PX[0] // PATCH_PX
    patches = gray.astype(np.float64).reshape(rows, PATCH_PX, columns, PATCH_PX)
    mean = patches.mean(axis=(1, 3), keepdims=True)
    deviation = patches.std(axis=(1, 3), ddof=1, keepdims=True)
    scaled = np.divide(patches - mean, deviation, out=np.zeros_like(patches), where=deviation > 0)
    # Half away from zero, as MATLAB rounds.
    rounded = np.sign(scaled) * np.floor(np.abs(scaled) + 0.5)
    return np.ascontiguousarray(rounded.reshape(gray.shape), dtype=np.float32)


def difference_matrix(reference: NDArray[np.float32], query: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean absolute difference of every pair: (N, 32, 64), (Q, 32, 64) -> (N, Q)."""
    out = np.empty((len(reference), len(query)), dtype=np.float32)
    for column, image in enumerate(query):
        out[:, column] = np.abs(reference - image).mean(axis=(1, 2))
    return out


def enhance_contrast(differences: NDArray[np.floating]) -> NDArray[np.float32]:
    """Each difference less the mean, over the sample deviation, of the places around it: (N, Q).

    Shifted in the end so that the least is 0, since uniqueness is a ratio. Where a query differs from all of these
    places by the same, there is no contrast: 0 before the shift.
    """
    out, half = np.zeros(differences.shape, dtype=np.float32), CONTRAST_WINDOW // 2
    for place in range(len(differences)):
        near = differences[max(0, place - half) : place + half + 1].astype(np.float64)
        deviation = near.std(axis=0, ddof=1)
        away = differences[place] - near.mean(axis=0)
        out[place] = np.divide(away, deviation, out=np.zeros_like(away), where=deviation > 0)
    out -= out.min()
    return out


def search(
    differences: NDArray[np.floating], length: int
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Trajectories through a difference matrix (N, Q) that was enhanced already, if it is to be.

    length: frames of a trajectory less one (`ds`), even. Returns the place of each query (Q,), from 0, -1 where no
    whole window fits; its best score over the best outside the window (Q,), smaller is surer, NaN where there is
    none; and the scores (Q, N), the lower the better.
    """
    places, queries = differences.shape
    lines = _offsets(length)
    # Below the last place lies infinity: a trajectory that leaves the map costs that.
    padded = np.vstack([differences, np.full((1, queries), np.inf, dtype=differences.dtype)])
    rows = np.minimum(np.arange(places)[:, np.newaxis, np.newaxis] + lines, places)
    place = np.full(queries, -1, dtype=np.intp)
    ratio = np.full(queries, np.nan)
    ahead = length // 2
    all_scores = np.full((queries, places), np.inf)
    for query in range(length - ahead, queries - ahead):
        columns = np.arange(query + ahead - length, query + ahead + 1)
        sums = padded[rows, columns].sum(axis=2)
        scores = sums.min(axis=1)
        best = int(scores.argmin())
        if not np.isfinite(scores[best]):
            continue
        all_scores[query, ahead:] = scores[: places - ahead]
        ratio[query] = uniqueness(scores, best)
        place[query] = best + ahead
    return place, ratio, all_scores


def _offsets(length: int) -> NDArray[np.intp]:
    """Places passed at each frame of each trajectory, (K, length + 1): one for every whole end offset, rounded down."""
    ends = np.arange(SLOPES[0] * length, SLOPES[1] * length + 1e-9)
    offsets: NDArray[np.intp] = np.floor(np.arange(length + 1) * (ends / max(length, 1))[:, np.newaxis]).astype(np.intp)
    return offsets


def uniqueness(scores: NDArray[np.floating], best: int) -> float:
    """A place's score, of scores (N,), over the best outside the window; NaN if nothing is outside, 1 if both are 0."""
    outside = np.concatenate([scores[: max(0, best - WINDOW // 2)], scores[best + WINDOW // 2 + 1 :]])
    if not outside.size or not np.isfinite(outside.min()):
        return float("nan")
    second = float(outside.min())
    return float(scores[best]) / second if second > 0 else 1.0
