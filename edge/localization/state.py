"""The state of the filter, a row for each part: slices, priors, process noise and docs/noises.md follow from it. Pure.

What two measurements share is a state, so that it counts once. First come the parts that belong to no drive of the map,
then OF_DRIVE for each of the drives that were matched last.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.localization.events import GPS_SIGMA_M
from edge.localization.pose_measurement import AIM_RAD

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

DRIVES = 8
"""Drives of the map whose errors are kept, twice as many as `map learn` keeps of a road. The error of one that made
room and comes back counts as new evidence: with ten in turn, it is 1.5 times what the filter says."""
GPS_SHARE = 2 / 3
"""Of what a receiver reports as its standard deviation: how much of it changes within GPS_S."""
GPS_S = 60.0
"""In which the error of GPS changes: a judgment."""
GPS_M = GPS_SHARE * GPS_SIGMA_M
"""One standard deviation of an honest GPS in each direction."""
LINE_M = 45.0
"""Correlation length of the error of sequence matches that changes, measured on three roads in five lights."""
MAP_M = 200.0
"""Correlation length of what wanders of a map's positions, as of a receiver's that go by the sky for half a minute."""
HEADING_M, COMPASS_M, SCALE_M = 250.0, 400.0, 700.0
"""Of heading errors without gyros, of the compass, and of the scale. The cross-track error of 25 recorded drives of
ArduPilot fits 200 m and 1.5 degrees; with 10 km for the scale, 4 of 8 drives had positions beyond four sigma."""
COMPASS_RAD, GYRO_RADPS = math.radians(1.5), math.radians(0.15)
"""One standard deviation of a heading that has no GPS, and of the bias of gyros. On 14 recorded drives of ArduPilot
headings were off by 0.8 to 1.4 degrees, and gyros by 0.06 to 0.15 degrees a second."""
TURNED_RAD, BIAS_RADPS = math.radians(0.05), math.radians(0.004)
"""By how much a heading by gyros and their bias change in a root second. On the same drives such headings are 1.1 to
1.8 degrees from a constant bias within 240 s."""
AGE_SIGMA_S, AGE_S = 0.08, 600.0
"""One standard deviation of by how much pictures are older than they say, and in which it changes: judgments. With
stamps 0.5 s off at 8 m/s, positions were 4.4 sigma off without it; with right ones their sigma is 2 to 4 % larger."""
WANDER = 0.03
"""Meters of error per square root of a meter driven that heading and scale do not explain."""


class Part(NamedTuple):
    """Of the state.

    what: in docs/noises.md. size: of how many numbers. sigma: one standard deviation of each, at first and as it goes
    on; 0 where `Filter` or `DriveErrors` say it. over_m, over_s: correlation length and time of a first-order
    Gauss-Markov process. walk_m, walk_s: of a random walk, standard deviation after a meter driven, and after a second
    by gyros.
    """

    what: str
    size: int = 1
    sigma: float = 0.0
    over_m: float = math.inf
    over_s: float = math.inf
    walk_m: float = 0.0
    walk_s: float = 0.0


OF_ALL = (
    Part("position", 2, walk_m=WANDER),
    Part("heading of the velocity", over_m=HEADING_M, walk_s=TURNED_RAD),
    Part("scale of the velocity", over_m=SCALE_M),
    Part("doubtful meters, as of spinning wheels"),
    Part("gyro bias", sigma=GYRO_RADPS, walk_s=BIAS_RADPS),
    Part("compass, without GPS", sigma=COMPASS_RAD, over_m=COMPASS_M),
    Part("age of the pictures", over_s=AGE_S),
    Part("GPS", 2, GPS_M, over_s=GPS_S),
    Part("GPS that drifts", 2),
)
"""What belongs to no drive of the map."""
OF_DRIVE = (
    Part("the map's positions", 2, over_m=MAP_M),
    Part("a whole drive of the map", 2),
    Part("sequence match"),
    Part("sequence match", over_m=LINE_M),
    Part("how the camera is turned", sigma=AIM_RAD),
)
"""What belongs to each."""


class Slot(NamedTuple):
    """Where the states of one drive of the map are.

    map, whole: what wanders, east and north, and what all positions are off by. stays, changes: of sequence matches
    along-track, for the drive and within LINE_M. aim: yaw error of keypoint poses, clockwise.
    """

    map: slice
    whole: slice
    stays: slice
    changes: slice
    aim: slice


def _slices(parts: Sequence[Part], begin: int) -> Iterator[slice]:
    for part in parts:
        yield slice(begin, begin + part.size)
        begin += part.size


POSITION, HEADING, SCALE, DOUBT, GYRO, COMPASS, AGE, GPS, DRAG = _slices(OF_ALL, 0)
"""Where the parts of OF_ALL are."""
VELOCITY = slice(HEADING.start, DOUBT.stop)
"""What of the autopilot's velocity is wrong."""
SIZE = sum(part.size for part in OF_DRIVE)
SLOTS = tuple(Slot(*_slices(OF_DRIVE, DRAG.stop + number * SIZE)) for number in range(DRIVES))
NUMBERS = np.array(
    [part[2:] for part in OF_ALL + OF_DRIVE * DRIVES for _ in range(part.size)],
    [(name, np.float64) for name in Part._fields[2:]],
)
"""The table again, a row for each number of the state."""


@dataclass(frozen=True)
class DriveErrors:
    """Standard deviations of what is wrong of one drive of the map, in meters and radians.

    map_m: what wanders of its positions, in each direction. whole: covariance (2, 2) of what they are off by together.
    stays_m, changes_m: of sequence matches along-track, for the whole drive and within LINE_M. lane_m: of the vehicle's
    lane. crept_m2: see `MapDrive`; between two places, the variance of what their positions are off by against each
    other.
    """

    map_m: float
    whole: Matrix
    stays_m: float
    changes_m: float
    lane_m: float
    crept_m2: float = 0.0
