"""What a drive was worth, by the truth that only the simulator knows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.vehicle.protection import availability

Array = NDArray[np.float64]
MOST_SIGMAS, ARRIVED_M, LANE_M = 4.0, 10.0, 5.0


@dataclass(frozen=True)
class TruthTrack:
    """Truth and belief of a drive, ten times a second: arrays (N,).

    along_m, cross_track_m: true place on the way. error_m: of the autopilot's own position. gps: whether its filter
    fuses GPS. end_off_m: from where the vehicle stops to where it should.
    """

    time_s: Array
    along_m: Array
    cross_track_m: Array
    error_m: Array
    gps: NDArray[np.bool_]
    end_off_m: float = 0.0


@dataclass(frozen=True)
class FixErrors:
    """Positions as they arrived: when, and of each its error and its sigma.

    sigma_m: what is known of the position, or what its message says if that is less. off_m: (N, 2), how far off along
    the way and across it. of_s: (N,) the moments.
    """

    time_s: Array
    error_m: Array
    sigma_m: Array
    off_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    of_s: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def sigmas(self) -> Array:
        """Errors over sigmas."""
        return self.error_m / self.sigma_m


@dataclass(frozen=True)
class TrialRun:
    """One drive, and what it would have been without Lookback; levels: protection levels, see `protection_levels`."""

    seed: int
    world: int
    track: TruthTrack
    alone: TruthTrack
    sent: FixErrors
    levels: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def available(self) -> float:
        """Share of the time without GPS in which a position had protection levels below 15 m."""
        return availability(self.levels, self.track.time_s[~self.track.gps])

    @property
    def first_after_m(self) -> float:
        """Meters from the loss of GPS to the first position; NaN without either."""
        sent_s = self.sent.time_s[self.sent.time_s >= lost_s(self)]
        along_m = np.interp([lost_s(self), *sent_s[:1]], self.track.time_s, self.track.along_m)
        return float(along_m[1] - along_m[0]) if len(along_m) > 1 else math.nan


def lane_off_m(track: TruthTrack) -> float:
    """95 % of the cross-track error without GPS, m."""
    return float(np.percentile(np.abs(track.cross_track_m[~track.gps]), 95)) if not track.gps.all() else 0.0


def lost_s(run: TrialRun) -> float:
    """When GPS was fused last; 0 where it never was."""
    with_gps = np.flatnonzero(run.track.gps)
    return float(run.track.time_s[with_gps[-1]]) if len(with_gps) else 0.0
