"""The two regions of each frame of a drive without pictures: costs around a line, as wrong as on drives with them.

The line of a region lies further along by half of PLACES_APART meters for each meter beside the map's drive, and by an
error that changes over CORRELATED_M. It is the less distinct, and the more wrong, the further the vehicle is from the
map's drive, and now and then another place is more similar.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from edge.sequence import Parallax
from edge.sequence.parallax import PARALLAX_ROWS, REACH
from edge.sequence_matcher import PARALLAX_EVERY

PLACES_APART = 2.5  # meters between the regions' lines for each meter aside
REGION_M, CORRELATED_M = 1.2, 60.0
DISTINCT, DISTINCT_M = 0.3, 6.5  # by how much the costs of the right place are lower, and beside the drive e times less
FAR = 0.02  # the same far beside it
NOISE = 0.05  # standard deviation of one cost
WRONG = 1 / 30  # share of the lines that show another place


def error_m(contrast: float) -> float:
    """One sigma of the line of a region, as measured on drives with pictures, less what is not of the regions alone."""
    return math.sqrt(max(REGION_M**2, 1.3 / contrast - 5.0))


class RegionViews:
    """What the regions of the newest frames show."""

    def __init__(self, rng: np.random.Generator, spacing_m: float) -> None:
        self._rng, self._spacing_m = rng, spacing_m
        self._errors = rng.normal(0.0, 1.0, 2)
        self._rows: deque[tuple[int, float, float, NDArray[np.float64]] | None] = deque(maxlen=PARALLAX_ROWS)
        self._frames = 0

    def add(self, shown: tuple[int, float] | None, right_m: float) -> None:
        """A frame: segment of the map and meters along it, and meters to the right of its drive; None off the map."""
        kept = math.exp(-self._spacing_m / CORRELATED_M)
        self._errors = kept * self._errors + math.sqrt(1 - kept**2) * self._rng.normal(0.0, 1.0, 2)
        self._rows.append(None if shown is None else (*shown, -right_m, self._errors))

    def parallax(self, segment: int, row: int, slope: float) -> Parallax | None:
        """Of a line that ends at a row of a segment, of one match in PARALLAX_EVERY."""
        self._frames += 1
        if self._frames % PARALLAX_EVERY:
            return None
        costs = np.stack([self._noise(), self._noise()])
        ages = np.arange(len(self._rows))
        places = row - np.rint(slope * ages)
        wrong_m = self._rng.uniform(-25, 25, 2) * (self._rng.random(2) < WRONG)
        for age, shown in zip(ages, reversed(self._rows), strict=True):
            if shown is None or shown[0] != segment:
                continue
            _, along_m, left_m, errors = shown
            distinct = max(FAR, DISTINCT * math.exp(-abs(left_m) / DISTINCT_M))
            beyond_m = along_m + error_m(distinct) * errors + wrong_m + PLACES_APART * left_m * np.array([-0.5, 0.5])
            lies = beyond_m / self._spacing_m - places[age]
            away = np.arange(-REACH, REACH + 1) - lies[:, np.newaxis]
            costs[:, age] -= distinct / (1 + (away / 2) ** 2)
        return Parallax(ages, costs)

    def _noise(self) -> NDArray[np.float64]:
        """Costs (rows, steps); neighboring places are alike."""
        noise = self._rng.normal(0.0, NOISE, (len(self._rows), 2 * REACH + 3))
        alike: NDArray[np.float64] = (noise[:, :-2] + noise[:, 1:-1] + noise[:, 2:]) / math.sqrt(3)
        return 1.0 + alike
