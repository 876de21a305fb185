"""The dead reckoning position as a prior: odds for the places that votes speak for. Pure.

GPS and odometry give a position, to one standard deviation. Three hypotheses explain that, and the votes:

    here        it is at the place that they speak for
    beside      it is near there, on none of the map's roads: on one of which the votes say the same
    elsewhere   it is off the map, or at another place, and they speak for any of those that are searched

    road = likelihood of the position on the nearest road of the map / evenly within OFF_ROAD_M of that road
    near = likelihood of the position at the place / mean of that at all places that are searched
    odds of the place = odds by the votes * road * near / max(1, near), at least LEAST

Against the place counts the likelier of the two others, which is `beside` from near = 1 on: the position speaks for the
roads near it, not for a single place. Where near counted as well, up to 11.5 in all, 70 of
7,260 frames were believed on a road 20 m beside the map's, 500 m and more after GPS was lost; so, none, as by the votes
alone. On the map .970 of the frames were believed, and .969; in snow .921, and .899 (three roads).
Where the position is far less certain than the map is large, road and near are 1, and the belief is that of the votes
alone. Where it lies away from all roads of the map, road is far below 1, and so is the belief.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

ALONG_M = 20.0
"""By how much a match may lie ahead of the vehicle or behind it, to one standard deviation: from 8 m behind it to 25 m
ahead, depending on what is seen from afar."""
CROSS_TRACK_M = 5.0
"""The same cross-track: another lane, and the GPS of the drive that made the map."""
OFF_ROAD_M = 100.0
"""Within so many meters of its roads, a vehicle is as often on the map as off it."""
LEAST = 0.25
"""Dead reckoning silences no place of which the votes are certain, since it may be off by more than its sigma says (3.3
standard deviations: with less, for 400 m). The highest confidence by votes alone on 96 km of other roads was 0.957, 22
to 1, which this brings below what is believed."""
MEAN_OF = 1000
"""Places whose mean likelihood stands for that of all, a few of which are as near as ALONG_M."""
STRAY_SHARE, STRAY = 0.01, 4.0
"""Share of positions that are worse than their sigma says, and how many times. On 30 recorded drives of real autopilots
none was off by more than 1.1 sigma, but one at a reboot (2.2); on four whose GPS was spoofed, before it was declared
faulty, by up to 22. A tenth that are 3 times worse gave a recall of .80 instead of .78 in snow, and a road
20 m beside the map's, by GPS, odds of 4.5 instead of 0.9."""

Floats = NDArray[np.float64]


class Prior:
    """One dead reckoning position, against the places that are searched."""

    def __init__(self, sigma_m: float, squares_m2: NDArray[np.float32]) -> None:
        """sigma_m: of the position. squares_m2: of its distances from the places (N,) that are searched."""
        self._along_m, cross_m = math.hypot(sigma_m, ALONG_M), math.hypot(sigma_m, CROSS_TRACK_M)
        self._mean, self.road = 1.0, 1.0
        """How much more likely the position is on the map's roads than beside them."""
        self.excludes_elsewhere = sigma_m <= ALONG_M
        """Whether it tells a place from those beyond its surroundings ([acceptance] window_m), which may look alike."""
        if squares_m2.size:
            some = squares_m2[:: max(1, len(squares_m2) // MEAN_OF)]
            self._mean = float(likelihood(some, self._along_m).mean())
            widest = max(1.0, 2 * OFF_ROAD_M / (math.sqrt(2 * math.pi) * cross_m))
            self.road = widest * float(likelihood(squares_m2.min(keepdims=True), cross_m)[0])

    def near(self, away_m: Floats) -> Floats:
        """Likelihood of the position for places (n,) so far from it, over the mean of all; 1 where unknown."""
        return np.where(np.isnan(away_m), 1.0, likelihood(np.square(away_m), self._along_m) / max(self._mean, 1e-9))

    def odds(self, away_m: Floats) -> Floats:
        """Factor of the odds of places (n,) so far from the position."""
        return np.asarray(np.maximum(self.road * np.minimum(1.0, self.near(away_m)), LEAST))


def likelihood(squares_m2: NDArray[np.floating], sigma_m: float) -> Floats:
    """Of a position whose distances have such squares (n,), 1 at 0."""
    exponents = squares_m2 * (-0.5 / sigma_m**2)
    return np.asarray((1 - STRAY_SHARE) * np.exp(exponents) + STRAY_SHARE * np.exp(exponents / STRAY**2) + 1e-12)
