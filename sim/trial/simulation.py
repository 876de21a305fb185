"""The vehicle of a course with its autopilot and its camera, in simulated time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from edge.camera import CameraHealth, Frame
from edge.telemetry.link import Link
from sim.trial.cameras import PlacedNetwork, TrialCamera, View
from sim.trial.draft import Draft
from sim.trial.receiver_errors import WANDERS_AT_S, receiver_errors
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.driver import Driver
from sim.vehicle.gps import NO_FIX, GpsReport

STEP_S, FRAME_S = 0.02, 0.1
UP_S = 3.0  # before the vehicle sets off


class Silent:
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


class Simulation:
    """The vehicle, its autopilot and its cameras, moved on by whoever waits for a frame: the daemon's `Frames`."""

    def __init__(self, draft: Draft, link: Link, seed: int) -> None:
        self.now_ns = 1_000_000_000_000
        self._draft = draft
        self._front = TrialCamera(lambda: self.now_ns, np.random.default_rng([seed, 9]))
        self.rear = TrialCamera(lambda: self.now_ns, np.random.default_rng([seed, 12]))
        """The camera that maps, where the course has one."""
        self._gps_errors = receiver_errors(3600, 1.0, WANDERS_AT_S, np.random.default_rng([seed, 14]))
        self._epoch_s = self.now_ns / 1e9 + UP_S
        self.driver = Driver(draft.way, draft.legs, np.random.default_rng([seed, 10]))
        self.autopilot = SimulatedAutopilot(
            link,
            lambda now_s: self.driver.pose,
            lambda: self.now_ns,
            firmware=draft.firmware,
            gps=draft.has_gps,
            has_origin=draft.has_gps,
            errors=draft.errors,
            gps_at=lambda now_s: self._gps(now_s - self._epoch_s),
            lon_shift_deg=draft.lon_shift_deg,
            booted_before_s=draft.booted_before_s,
        )
        if draft.steers:
            self.driver.belief = self.autopilot.estimate
        self.autopilot.loses = self._loses
        self.autopilot.has_script = draft.doubted_gps == "send"
        self._frame_due_s = self._epoch_s - UP_S
        self.rows: list[tuple[float, ...]] = []

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
        driver, draft = self.driver, self._draft
        estimate = self.autopilot.estimate
        self.rows.append(
            (
                self.time_s(),
                driver.along_m,
                driver.left_m,
                driver.pose.east_m,
                driver.pose.north_m,
                estimate.error_m,
                self._gps(self.time_s()).usable and draft.has_gps,
            )
        )
        # One whose odometer is wrong may go past the end of its way, where it sees what is to be seen there.
        way, last_m = draft.way, len(draft.way.route_m) - 1
        row = min(int(driver.along_m), last_m)
        route_m = np.interp(min(driver.along_m, last_m), [row, row + 1], way.route_m[[row, min(row + 1, last_m)]])
        turned_deg = way.turn_deg[row] + math.degrees(driver.heading_rad - way.heading_rad[row])
        view = View(way.roads[way.road[row]], float(route_m), driver.left_m, turned_deg)
        self._front.expose(view)
        if draft.maps_live:
            self.rear.expose(view._replace(scenario=msgspec.structs.replace(view.scenario, view="rear")))

    def _gps(self, time_s: float) -> GpsReport:
        """The receiver's report, as wrong as the accuracy that it states."""
        report = self._draft.gps_at(time_s) if self.driver.along_m < self._draft.gps_until_m else NO_FIX
        row = int(np.clip(time_s + UP_S, 0, len(self._gps_errors) - 1))
        off_m = report.accuracy_m / math.sqrt(2) * self._gps_errors[row]
        east_off_m, north_off_m = report.east_off_m + float(off_m[0]), report.north_off_m + float(off_m[1])
        return replace(report, east_off_m=east_off_m, north_off_m=north_off_m)

    def _loses(self, message: Any, outgoing: bool) -> bool:
        silence = self._draft.silence_s
        if silence and outgoing and silence[0] <= self.time_s() < silence[1]:
            return bool(message.get_type() != "HEARTBEAT")
        return self._draft.loses(self.time_s(), message, outgoing)

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
