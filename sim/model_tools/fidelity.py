"""How much of the float network an int8 one keeps: cosine before and after NSD, and single-frame matching.

NSD takes out what all images share, so it amplifies the error of rounding: the cosine that counts is the one after.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.normalize import normalize

NSD_COSINE_MIN = 0.995
"""An int8 network whose mean cosine to float after NSD is below this is not good enough to ship."""


@dataclass(frozen=True)
class Fidelity:
    """Cosines of int8 to float descriptors over the frames and regions of one feed."""

    raw_mean: float
    nsd_mean: float
    nsd_least: float


def compare(exact: NDArray[np.float32], rounded: NDArray[np.float32]) -> Fidelity:
    """Compare descriptors (N, R, D) of the same images, each set normalized with its own statistics (eq. 1)."""
    raw = _cosines(exact, rounded)
    after = _cosines(normalized_set(exact), normalized_set(rounded))
    return Fidelity(float(raw.mean()), float(after.mean()), float(after.min()))


def normalized_set(raw: NDArray[np.float32]) -> NDArray[np.float32]:
    """NSD of a whole set (N, R, D), over its first axis."""
    return normalize(raw, raw.mean(axis=0, dtype=np.float64), raw.std(axis=0, dtype=np.float64))


def matching_accuracy(query: NDArray[np.float32], reference: NDArray[np.float32], correct: NDArray[np.bool_]) -> float:
    """Share of query frames (N, R, D), NSD, whose most similar reference frame (M, R, D) is in `correct` (N, M)."""
    similarity = unit_rows(normalized_set(query)) @ unit_rows(normalized_set(reference)).T
    best = similarity.argmax(axis=1)
    return float(correct[np.arange(len(best)), best].mean())


def _cosines(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float64]:
    """Cosine of each region of each frame, (N, R)."""
    products = np.einsum("nrd,nrd->nr", first, second, dtype=np.float64)
    norms = np.linalg.norm(first, axis=2).astype(np.float64) * np.linalg.norm(second, axis=2)
    return np.asarray(np.divide(products, norms, out=np.zeros_like(products), where=norms > 0))


def unit_rows(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """All regions of a frame as one vector of length 1, (N, R * D); zero stays zero."""
    flat = descriptors.reshape(len(descriptors), -1)
    norms = np.linalg.norm(flat, axis=1, keepdims=True)
    return np.asarray(np.divide(flat, norms, out=np.zeros_like(flat), where=norms > 0))
