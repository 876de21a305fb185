"""One picture with its time: what live cameras and recordings hand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Frame:
    """One picture.

    image: (H, W, 3) uint8, BGR as OpenCV has it; the camera's own buffer, not to be written to.
    stamp_ns: exposure on CLOCK_MONOTONIC for live cameras, the feed's own time for feeds read as files.
    index: the camera's frame counter, or the row of the feed; gaps are frames that were never read.
    """

    image: NDArray[np.uint8]
    stamp_ns: int
    index: int
