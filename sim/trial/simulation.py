"""The vehicle with its autopilot and its cameras, in simulated time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.camera import CameraHealth, Frame
from edge.telemetry.link import Link
from sim import Pose
from sim.trial.draft import Draft
from sim.trial.views import PlacedNetwork, TrialCamera, View
from sim.trial.way import Driver
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.gps import NO_FIX, GpsReport

STAYS = 0.625
"""Of one standard deviation; the rest of the variance is a first-order Gauss-Markov process."""
WANDERS_AT_M, WANDERS_AT_S = 200.0, 30.0
"""Correlation length of that process, of a drive that is mapped and of one in time."""


def receiver_errors(count: int, step: float, length: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Errors east and north (count, 2) of positions `step` apart, each with a standard deviation of 1.

    length: correlation length of what wanders, in the unit of `step`.
    """
    sigma = math.sqrt(1 - STAYS**2)
    kept = math.exp(-step / length)
    stays, error = rng.normal(0.0, STAYS, 2), rng.normal(0.0, sigma, 2)
    moves = rng.normal(0.0, sigma * math.sqrt(1 - kept**2), (count, 2))
    errors = np.empty((count, 2))
    for row in range(count):
        errors[row] = stays + error
        error = kept * error + moves[row]
    return errors


STEP_S, FRAME_S = 0.02, 0.1
UP_S = 3.0  # before the vehicle sets off


class NullLink:
    """A link that nobody listens to."""

    def receive(self) -> bytes:
        """Nothing."""
        return b""

    def send(self, data: bytes) -> bool:
        """Lost."""
        return True

    def fileno(self) -> int:
        """There is none."""
        raise OSError

    def close(self) -> None:
        """Nothing to close."""


STEERS = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_AUTO_ENABLED
"""Mode of an autopilot that drives its vehicle."""


class Simulation:
    """The vehicle, its autopilot and its cameras, moved on by whoever waits for a frame: the daemon's `Frames`."""

    def __init__(
        self, draft: Draft, link: Link, seed: int, driven: Callable[[float], object] = lambda meters: None
    ) -> None:
        """driven: called with each few meters that the vehicle drove, for a progress bar."""
        self.now_ns = 1_000_000_000_000
        self._draft, self._link, self._driven = draft, link, driven
        shown_m = float if draft.keypoints else None  # a picture shows the road where its camera is
        self._front = TrialCamera(lambda: self.now_ns, np.random.default_rng([seed, 9]), shown_m=shown_m)
        self.rear = TrialCamera(lambda: self.now_ns, np.random.default_rng([seed, 12]), shown_m=shown_m)
        """The camera that maps."""
        errors = receiver_errors(3600, 1.0, WANDERS_AT_S, np.random.default_rng([seed, 14]))
        self._gps_errors: list[tuple[float, float]] = errors.tolist()  # read in each step, one by one
        self._epoch_s = self.now_ns / 1e9 + UP_S
        self._frame_due_s = self._epoch_s - UP_S
        self.driver = Driver(draft.way, draft.legs, np.random.default_rng([seed, 10]))
        self.autopilot = self._autopilot(link, lambda: self.driver.pose)
        self.driver.belief, self.autopilot.base_mode = self.autopilot.estimate, STEERS
        self.rows: list[tuple[float, ...]] = []

    def _autopilot(self, link: Link, pose: Callable[[], Pose], **others: Any) -> SimulatedAutopilot:
        """others: keywords of SimulatedAutopilot, of a course."""
        return SimulatedAutopilot(
            link,
            lambda now_s: pose(),
            lambda: self.now_ns,
            errors=self._draft.errors,
            gps_at=lambda now_s: self.gps(now_s - self._epoch_s),
            **others,
        )

    def show(self, network: PlacedNetwork) -> None:
        """Deliver frames from now on, which this network describes."""
        self._front.network = self.rear.network = network

    def time_s(self, now_s: float | None = None) -> float:
        """Seconds since the vehicle set off."""
        return (self.now_ns / 1e9 if now_s is None else now_s) - self._epoch_s

    def step(self) -> None:
        """Move everything on by STEP_S."""
        self.now_ns += round(STEP_S * 1e9)
        if self.time_s() > 0:
            self.driver.step(STEP_S)
        self.autopilot.step()
        if self.now_ns / 1e9 >= self._frame_due_s:
            self._frame_due_s += FRAME_S
            self._expose()

    def _expose(self) -> None:
        driver, way = self.driver, self._draft.way
        self._driven(driver.along_m - (self.rows[-1][1] if self.rows else 0.0))
        pose, error_m, has_gps = driver.pose, self.autopilot.estimate.error_m, self.gps(self.time_s()).usable
        at_m = driver.along_m, driver.left_m, pose.east_m, pose.north_m
        self.rows.append((self.time_s(), *at_m, error_m, has_gps, math.degrees(driver.heading_rad)))
        # One whose odometer is wrong may go past the end of its way, where it sees what is to be seen there.
        last_m = len(way.route_m) - 1
        row = min(int(driver.along_m), last_m)
        route_m = np.interp(min(driver.along_m, last_m), [row, row + 1], way.route_m[[row, min(row + 1, last_m)]])
        turned_deg = way.turn_deg[row] + math.degrees(driver.heading_rad - way.heading_rad[row])
        left_m = float(way.lateral_m[row]) + driver.left_m
        self._show(View(way.roads[way.road[row]], float(route_m), left_m, turned_deg))

    def _show(self, view: View) -> None:
        self._front.expose(view)
        self.rear.expose(view.of_rear())

    def gps(self, time_s: float) -> GpsReport:
        """The receiver's report, as wrong as the accuracy that it states."""
        report = self._draft.gps_at(time_s) if self.driver.along_m < self._draft.gps_until_m else NO_FIX
        east, north = self._gps_errors[min(max(int(time_s + UP_S), 0), len(self._gps_errors) - 1)]
        sigma_m = report.accuracy_m / math.sqrt(2)  # in each direction
        east_off_m, north_off_m = report.east_off_m + sigma_m * east, report.north_off_m + sigma_m * north
        return replace(report, east_off_m=east_off_m, north_off_m=north_off_m)

    @property
    def health(self) -> CameraHealth:
        """See NewestFrame."""
        return self._front.health

    @property
    def ended(self) -> bool:
        """See NewestFrame."""
        return self.driver.ended

    def take(self, timeout_s: float) -> Frame | None:
        """Let `timeout_s` pass; the newest frame that has arrived meanwhile."""
        for _ in range(max(1, round(timeout_s / STEP_S))):
            self.step()
        return self._front.take(0.0)

    def close(self) -> None:
        """See NewestFrame."""
