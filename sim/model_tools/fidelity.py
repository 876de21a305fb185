"""How close the descriptors of an int8 network are to the float one's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.open_network import cosines, nsd_cosines


@dataclass(frozen=True)
class Fidelity:
    """Cosines of rounded to exact descriptors over the frames and regions of one feed; after NSD they count."""

    raw_mean: float
    nsd_mean: float
    nsd_least: float


def compare(exact: NDArray[np.float32], rounded: NDArray[np.float32]) -> Fidelity:
    """Compare descriptors (N, R, D) of the same images."""
    after = nsd_cosines(exact, rounded)
    return Fidelity(float(cosines(exact, rounded).mean()), float(after.mean()), float(after.min()))
