"""How often the most similar frame is the right one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.open_network import normalized_set


def unit_rows(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """All regions of a frame as one vector of length 1, (N, R * D); zero stays zero."""
    flat = descriptors.reshape(len(descriptors), -1)
    norms = np.linalg.norm(flat, axis=1, keepdims=True)
    return np.asarray(np.divide(flat, norms, out=np.zeros_like(flat), where=norms > 0))


def matching_accuracy(query: NDArray[np.float32], reference: NDArray[np.float32], correct: NDArray[np.bool_]) -> float:
    """Share of query frames (N, R, D), NSD, whose most similar reference frame (M, R, D) is in `correct` (N, M)."""
    similarity = unit_rows(normalized_set(query)) @ unit_rows(normalized_set(reference)).T
    best = similarity.argmax(axis=1)
    return float(correct[np.arange(len(best)), best].mean())
