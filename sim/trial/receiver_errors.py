"""How wrong the positions of an ordinary GPS receiver are: an offset that stays for a drive, and one that wanders."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

STAYS = 0.625
"""Of one standard deviation; the rest of the variance is a first-order Gauss-Markov process."""
WANDERS_AT_M, WANDERS_AT_S = 200.0, 30.0
"""Correlation length of that process, of a drive that is mapped and of one in time."""


def receiver_errors(count: int, step: float, length: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Errors east and north (count, 2) of positions `step` apart, each with a standard deviation of 1.

    length: correlation length of what wanders, in the unit of `step`.
    """
    sigma = math.sqrt(1 - STAYS**2)
    kept = math.exp(-step / length)
    stays, error = rng.normal(0.0, STAYS, 2), rng.normal(0.0, sigma, 2)
    moves = rng.normal(0.0, sigma * math.sqrt(1 - kept**2), (count, 2))
    errors = np.empty((count, 2))
    for row in range(count):
        errors[row] = stays + error
        error = kept * error + moves[row]
    return errors
