"""The rig's along-track offset: a median without outliers.

A front and a rear camera see the same object at different times, so the matched place lies tens of meters ahead of the
vehicle; the distance depends on what stands beside the road. Wrong matches do not move a median, and those further from
it than OUTLIER deviations are excluded and counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.config import RigConfig
from edge.sequence import ORDERS, Alignment, Direction, Order
from sim.calibration.offset_samples import OffsetSample

MAD_TO_SIGMA = 1.4826  # of a normal distribution
OUTLIER = 4.0
LANE_SIGMA_M = 2.5
LEAST_SIGMA_M = 0.5  # of GPS, the reference of the measurement
FEWEST = 10
STRETCH_M = 80.0
"""Matches so near each other count as one: what stands beside the road there shifts them alike. On two simulated roads
in both directions, the errors of matches 10 m apart had a correlation of .7, 40 m apart .4, 80 m apart .1."""
DIRECTIONS: tuple[Direction, ...] = ("forward", "reverse")


@dataclass(frozen=True)
class Offset:
    """Of one direction and region order: the median of the used matches, and the errors that remain after it.

    used, outliers: number of matches. left_m: root mean square of the remaining errors. left_95_m: 95 % of the used
    matches are within it. ahead_sigma_m: standard deviation of ahead_m, which a longer drive measures better. sigma_m:
    that, and the part of left_m that is the rig's, without what the daemon itself knows of the uncertainty of each
    match. lateral_m, lateral_sigma_m: how far left of the map's drive the vehicle drove, and its standard deviation.
    pose_m, pose_sigma_m: how far the camera is ahead of the vehicle by keypoint poses, NaN of too few.
    """

    direction: Direction
    order: Order
    used: int
    outliers: int
    ahead_m: float
    left_m: float
    left_95_m: float
    ahead_sigma_m: float
    sigma_m: float
    lateral_m: float = 0.0
    lateral_sigma_m: float = 0.0
    pose_m: float = float("nan")
    pose_sigma_m: float = float("nan")


def measure_offsets(seen: Sequence[OffsetSample]) -> list[Offset]:
    """From the accepted matches; a direction and order with fewer than FEWEST of them has no offset."""
    found = (_measure(seen, (direction, order)) for direction in DIRECTIONS for order in ORDERS)
    return [offset for offset in found if offset is not None]


def _measure(seen: Sequence[OffsetSample], plane: Alignment) -> Offset | None:
    accepted = [one for one in seen if one.accepted and (one.direction, one.order) == plane]
    placed = [one for one in accepted if not np.isnan(one.ahead_m)]
    if len(placed) < FEWEST:
        return None
    ahead_m = np.array([one.ahead_m for one in placed])
    # At least a meter, the distance of places: a perfect drive must not lose half of its matches.
    used = np.abs(ahead_m - np.median(ahead_m)) <= OUTLIER * max(1.0, _deviation(ahead_m))
    error_m = ahead_m - np.median(ahead_m[used])
    line_sigma_m = np.array([one.line_sigma_m for one in placed])
    followed = used & ~np.isnan(line_sigma_m)
    left_m = float(np.sqrt(np.mean(np.square(error_m[used]))))
    rig_variance = left_m**2  # where all were believed by keyframe matches, and the sequences' share is not known
    if followed.any():
        rig_variance = float(np.mean(np.square(error_m[followed])) - np.mean(np.square(line_sigma_m[followed])))
    stretches = np.unique(np.array([one.place_m for one in placed])[used] // STRETCH_M).size
    # The variance of a median is pi / 2 times that of a mean.
    ahead_sigma_m = max(LEAST_SIGMA_M, left_m * float(np.sqrt(np.pi / 2 / max(1, stretches - 1))))
    lateral_m = np.array([one.left_m for one in seen if (one.direction, one.order) == plane])
    lateral_m = lateral_m[~np.isnan(lateral_m)] if not np.isnan(lateral_m).all() else np.zeros(1)
    pose_m, pose_sigma_m = _by_poses([one for one in placed if not np.isnan(one.pose_m)])
    return Offset(
        *plane,
        used=int(used.sum()),
        outliers=len(accepted) - int(used.sum()),
        ahead_m=float(np.median(ahead_m[used])),
        left_m=left_m,
        left_95_m=float(np.percentile(np.abs(error_m[used]), 95)),
        ahead_sigma_m=ahead_sigma_m,
        sigma_m=float(np.hypot(ahead_sigma_m, np.sqrt(max(rig_variance, 0.0)))),
        lateral_m=float(np.median(lateral_m)),
        lateral_sigma_m=_deviation(lateral_m),
        pose_m=pose_m,
        pose_sigma_m=pose_sigma_m,
    )


def _by_poses(seen: Sequence[OffsetSample]) -> tuple[float, float]:
    """The median offset of keypoint poses, and one standard deviation of that; NaN of fewer than FEWEST."""
    if len(seen) < FEWEST:
        return float("nan"), float("nan")
    pose_m, segments = np.array([one.pose_m for one in seen]), np.unique([one.place_m // STRETCH_M for one in seen])
    of_median_m = _deviation(pose_m) * float(np.sqrt(np.pi / 2 / max(1, segments.size - 1)))
    return float(np.median(pose_m)), max(LEAST_SIGMA_M, of_median_m)


def _deviation(values: NDArray[np.float64]) -> float:
    """Standard deviation, estimated by the median absolute deviation, which outliers do not change."""
    return MAD_TO_SIGMA * float(np.median(np.abs(values - np.median(values))))


def rig_config(offsets: Sequence[Offset]) -> RigConfig:
    """The [rig] section, rounded to 0.1 m; 0 for what no drive has measured.

    sigma_along_m, of directions and orders that were not measured, is the largest that was. sigma_cross_track_m is at
    least LANE_SIGMA_M, however well these drives kept their lane.
    """
    keys = {rig_key(offset): round(offset.ahead_m, 1) for offset in offsets}
    keys |= {sigma_key(offset): round(offset.sigma_m, 1) for offset in offsets}
    along_m = max((offset.sigma_m for offset in offsets), default=RigConfig().sigma_along_m)
    keys |= {f"left_{offset.direction}_m": round(offset.lateral_m, 1) for offset in offsets}
    cross_track_m = max((offset.lateral_sigma_m for offset in offsets), default=RigConfig().sigma_cross_track_m)
    with_pose = [offset for offset in offsets if not np.isnan(offset.pose_m)]
    keys |= {look_key(offset): round(offset.pose_m, 1) for offset in with_pose}
    if with_pose:
        keys["look_sigma_m"] = round(max(offset.pose_sigma_m for offset in with_pose), 1)
    return RigConfig(
        **keys, sigma_along_m=round(along_m, 1), sigma_cross_track_m=round(max(LANE_SIGMA_M, cross_track_m), 1)
    )


def rig_key(offset: Offset) -> str:
    """The key of [rig] for an offset."""
    return f"ahead_{offset.direction}_{offset.order}_m"


def look_key(offset: Offset) -> str:
    """The key of [rig] for how far the camera is ahead of the vehicle by keypoint poses."""
    return f"look_ahead_{offset.direction}_m"


def sigma_key(offset: Offset) -> str:
    """The key of [rig] for its standard deviation."""
    return f"sigma_{offset.direction}_{offset.order}_m"
