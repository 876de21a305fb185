"""The protection levels that an autopilot has received, and for how much of a drive one was below a limit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge.telemetry.encoders import LEVEL_NAMES
from sim.vehicle.autopilot import MessageArrival

WITHIN_S = 3.0
"""For so long after a position its protection level holds."""
LIMIT_M = 15.0


def protection_levels(received: Sequence[MessageArrival]) -> NDArray[np.float64]:
    """Time in seconds, and meters along and across, (n, 3), one row for each that was received."""
    values = [
        (item.time_s, item.message.name, item.message.value)
        for item in received
        if item.message.get_type() == "NAMED_VALUE_FLOAT"
    ]
    along_m, cross_track_m = (
        [(at, value) for at, name, value in values if name == one.decode()] for one in LEVEL_NAMES
    )
    found = [(at_s, along, across) for (at_s, along), (_, across) in zip(along_m, cross_track_m, strict=False)]
    return np.array(found).reshape(-1, 3)


def availability(levels: NDArray[np.float64], times_s: NDArray[np.float64], limit_m: float = LIMIT_M) -> float:
    """Share of some moments at which the newest position is no older than WITHIN_S, with levels below a limit."""
    newest = np.searchsorted(levels[:, 0], times_s, side="right")
    first = [[-np.inf, np.inf, np.inf]]
    at_s, along_m, cross_track_m = np.concatenate([first, levels])[newest].T
    return float(np.mean((times_s - at_s <= WITHIN_S) & (np.maximum(along_m, cross_track_m) < limit_m)))
