"""The vehicle of a course with its autopilot and its camera, in simulated time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from edge.camera import CameraHealth, Frame
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE
from edge.telemetry.link import Link
from sim import Pose, geodetic
from sim.trial.cameras import PlacedNetwork, TrialCamera, View
from sim.trial.draft import Draft
from sim.trial.receiver_errors import WANDERS_AT_S, receiver_errors
from sim.vehicle.autopilot import BOOTS_S, SimulatedAutopilot
from sim.vehicle.driver import Driver, Leg
from sim.vehicle.gps import NO_FIX, GpsReport
from sim.vehicle.shared_link import shared

STEP_S, FRAME_S = 0.02, 0.1
UP_S = 3.0  # before the vehicle sets off
COMPANION_OFF_M, COMPANION_SIGMA_M = 3.0, 5.0  # of its positions: wrong in each direction, and as they say
DOUBLE_AHEAD_M, DOUBLE_MPS = 60.0, 5.0


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

    def __init__(
        self, draft: Draft, link: Link, seed: int, driven: Callable[[float], object] = lambda meters: None
    ) -> None:
        """driven: called with each few meters that the vehicle drove, for a progress bar."""
        self.now_ns = 1_000_000_000_000
        self._draft, self._driven = draft, driven
        late = round(draft.late_s / FRAME_S)
        shown_m = None if draft.motion == "off" else draft.shown_m
        self._front = TrialCamera(lambda: self.now_ns, np.random.default_rng([seed, 9]), late, shown_m=shown_m)
        self.rear = TrialCamera(lambda: self.now_ns, np.random.default_rng([seed, 12]))
        """The camera that maps, where the course has one."""
        self._gps_errors = receiver_errors(3600, 1.0, WANDERS_AT_S, np.random.default_rng([seed, 14]))
        self._epoch_s = self.now_ns / 1e9 + UP_S
        self.driver = Driver(draft.way, draft.legs, np.random.default_rng([seed, 10]))
        links = shared(link, 2) if draft.has_double else [link]
        self.autopilot = self._autopilot(links[0], lambda: self.driver.pose)
        if draft.steers:
            self.driver.belief = self.autopilot.estimate
        self.autopilot.loses = self._loses
        self.autopilot.has_script = draft.doubted_gps == "send"
        self.autopilot.timesync_off_s = draft.clock_off_s
        self._frame_due_s, self._companion_due_s = self._epoch_s - UP_S, self._epoch_s + draft.companion_s
        self._restarts_s = draft.restarted_s or math.inf
        self.rows: list[tuple[float, ...]] = []
        self.is_heard = True
        """Whether the daemon runs."""
        self._companion_rng = np.random.default_rng([seed, 15])
        self._double: tuple[Driver, SimulatedAutopilot] | None = None
        if draft.has_double:
            legs, rng = [Leg(draft.way.length_m - 2, DOUBLE_MPS)], np.random.default_rng([seed, 16])
            ahead = Driver(draft.way, legs, rng, starts_m=DOUBLE_AHEAD_M)
            self._double = ahead, self._autopilot(links[1], lambda: ahead.pose)

    def _autopilot(self, link: Link, pose: Callable[[], Pose]) -> SimulatedAutopilot:
        draft = self._draft
        return SimulatedAutopilot(
            link,
            lambda now_s: pose(),
            lambda: self.now_ns,
            firmware=draft.firmware,
            gps=draft.has_gps,
            has_origin=draft.has_gps,
            errors=draft.errors,
            gps_at=lambda now_s: self._gps(now_s - self._epoch_s),
            lon_shift_deg=draft.lon_shift_deg,
            booted_before_s=draft.booted_before_s,
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
        if self.time_s() >= self._restarts_s:
            self._restarts_s = math.inf
            self.autopilot.reboot(BOOTS_S)
        if self.now_ns / 1e9 >= self._companion_due_s:
            self._companion_due_s += self._draft.companion_s
            self._hear_companion()
        if self._double is not None:
            self._double[0].step(STEP_S)
            self._double[1].step()

    def _hear_companion(self) -> None:
        """Another computer on the vehicle resets the autopilot's position."""
        pose, off_m = self.driver.pose, self._companion_rng.normal(0.0, COMPANION_OFF_M, 2)
        lat_deg, lon_deg = geodetic(pose.east_m + off_m[0], pose.north_m + off_m[1], self._draft.lon_shift_deg)
        values = self.autopilot.boot_s, 0.0, COMPANION_SIGMA_M, math.nan
        place = round(lat_deg * 1e7), round(lon_deg * 1e7), math.nan
        command = EXTERNAL_POSITION_ESTIMATE
        self.autopilot.handle(
            mavlink.MAVLink_command_int_message(1, 1, mavlink.MAV_FRAME_GLOBAL, command, 0, 0, *values, *place)
        )

    def _expose(self) -> None:
        driver, draft = self.driver, self._draft
        estimate = self.autopilot.estimate
        self._driven(driver.along_m - (self.rows[-1][1] if self.rows else 0.0))
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
        left_m = float(way.aside_m[row]) + driver.left_m
        view = View(way.roads[way.road[row]], draft.seen_m(float(route_m)), left_m, turned_deg)
        frozen_s = draft.frozen_s
        self._front.expose(view, frozen=frozen_s[0] <= self.time_s() < frozen_s[1])
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
        if not self.is_heard:
            return True
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
