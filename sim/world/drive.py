"""One drive along a route: where the vehicle is at any time, out or back, in its own lane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim import Pose
from sim.world.route import WorldRoute

Direction = Literal["forward", "reverse"]

STEP_S = 0.05
ACCELERATION_MPS2 = 1.5
SWAY_M = 0.25
"""Amplitude of the deviation from the middle of the lane."""
SQUAT_DEG = 0.6
"""By which a car's nose rises for each m/s^2 that it accelerates, and dives when it brakes."""
BUMPS_DEG = 0.3
"""Amplitude of pitch and roll on an uneven road."""


@dataclass(frozen=True)
class WorldDrive:
    """A vehicle's motion from rest at one end of the route to rest at the other; build it with `plan_drive`.

    `direction` "reverse" is the way home: from the end of the route to its start. lane_m is the distance of the
    vehicle's path to the left of the road's middle as the driver sees it (left-hand traffic), so that going home
    takes the other side of the road. shaking: how much it pitches and rolls, 1 as a car, 0 not at all.

    times_s and distances_m (N,) sample the motion each STEP_S.
    """

    route: WorldRoute
    direction: Direction
    lane_m: float
    seed: int
    times_s: NDArray[np.float64]
    distances_m: NDArray[np.float64]
    shaking: float = 0.0

    @property
    def duration_s(self) -> float:
        """Time from start to arrival."""
        return float(self.times_s[-1])

    def distance_m(self, time_s: float) -> float:
        """Distance driven along the route at `time_s`; constant before the start and after the end."""
        return float(np.interp(time_s, self.times_s, self.distances_m))

    def time_at_s(self, distance_m: float) -> float:
        """The first time at which the vehicle has covered `distance_m`."""
        row = int(np.searchsorted(self.distances_m, distance_m))
        if row == 0 or row == len(self.times_s):
            return float(self.times_s[min(row, len(self.times_s) - 1)])
        before, after = self.distances_m[row - 1 : row + 1]
        return float(self.times_s[row - 1] + STEP_S * (distance_m - before) / (after - before))

    def route_m(self, time_s: float) -> float:
        """Arc length along the route, comparable between drives in either direction."""
        covered_m = self.distance_m(time_s)
        return covered_m if self.direction == "forward" else self.route.length_m - covered_m

    def pose(self, time_s: float, ahead_m: float = 0.0) -> Pose:
        """Where the vehicle is and looks; standing before 0 and after `duration_s`.

        ahead_m: of a part of the vehicle this far ahead along its way, which turns with the road there.
        """
        sign = 1.0 if self.direction == "forward" else -1.0
        route_m = min(max(self.route_m(time_s) + sign * ahead_m, 0.0), self.route.length_m)
        left_m, slope = self._sway(route_m)
        east, north, heading = self.route.at(route_m, sign * self.lane_m + left_m)
        # The sway is to the left of the road; its slope turns the vehicle against the clock.
        heading += -np.arctan(slope) + (0.0 if sign > 0 else np.pi)
        speed_mps = (self.distance_m(time_s + STEP_S) - self.distance_m(time_s - STEP_S)) / (2 * STEP_S)
        tilt_deg = self._tilt_deg(time_s) if self.shaking else (0.0, 0.0)
        return Pose(east, north, float(np.degrees(heading)) % 360.0, speed_mps, self.distance_m(time_s), *tilt_deg)

    def _tilt_deg(self, time_s: float) -> tuple[float, float]:
        """Pitch by the acceleration of the last half second, and bumps of 11 and 4 m, which also make it roll."""
        ahead_m = [self.distance_m(time_s + lag_s) for lag_s in (-0.5, -0.25, 0.0)]
        pitch_deg = SQUAT_DEG * (ahead_m[2] - 2 * ahead_m[1] + ahead_m[0]) / 0.25**2
        bumps = [np.sin(2 * np.pi * ahead_m[2] / wave_m + self.seed + wave_m) for wave_m in (11.0, 4.0, 13.0, 5.0)]
        roll_deg = BUMPS_DEG * (bumps[2] + bumps[3])
        return self.shaking * float(pitch_deg + BUMPS_DEG * (bumps[0] + bumps[1])), self.shaking * float(roll_deg)

    def _sway(self, route_m: float) -> tuple[float, float]:
        """Distance from the lane's middle and its slope along the route: two sines of 60 and 23 m."""
        left_m = slope = 0.0
        for wavelength_m, share in ((60.0, 0.7), (23.0, 0.3)):
            angle = 2 * np.pi * route_m / wavelength_m + self.seed * 2.4
            left_m += SWAY_M * share * np.sin(angle)
            slope += SWAY_M * share * np.cos(angle) * 2 * np.pi / wavelength_m
        return float(left_m), float(slope)


def plan_drive(
    route: WorldRoute,
    direction: Direction = "forward",
    *,
    seed: int,
    lane_m: float = 1.75,
    speed_mps: float = 10.0,
    stops: int = 0,
    shaking: float = 0.0,
) -> WorldDrive:
    """Plan the motion: the wanted speed changes every few seconds between 0.6 and 1.3 of `speed_mps`.

    `stops` are halts of 3 to 8 s at seeded places; the vehicle brakes and pulls away at ACCELERATION_MPS2.
    """
    rng = np.random.default_rng([seed, 2])
    halts_m = [*np.sort(rng.uniform(0.1, 0.9, stops)) * route.length_m, route.length_m]
    waits_s = [*rng.uniform(3, 8, stops), 0.0]
    distances = [0.0]
    speed, wanted, change_s = 0.0, speed_mps, 4.0
    for halt_m, wait_s in zip(halts_m, waits_s, strict=True):
        while halt_m - distances[-1] > 0.02:
            if len(distances) * STEP_S > change_s:
                wanted, change_s = speed_mps * rng.uniform(0.6, 1.3), change_s + rng.uniform(4, 10)
            braking = np.sqrt(2 * ACCELERATION_MPS2 * (halt_m - distances[-1]))
            faster = min(wanted, speed + ACCELERATION_MPS2 * STEP_S)
            # Never slower than a crawl, or the halt would only be reached in the limit.
            speed = max(0.2, min(max(faster, speed - ACCELERATION_MPS2 * STEP_S), braking))
            distances.append(min(halt_m, distances[-1] + speed * STEP_S))
        speed = 0.0
        distances += [float(halt_m)] * max(1, round(wait_s / STEP_S))
    times = np.arange(len(distances), dtype=np.float64) * STEP_S
    return WorldDrive(route, direction, lane_m, seed, times, np.array(distances, np.float64), shaking)
