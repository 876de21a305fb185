"""From a picture to what a place means: regions, fc6 of each, and its normalization over the traverse.

    image (H, W, 3) --regions--> (R, 224, 224, 3) --network--> raw fc6 (R, 4096) --normalize--> NSD (R, 4096)

`model_import` and `quantize` make the network's file at a desk; the vehicle never loads them. A further descriptor
is a class with `describe(images) -> (R, D) float32` that `recognizer.py` can be given in place of `Network`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class NormalizedRows:
    """What one frame changes in the ring.

    rows: (n, R, D) float32, normalized. ages: of each row, how many rows came after it. The new frame's comes first,
    with age 0; the others replace rows that are in the ring already.
    """

    rows: NDArray[np.float32]
    ages: tuple[int, ...] = (0,)
