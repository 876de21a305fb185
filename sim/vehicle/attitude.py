"""The simulated autopilot's own attitude: the true one, wrong as gyroscopes and accelerometers make it."""

from __future__ import annotations

import math

import numpy as np

from sim import Pose

GYRO_DPS, BIAS_DPS, LEVEL_DEG = 0.1, 0.05, 0.4
"""Standard deviations of each rate, of what stays of it after the filter has estimated it, and of roll and pitch."""


class AttitudeEstimate:
    """Roll to the right, pitch up and their rates, in degrees; the heading is the estimator's."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 1])
        self._level_deg = self._rng.normal(0.0, LEVEL_DEG, 2)
        self._bias_dps = self._rng.normal(0.0, BIAS_DPS, 3)
        self._before: tuple[float, tuple[float, float, float]] | None = None
        self.tilt_deg = (0.0, 0.0)
        """Roll and pitch."""
        self.rates_dps = (0.0, 0.0, 0.0)
        """Of roll, pitch and heading."""

    def update(self, pose: Pose, time_s: float) -> None:
        """The truth at a time."""
        truth_deg = pose.roll_deg, pose.pitch_deg, pose.heading_deg
        self.tilt_deg = truth_deg[0] + float(self._level_deg[0]), truth_deg[1] + float(self._level_deg[1])
        before, self._before = self._before, (time_s, truth_deg)
        if before is None or time_s <= before[0]:
            return
        noise_dps = self._bias_dps + self._rng.normal(0.0, GYRO_DPS, 3)
        turned_deg = [math.remainder(now - then, 360.0) for now, then in zip(truth_deg, before[1], strict=True)]
        roll, pitch, yaw = (turned_deg[axis] / (time_s - before[0]) + float(noise_dps[axis]) for axis in range(3))
        self.rates_dps = roll, pitch, yaw
