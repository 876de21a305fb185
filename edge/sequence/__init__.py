"""From cost rows to a match: the best line through the last L rows (eq. 2 and 3), and what speaks for it.

costs (orders, N) --search--> best line that ends at each place --evidence--> PlaceMatch
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import apart_m
from edge.structure import StructureMatch

Direction = Literal["forward", "reverse"]
Order = Literal["same", "swapped"]
Alignment = tuple[Direction, Order]
"""How a line runs through the cost matrix, and which of the two costs of a place it adds up."""

ORDERS: tuple[Order, ...] = ("same", "swapped")
"""Rows of a cost row, in this order."""

VIEWS_ALIKE: tuple[Alignment, ...] = (("forward", "same"), ("reverse", "swapped"))
"""What can occur if both cameras face ahead, or both back."""

VIEWS_OPPOSED: tuple[Alignment, ...] = (("forward", "swapped"), ("reverse", "same"))
"""What can occur if one camera faces ahead and one back: on the way back along the map the two face the same way."""

MOST_OFF_COURSE_RAD = math.radians(60)
"""Between the way that the vehicle goes and that of the road that it matches. Where a mapped drive turned round and the
vehicle went on, places of the way back were believed for 40 m, and an honest GPS was declared faulty by 37 m."""

LEAST_SHARPNESS = 0.05
"""A less sharp sequence match gives no position. 52 recorded drives on maps with keypoints have 7,565 positions, none
beyond 3 sigma, and with 0.02 7,987, none either. But on five simulated roads at dusk, autopilots
with wheels 0.3 % wrong, 3.6 m off alone (95 %), are 12 to 13 m off with 0.02, on three of them 6.1 m with 0.05."""


@dataclass(frozen=True, eq=False)
class KeyframeMatch:
    """A keyframe match: the keypoints of the frame agree with those of one place, so its camera was near that one's.

    place_index: of that place, counted through all maps that are open. points: matches of known distance that agree on
    the pose. right_m, ahead_m, turn_rad: of the frame's camera from the place's, in that one's frame, turned clockwise;
    covariance: (3, 3) of these three, of geometry alone, without the error of the map's position. confidence: that this
    place is right, by this match alone.
    """

    place_index: int
    right_m: float
    ahead_m: float
    turn_rad: float
    covariance: NDArray[np.float64]
    points: int
    confidence: float

    def __eq__(self, other: object) -> bool:
        mine, theirs = vars(self), vars(other) if isinstance(other, KeyframeMatch) else {}
        return mine.keys() == theirs.keys() and all(np.array_equal(mine[name], theirs[name]) for name in mine)

    __hash__ = None  # type: ignore[assignment]


class Correspondences(NamedTuple):
    """Points of a picture and of a place that agree on one pose.

    shares: (n, 4) x and y in the picture and in the place's, as shares of width and height.
    """

    place_index: int
    shares: NDArray[np.float64]


@dataclass(frozen=True)
class PlaceMatch:
    """Place recognition by a sequence of the last frames: the place of the newest one, believed or not.

    place_index: of the place where the line through the cost matrix ends, counted through all maps that are open.
    map, place: name of the map that it lies in, None where there is only one, and its row there.
    direction: "forward" if places were passed in the map's order, "reverse" if backwards.
    order: "swapped" if the query's left region matched the map's right.
    slope: places passed per frame, without sign. step: the same by what was driven. passed: places passed since each
    frame of the line, the newest first; () where they are evenly apart. distance: mean cosine distance along the line.
    uniqueness: lowest cost outside the window around the place over this cost; below 1, another place fits better.
    sharpness: cost of the cheaper of the two lines that end 0.3 windows before and after the place, over this one's,
    less 1. row_share: share of the places that are more similar to the newest frame than those around this one.
    confidence: probability that this place is right, see `PlaceConsensus`. accepted: whether it is believed; False
    means off the map, or one of several that look alike. by_votes: the answer without `MotionPrior.dead_reckoning`,
    None where it is this one; whoever judges dead reckoning by places goes by `alone`. seen: the keyframe match of the
    frame with the place that is believed; None without one, or where the frame was not verified. structure: in opposite
    views, what stands along the last meters, see `StructureMatch`; None for most frames. has_line: False where
    the place is believed by keyframe matches alone, as of a vehicle that stands; it then is that of `seen`, and slope,
    distance and the like say nothing. event: accepted, and not held off.
    """

    place_index: int
    place: int
    direction: Direction
    order: Order
    slope: float
    distance: float
    uniqueness: float
    sharpness: float = 0.0
    row_share: float = 1.0
    confidence: float = 0.0
    accepted: bool = False
    step: float = 1.0
    passed: tuple[float, ...] = ()
    seen: KeyframeMatch | None = None
    structure: StructureMatch | None = None
    has_line: bool = True
    map: str | None = None
    event: bool = False
    by_votes: PlaceMatch | None = None

    @property
    def alone(self) -> PlaceMatch:
        """What the pictures and the odometer say alone."""
        return self.by_votes or self


@dataclass(frozen=True)
class SearchRegion:
    """Where the vehicle may be: degrees, and how many meters the position may be wrong."""

    lat_deg: float
    lon_deg: float
    radius_m: float

    def holds(self, other: SearchRegion, radius_m: float) -> bool:
        """Whether all that lies within `radius_m` of the other position lies within this circle."""
        away_m = apart_m(self.lat_deg, self.lon_deg, np.array([other.lat_deg]), np.array([other.lon_deg]))
        return bool(away_m[0] + radius_m <= self.radius_m)


@dataclass(frozen=True)
class DeadReckoningPosition:
    """Where GPS and odometry alone have the vehicle: degrees, and one standard deviation in each direction."""

    lat_deg: float
    lon_deg: float
    sigma_m: float


@dataclass(frozen=True)
class MotionPrior:
    """What is known of the vehicle at a frame, beside its picture.

    distance_m: the odometer, None where it is not known. missed: places that were passed since the last frame without
    one. search_region: where the vehicle may be; only maps too large to be searched whole make use of it. course_rad:
    that it moves on, clockwise from north, None where not known. Of places whose road leads another way, no line is
    searched. dead_reckoning: None where GPS never had it, or is doubted; places near it are more probable. moved_m:
    east and north by the odometer, from any origin.
    """

    distance_m: float | None = None
    missed: int = 0
    search_region: SearchRegion | None = None
    course_rad: float | None = None
    dead_reckoning: DeadReckoningPosition | None = None
    moved_m: tuple[float, float] | None = None


NOTHING_KNOWN = MotionPrior()
