"""How far descriptors of the same images agree: of an int8 network with its float weights, of a provider with the CPU.

NSD takes out what all images share, so it amplifies every error of rounding: the cosine that counts is the one after.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.normalize import normalize

NSD_COSINE_MIN = 0.995
"""Descriptors whose mean cosine to the exact ones after NSD is below this are not good enough to use."""


@dataclass(frozen=True)
class Fidelity:
    """Cosines of rounded to exact descriptors over the frames and regions of one feed."""

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


def _cosines(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float64]:
    """Cosine of each region of each frame, (N, R)."""
    products = np.einsum("nrd,nrd->nr", first, second, dtype=np.float64)
    norms = np.linalg.norm(first, axis=2).astype(np.float64) * np.linalg.norm(second, axis=2)
    return np.asarray(np.divide(products, norms, out=np.zeros_like(products), where=norms > 0))
