"""The vehicle of a course with its autopilot and its camera, in simulated time."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.camera import CameraHealth, Frame
from edge.descriptor.network import Network
from edge.telemetry.link import Link
from sim.trial.draft import Draft
from sim.trial.views import RoadLibrary
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.driver import Driver
from sim.world.scenario import Scenario

STEP_S, FRAME_S = 0.02, 0.1
LATENCY_S = (0.03, 0.25)
HOLE_RATE, LONGEST_HOLE_S = 0.01, 1.5
"""Share of the frames at which a hole begins, as on a computer that is busy with something else."""
UP_S = 3.0  # before the vehicle sets off


class PlacedNetwork(Network):
    """The network of a drive: it has described what the vehicle sees where it is."""

    current: NDArray[np.float32]

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The descriptors of the frame that was delivered last."""
        return self.current


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
    """The vehicle, its autopilot and its camera, moved on by whoever waits for a frame: the daemon's `Frames`."""

    def __init__(self, draft: Draft, link: Link, library: RoadLibrary, seed: int) -> None:
        self.now_ns = 1_000_000_000_000
        self._draft, self._library = draft, library
        self._rng = np.random.default_rng([seed, 9])
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
            gps_at=lambda now_s: draft.gps_at(now_s - self._epoch_s),
            lon_shift_deg=draft.lon_shift_deg,
            booted_before_s=draft.booted_before_s,
        )
        if draft.steers:
            self.driver.belief = self.autopilot.estimate
        self.autopilot.loses = self._loses
        self.network: PlacedNetwork | None = None
        self._delivered = 0
        self._frame_due_s = self._epoch_s - UP_S
        self._hole_until_s = 0.0
        self._waiting: deque[tuple[float, int, tuple[Scenario, float, float, float]]] = deque()
        self.rows: list[tuple[float, ...]] = []

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
        driver, draft, now_s = self.driver, self._draft, self.now_ns / 1e9
        estimate = self.autopilot.estimate
        self.rows.append(
            (
                self.time_s(),
                driver.along_m,
                driver.left_m,
                driver.pose.east_m,
                driver.pose.north_m,
                estimate.error_m,
                draft.gps_at(self.time_s()).usable and draft.has_gps,
            )
        )
        if self._rng.random() < HOLE_RATE:
            self._hole_until_s = now_s + self._rng.uniform(0.0, LONGEST_HOLE_S)
        latency_s = self._rng.uniform(*LATENCY_S)
        if now_s >= self._hole_until_s:
            way, row = draft.way, int(driver.along_m)
            route_m = way.route_m[row] + (driver.along_m - row) * (
                way.route_m[min(row + 1, len(way.route_m) - 1)] - way.route_m[row]
            )
            turned_deg = way.turn_deg[row] + math.degrees(driver.heading_rad - way.heading_rad[row])
            view = way.roads[way.road[row]], float(route_m), driver.left_m, turned_deg
            self._waiting.append((now_s + latency_s, self.now_ns, view))

    def _loses(self, message: Any, outgoing: bool) -> bool:
        silence = self._draft.silence_s
        if silence and outgoing and silence[0] <= self.time_s() < silence[1]:
            return bool(message.get_type() != "HEARTBEAT")
        return self._draft.loses(self.time_s(), message, outgoing)

    @property
    def health(self) -> CameraHealth:
        """See NewestFrame."""
        return CameraHealth("running", "", 0, delivered=self._delivered)

    @property
    def ended(self) -> bool:
        """See NewestFrame."""
        return self.driver.ended

    def take(self, timeout_s: float) -> Frame | None:
        """Let `timeout_s` pass; the newest frame that has arrived meanwhile."""
        for _ in range(max(1, round(timeout_s / STEP_S))):
            self.step()
        arrived = None
        while self._waiting and self._waiting[0][0] <= self.now_ns / 1e9:
            arrived = self._waiting.popleft()
        if arrived is None or self.network is None:
            return None
        self._delivered += 1
        scenario, route_m, left_m, turn_deg = arrived[2]
        self.network.current = self._library[scenario].raw(route_m, left_m, turn_deg)
        # Only so that it is neither blank nor frozen.
        picture = np.random.default_rng(self._delivered).integers(0, 255, (32, 32, 3), np.uint8)
        return Frame(picture, arrived[1], self._delivered)

    def close(self) -> None:
        """See NewestFrame."""
