"""The rig's along-route offset, robustly: the median, and what the median absolute deviation leaves in.

A front and a rear camera see the same thing at different times, so the matched place lies ahead of the vehicle by tens
of metres, the same on the whole route but for what stands beside it. Some matches are plainly wrong; a median does not
follow them, and those beyond OUTLIER deviations of it are set aside and counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.config import RigConfig
from edge.sequence import ORDERS, Direction, Order, Plane
from sim.calibration.sightings import Sighting

MAD_TO_SIGMA = 1.4826  # of a normal distribution
OUTLIER = 4.0
LANE_SIGMA_M = 2.0
FEWEST = 10
DIRECTIONS: tuple[Direction, ...] = ("forward", "reverse")


@dataclass(frozen=True)
class Offset:
    """Of one direction and region order: matches used and set aside, their median, and the errors left after it.

    sigma_m: 1.4826 times the median absolute deviation. left_95_m: 95 % of the used matches are within it.
    aside_m, aside_sigma_m: how far left of the map's drive the vehicle drove, and its deviation in the same way.
    """

    direction: Direction
    order: Order
    used: int
    set_aside: int
    ahead_m: float
    sigma_m: float
    left_95_m: float
    aside_m: float = 0.0
    aside_sigma_m: float = 0.0


def measure_offsets(seen: Sequence[Sighting]) -> list[Offset]:
    """From the believed matches; a kind with fewer than FEWEST of them is left out."""
    found = (_measure(seen, (direction, order)) for direction in DIRECTIONS for order in ORDERS)
    return [offset for offset in found if offset is not None]


def _measure(seen: Sequence[Sighting], plane: Plane) -> Offset | None:
    believed = [one.ahead_m for one in seen if one.accepted and (one.direction, one.order) == plane]
    ahead_m = np.array([value for value in believed if not np.isnan(value)])
    if len(ahead_m) < FEWEST:
        return None
    median_m = np.median(ahead_m)
    # A metre at least: places are that far apart, and a perfect drive must not lose half of its matches.
    sigma_m = max(1.0, MAD_TO_SIGMA * float(np.median(np.abs(ahead_m - median_m))))
    used_m = ahead_m[np.abs(ahead_m - median_m) <= OUTLIER * sigma_m]
    left_m = np.abs(used_m - np.median(used_m))
    aside_m = np.array([one.left_m for one in seen if (one.direction, one.order) == plane])
    aside_m = aside_m[~np.isnan(aside_m)] if not np.isnan(aside_m).all() else np.zeros(1)
    return Offset(
        *plane,
        used=len(used_m),
        set_aside=len(believed) - len(used_m),
        ahead_m=float(np.median(used_m)),
        sigma_m=MAD_TO_SIGMA * float(np.median(left_m)),
        left_95_m=float(np.percentile(left_m, 95)),
        aside_m=float(np.median(aside_m)),
        aside_sigma_m=MAD_TO_SIGMA * float(np.median(np.abs(aside_m - np.median(aside_m)))),
    )


def rig_config(offsets: Sequence[Offset]) -> RigConfig:
    """The [rig] section, to the decimetre; 0 for what no drive has measured.

    A lane is kept no better than LANE_SIGMA_M, however well these drives kept it.
    """
    keys = {rig_key(offset): round(offset.ahead_m, 1) for offset in offsets}
    keys |= {f"left_{offset.direction}_m": round(offset.aside_m, 1) for offset in offsets}
    across_m = max((offset.aside_sigma_m for offset in offsets), default=RigConfig().sigma_across_m)
    return RigConfig(**keys, sigma_across_m=round(max(LANE_SIGMA_M, across_m), 1))


def rig_key(offset: Offset) -> str:
    """The key of [rig] that an offset goes to."""
    return f"ahead_{offset.direction}_{offset.order}_m"
