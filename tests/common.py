"""What many modules of tests mean by the same name."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]
S = 1_000_000_000
"""Nanoseconds of a second."""
PATIENCE_S = 120.0
"""After so long what is waited for does not come; a busy machine takes its time."""


def picture_of(seed: int) -> NDArray[np.uint8]:
    """A picture (48, 64, 3) that shows something, and another one for each seed: colors that blend."""
    coarse = np.random.default_rng(seed).integers(0, 255, (4, 5, 3), np.uint8)
    return np.asarray(cv2.resize(coarse, (64, 48), interpolation=cv2.INTER_LINEAR))
