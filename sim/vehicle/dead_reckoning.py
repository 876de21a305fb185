"""The simulated autopilot's position estimate: the truth with GPS, drifting odometry without."""

from __future__ import annotations

import math
from bisect import bisect_right

from sim import Pose

KEPT_S = 16.0  # PX4 applies fixes that are up to 15 s old
GPS_SIGMA_M = 1.0
GATE_SIGMAS = 3.0
STARVED_S = 5.0  # EKF2_NOAID_TOUT: after this long without aiding, a rejected source resets the estimate


class DeadReckoning:
    """An estimate in meters east and north, moved by odometry and corrected by position fixes."""

    def __init__(self, pose: Pose, time_s: float, drift_percent: float, drift_sideways_percent: float = 0.0) -> None:
        """Errors of odometry in percent of the distance driven: along the direction of travel, and to the right."""
        self._ahead = 1.0 + drift_percent / 100.0
        self._right = drift_sideways_percent / 100.0
        self._pose = pose
        self._past: list[tuple[float, float, float]] = [(time_s, pose.east_m, pose.north_m)]
        self._gps = False
        self._sigma_m = GPS_SIGMA_M
        self._fused_s = -math.inf

    @property
    def east_m(self) -> float:
        """Estimated meters east of the origin."""
        return self._past[-1][1]

    @property
    def north_m(self) -> float:
        """Estimated meters north of the origin."""
        return self._past[-1][2]

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the estimate; grows with the distance since the last correction."""
        return self._sigma_m

    @property
    def error_m(self) -> float:
        """Distance from the truth of the last update."""
        return math.hypot(self.east_m - self._pose.east_m, self.north_m - self._pose.north_m)

    def drifted(self, east: float, north: float) -> tuple[float, float]:
        """A displacement or a velocity as odometry reports it."""
        if self._gps:
            return east, north
        return self._ahead * east + self._right * north, self._ahead * north - self._right * east

    def update(self, pose: Pose, time_s: float, *, gps: bool) -> None:
        """Move on to the true `pose` at `time_s`, which must not go back."""
        self._gps = gps
        if gps:
            east_m, north_m = pose.east_m, pose.north_m
            self._sigma_m = GPS_SIGMA_M
        else:
            moved_east_m, moved_north_m = self.drifted(
                pose.east_m - self._pose.east_m, pose.north_m - self._pose.north_m
            )
            east_m, north_m = self.east_m + moved_east_m, self.north_m + moved_north_m
            self._sigma_m += 0.05 * math.hypot(moved_east_m, moved_north_m)
        self._pose = pose
        self._past.append((time_s, east_m, north_m))
        if self._past[0][0] < time_s - 2 * KEPT_S:
            self._past = [entry for entry in self._past if entry[0] >= time_s - KEPT_S]

    def reset(self, east_m: float, north_m: float, time_s: float, sigma_m: float = GPS_SIGMA_M) -> None:
        """A hard reset: the vehicle was there at `time_s`; the estimates since then are shifted by the difference."""
        then_east_m, then_north_m = self._at(time_s)
        self._shift(east_m - then_east_m, north_m - then_north_m)
        self._sigma_m = sigma_m

    def fuse(self, east_m: float, north_m: float, time_s: float, sigma_m: float) -> bool:
        """A gated correction by a current measurement; False if the gate rejected it. See STARVED_S."""
        off_east_m, off_north_m = east_m - self.east_m, north_m - self.north_m
        variance = self._sigma_m**2 + sigma_m**2
        if math.hypot(off_east_m, off_north_m) > GATE_SIGMAS * math.sqrt(variance):
            if self._gps or time_s - self._fused_s < STARVED_S:
                return False
            self.reset(east_m, north_m, time_s, sigma_m)
        else:
            gain = self._sigma_m**2 / variance
            self._shift(gain * off_east_m, gain * off_north_m)
            self._sigma_m *= math.sqrt(1 - gain)
        self._fused_s = time_s
        return True

    def _shift(self, east_m: float, north_m: float) -> None:
        self._past = [(t, e + east_m, n + north_m) for t, e, n in self._past]

    def _at(self, time_s: float) -> tuple[float, float]:
        index = bisect_right(self._past, (time_s, math.inf, math.inf))
        if index == 0 or index == len(self._past):
            return self._past[min(index, len(self._past) - 1)][1:]
        (t0, e0, n0), (t1, e1, n1) = self._past[index - 1 : index + 1]
        share = (time_s - t0) / (t1 - t0)
        return e0 + share * (e1 - e0), n0 + share * (n1 - n0)
