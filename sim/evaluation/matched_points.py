"""Two pictures side by side, with a line between the points that agree."""

from __future__ import annotations

import colorsys

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.keypoints import InlierMatches, Keypoints
from edge.keypoints.matching import verify
from edge.keypoints.network import KeypointNetwork

Image = NDArray[np.uint8]
MOST_LINES = 60
"""More hide the pictures behind them."""


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
