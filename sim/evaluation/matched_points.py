"""Which points of two pictures one geometry explains; and both side by side, with a line between those points."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.keypoints import Keypoints
from edge.keypoints.matching import mutual_matches
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.view_geometry import per_network_pixel

Image = NDArray[np.uint8]
MOST_LINES = 60
"""More hide the pictures behind them."""
TOLERANCE_PX = 1.5
"""How far a point may lie from its epipolar line, in the picture that the network was given."""
HYPOTHESES, CERTAINTY = 500, 0.999
LEAST_MATCHES = 8
"""Seven points fix a fundamental matrix."""


@dataclass(frozen=True, eq=False)
class InlierMatches:
    """Which points of two pictures are the same ones, seen from two places.

    matches: (M, 2) int32, rows of the query's points and of the reference's that one fundamental matrix explains.
    candidates: how many points were the most alike in both directions, of which these are a part.
    """

    matches: NDArray[np.int32]
    candidates: int

    @property
    def inliers(self) -> int:
        """M: in pictures of web cameras 141 at the same place by day in the median, 20 by night; 7 at another."""
        return len(self.matches)


def verify(query: Keypoints, reference: Keypoints) -> InlierMatches:
    """The matches that one fundamental matrix explains, found by MAGSAC++; the same each time for the same points.

    Both pictures count as if they had NETWORK_PIXELS, so cameras of any two resolutions compare.
    """
    matches = mutual_matches(query.descriptors, reference.descriptors)
    if len(matches) < LEAST_MATCHES:
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


def side_by_side(network: KeypointNetwork, query: Image, reference: Image) -> tuple[Image, InlierMatches]:
    """Images (H, W, 3) BGR as one, the query on the left, with what `verify` finds."""
    points = network.extract(query), network.extract(reference)
    found = verify(*points)
    return with_lines((query, reference), points, found), found


def with_lines(images: tuple[Image, Image], points: tuple[Keypoints, Keypoints], found: InlierMatches) -> Image:
    """At most MOST_LINES of the matches, the query's most reliable points, colored from the left to the right."""
    height = images[0].shape[0]
    scales = [height / image.shape[0] for image in images]
    one, other = (
        cv2.resize(image, (round(image.shape[1] * scale), height), interpolation=cv2.INTER_AREA)
        for image, scale in zip(images, scales, strict=True)
    )
    drawn = np.asarray(np.hstack([one, other]), np.uint8)
    for row, place_row in found.matches[:MOST_LINES]:
        start = points[0].xy[row] * scales[0]
        end = points[1].xy[place_row] * scales[1] + (one.shape[1], 0)
        red, green, blue = colorsys.hsv_to_rgb(0.8 * float(start[0]) / one.shape[1], 0.8, 1.0)
        color = (255 * blue, 255 * green, 255 * red)
        left, right = ((round(float(x)), round(float(y))) for x, y in (start, end))
        cv2.line(drawn, left, right, color, 1, cv2.LINE_AA)
        for at in (left, right):
            cv2.circle(drawn, at, 2, color, -1, cv2.LINE_AA)
    return drawn
