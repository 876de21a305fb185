"""The simulated autopilot's own attitude: the true one, wrong as its gyroscopes, accelerometers and compass make it."""

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
        """Of the body about its axes ahead, right and down."""

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
        tilt_rad, climb_rad = math.radians(pose.roll_deg), math.radians(pose.pitch_deg)
        yaw_right, yaw_down = math.sin(tilt_rad) * math.cos(climb_rad), math.cos(tilt_rad) * math.cos(climb_rad)
        self.rates_dps = (
            roll - yaw * math.sin(climb_rad),
            pitch * math.cos(tilt_rad) + yaw * yaw_right,
            yaw * yaw_down - pitch * math.sin(tilt_rad),
        )


class HeadingWander:
    """An error of the heading that changes while driving: a Gauss-Markov process of second order over the distance.

    Of standard deviation `sigma_rad`; after `d` meters its autocorrelation is (1 + d / l) exp(-d / l), with `l` of
    `within_m`, so that it is smooth, as recorded ones are.
    """

    def __init__(self, sigma_rad: float, within_m: float, rng: np.random.Generator) -> None:
        self._within_m, self._rng, self._aim_sigma_rad = within_m, rng, math.sqrt(2) * sigma_rad
        self.error_rad = sigma_rad * rng.standard_normal()
        """The error of the heading now, clockwise."""
        self._aim_rad = self.error_rad + sigma_rad * rng.standard_normal()

    def move(self, driven_m: float) -> float:
        """Radians by which the error has changed after so many more meters."""
        kept = math.exp(-driven_m / self._within_m)
        self._aim_rad = kept * self._aim_rad + math.sqrt(1 - kept**2) * self._aim_sigma_rad * self._rng.normal()
        change_rad = (1 - kept) * (self._aim_rad - self.error_rad)
        self.error_rad += change_rad
        return change_rad
