"""Which points of two pictures are the same ones: mutual nearest neighbors, then one geometry for all of them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.keypoints import InlierMatches, Keypoints
from edge.keypoints.view_geometry import per_network_pixel

LEAST_COSINE = 0.82
"""Of two descriptors of one point; the authors' own (`XFeat.match`)."""
TOLERANCE_PX = 1.5
"""How far a point may lie from its epipolar line, in the picture that the network was given."""
HYPOTHESES, CERTAINTY = 500, 0.999
_LEAST_MATCHES = 8
"""Seven points fix a fundamental matrix."""


def mutual_matches(query: NDArray[np.int8], reference: NDArray[np.int8]) -> NDArray[np.int32]:
    """(M, 2): rows of descriptors (K, 64) and (N, 64) that are each other's most alike, over LEAST_COSINE."""
    if not (len(query) and len(reference)):
        return np.empty((0, 2), np.int32)
    cosines = query.astype(np.float32) @ reference.astype(np.float32).T
    best, rows = cosines.argmax(axis=1), np.arange(len(query))
    alike = (cosines.argmax(axis=0)[best] == rows) & (cosines[rows, best] > LEAST_COSINE * 127**2)
    return np.stack([rows[alike], best[alike]], axis=1).astype(np.int32)


def verify(query: Keypoints, reference: Keypoints) -> InlierMatches:
    """The matches that one fundamental matrix explains, found by MAGSAC++; the same each time for the same points.

    Both pictures count as if they had NETWORK_PIXELS, so cameras of any two resolutions compare.
    """
    matches = mutual_matches(query.descriptors, reference.descriptors)
    if len(matches) < _LEAST_MATCHES:
        return InlierMatches(matches[:0], len(matches))
    one, other = (
        points.xy[rows] / per_network_pixel(*points.size)
        for points, rows in zip((query, reference), matches.T, strict=True)
    )
    try:
        _, explained = cv2.findFundamentalMat(one, other, cv2.USAC_MAGSAC, TOLERANCE_PX, CERTAINTY, HYPOTHESES)
    except cv2.error:  # OpenCV 5 where the best of its hypotheses cannot be improved
        explained = None
    if explained is None:
        return InlierMatches(matches[:0], len(matches))
    return InlierMatches(matches[explained.ravel() > 0], len(matches))
