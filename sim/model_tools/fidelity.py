"""Single-frame matching: what an int8 network keeps of the float one's ability to find places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.open_network import cosines, normalized_set, nsd_cosines


def matching_accuracy(query: NDArray[np.float32], reference: NDArray[np.float32], correct: NDArray[np.bool_]) -> float:
    """Share of query frames (N, R, D), NSD, whose most similar reference frame (M, R, D) is in `correct` (N, M)."""
    similarity = unit_rows(normalized_set(query)) @ unit_rows(normalized_set(reference)).T
    best = similarity.argmax(axis=1)
    return float(correct[np.arange(len(best)), best].mean())


def unit_rows(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """All regions of a frame as one vector of length 1, (N, R * D); zero stays zero."""
    flat = descriptors.reshape(len(descriptors), -1)
    norms = np.linalg.norm(flat, axis=1, keepdims=True)
    return np.asarray(np.divide(flat, norms, out=np.zeros_like(flat), where=norms > 0))


@dataclass(frozen=True)
class Fidelity:
    """Cosines of rounded to exact descriptors over the frames and regions of one feed; after NSD they count."""

    raw_mean: float
    nsd_mean: float
    nsd_least: float


def compare(exact: NDArray[np.float32], rounded: NDArray[np.float32]) -> Fidelity:
    """Compare descriptors (N, R, D) of the same images."""
    after = nsd_cosines(exact, rounded)
    return Fidelity(float(cosines(exact, rounded).mean()), float(after.mean()), float(after.min()))
