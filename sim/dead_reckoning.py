"""Where the simulated autopilot thinks it is: the truth with GPS, odometry that drifts without."""

from __future__ import annotations

import math
from bisect import bisect_right

from sim import Pose

KEPT_S = 6.0  # ArduPilot's EKF looks back five seconds for a delayed fix


class DeadReckoning:
    """An estimate in metres east and north that odometry moves on and a position fix resets."""

    def __init__(self, pose: Pose, time_s: float, drift_percent: float) -> None:
        """`drift_percent` of the distance driven is what odometry reports too much."""
        self._scale = 1.0 + drift_percent / 100.0
        self._pose = pose
        self._past: list[tuple[float, float, float]] = [(time_s, pose.east_m, pose.north_m)]

    @property
    def east_m(self) -> float:
        """Estimated metres east of the origin."""
        return self._past[-1][1]

    @property
    def north_m(self) -> float:
        """Estimated metres north of the origin."""
        return self._past[-1][2]

    @property
    def error_m(self) -> float:
        """Distance from the truth of the last update."""
        return math.hypot(self.east_m - self._pose.east_m, self.north_m - self._pose.north_m)

    def update(self, pose: Pose, time_s: float, *, gps: bool) -> None:
        """Move on to the true `pose` at `time_s`, which must not go back."""
        if gps:
            east_m, north_m = pose.east_m, pose.north_m
        else:
            east_m = self.east_m + self._scale * (pose.east_m - self._pose.east_m)
            north_m = self.north_m + self._scale * (pose.north_m - self._pose.north_m)
        self._pose = pose
        self._past.append((time_s, east_m, north_m))
        if self._past[0][0] < time_s - 2 * KEPT_S:
            self._past = [entry for entry in self._past if entry[0] >= time_s - KEPT_S]

    def reset(self, east_m: float, north_m: float, time_s: float) -> None:
        """A hard reset: the vehicle was there at `time_s`, so all since then moves over by the difference."""
        then_east_m, then_north_m = self._at(time_s)
        shift_east_m, shift_north_m = east_m - then_east_m, north_m - then_north_m
        self._past = [(t, e + shift_east_m, n + shift_north_m) for t, e, n in self._past]

    def _at(self, time_s: float) -> tuple[float, float]:
        index = bisect_right(self._past, (time_s, math.inf, math.inf))
        if index == 0 or index == len(self._past):
            return self._past[min(index, len(self._past) - 1)][1:]
        (t0, e0, n0), (t1, e1, n1) = self._past[index - 1 : index + 1]
        share = (time_s - t0) / (t1 - t0)
        return e0 + share * (e1 - e0), n0 + share * (n1 - n0)
