"""From a picture to what a place means: regions, a descriptor of each, and its normalization over the traverse.

    image (H, W, 3) --regions--> (R, h, w, 3) --network--> raw descriptors (R, D) --normalize--> NSD (R, D)

The file of the network says h, w and D; for the shipped one they are 224, 224 and 4096 (an AlexNet). `sim/model_tools`
makes such a file of any image network at a desk; `open_network` opens it on the provider that the config names.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.statistics import RunningStatistics

__all__ = ["NormalizedRows", "RunningStatistics"]


@dataclass(frozen=True)
class NormalizedRows:
    """What one frame changes in the ring.

    rows: (n, R, D) float32, normalized. ages: of each row, how many rows came after it. The new frame's comes first,
    with age 0; the others replace rows that are in the ring already.
    """

    rows: NDArray[np.float32]
    ages: tuple[int, ...] = (0,)
