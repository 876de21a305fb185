"""One drive of a course: the daemon beside a simulated autopilot on a pseudo-terminal, both in simulated time.

Whenever the daemon waits for a frame, the clock, the vehicle and the autopilot move on. The daemon is the real one, and
so are the messages; only its pictures come as descriptors (`sim.trial.views`).
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

import edge
from edge.camera import CameraHealth, Frame
from edge.config import (
    CameraConfig,
    Config,
    DescriptorConfig,
    MapConfig,
    PageConfig,
    RigConfig,
    SamplingConfig,
    TelemetryConfig,
)
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.descriptor.normalize import normalize
from edge.recognizer import model_key
from edge.reference_map.builder import NAN, MapBuilder, Place
from edge.reference_map.store import RegionsKey
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE
from edge.telemetry.link import Link
from sim import ORIGIN_ALT_M, Pose, geodetic
from sim.trial.courses import COURSES, Draft, Stretch
from sim.trial.rules import Run, Sent, Track, failures
from sim.trial.views import RoadLibrary
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.daemon_drive import JOURNAL
from sim.vehicle.driver import Driver
from sim.vehicle.position_inputs import east_north_m
from sim.vehicle.pty_link import PtyLink, open_pty
from sim.world.route import Route
from sim.world.scenario import Scenario

STEP_S, FRAME_S = 0.02, 0.1
LATENCY_S = (0.03, 0.25)
HOLE_RATE, LONGEST_HOLE_S = 0.01, 1.5
"""Share of the frames at which a hole begins, as on a computer that is busy with something else."""
ORIGIN_OFF_M = 6.0
UP_S = 3.0  # before the vehicle sets off
RIG = RigConfig(
    ahead_forward_swapped_m=32.0,
    sigma_forward_swapped_m=4.1,
    ahead_reverse_same_m=-1.0,
    left_reverse_m=3.5,
    sigma_reverse_same_m=2.8,
)
"""Of the simulated rig, as `lookback calibrate` measures it."""


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


def drive(name: str, seed: int, length_m: float, world: int, folder: Path, library: RoadLibrary) -> Run:
    """Drive a course once with the daemon and once without; its journal stays in `folder`."""
    network = PlacedNetwork.load()
    assert isinstance(network, PlacedNetwork)
    draft = drafted(name, seed, length_m, world)
    with TemporaryDirectory(dir=folder) as passing:
        map_path = Path(passing) / "map"
        build_course_map(draft, map_path, network, library)
        with closing(open_pty()) as link:
            simulation = Simulation(draft, link, library, seed)
            simulation.network = network
            _run_daemon(simulation, draft, link, map_path, folder, network)
    alone = Simulation(drafted(name, seed, length_m, world), Silent(), library, seed)
    if not draft.has_gps:
        alone.autopilot.estimate.shift(ORIGIN_OFF_M, 0.0)
    while not alone.ended:
        alone.step()
    return _judged(seed, draft, simulation, alone)


def drafted(name: str, seed: int, length_m: float, world: int) -> Draft:
    """The course of a seed."""
    draft = Draft(np.random.default_rng([seed, 7]), length_m, world)
    COURSES[name](draft)
    return draft


def _run_daemon(
    simulation: Simulation, draft: Draft, link: PtyLink, map_path: Path, folder: Path, network: Network
) -> None:
    config = _settings(draft, link, map_path, folder, simulation.driver.pose)
    restarted_s = draft.restarted_s or math.inf
    for until_s in (draft.killed_s, math.inf):
        if until_s is None:
            continue
        with ExitStack() as parts:
            daemon = Daemon(config, parts, lambda: simulation.now_ns, frames=simulation, network=network)
            while daemon.turn() and simulation.time_s() < until_s:
                if simulation.time_s() >= restarted_s:
                    restarted_s = math.inf
                    simulation.autopilot.reboot()
            if simulation.ended:
                daemon.last_words()
        if not simulation.ended:
            link.receive()  # what it said when its parts were closed; a daemon that is killed says nothing


def _settings(draft: Draft, link: PtyLink, map_path: Path, folder: Path, start: Pose) -> Config:
    """The defaults, but for the rig and what the course asks for; nothing is kept from an earlier drive."""
    (folder / JOURNAL).unlink(missing_ok=True)
    lat_deg, lon_deg = geodetic(start.east_m + ORIGIN_OFF_M, start.north_m, draft.lon_shift_deg)
    return Config(
        camera=CameraConfig(kind="sim", view="front"),
        descriptor=DescriptorConfig(keep_statistics_min=0.0),
        map=MapConfig(path=str(map_path)),
        page=PageConfig(port=0),
        rig=RIG,
        telemetry=msgspec.structs.replace(
            TelemetryConfig(),
            connection=f"serial:{link.device}:921600",
            emit=draft.emit,
            journal=str((folder / JOURNAL).resolve()),
            origin=() if draft.has_gps else (lat_deg, lon_deg, ORIGIN_ALT_M),
        ),
    )


def map_scenario(home: Scenario) -> Scenario:
    """The drive that makes the map of a road."""
    return msgspec.structs.replace(home, view="rear", light="day", direction="forward", drive_seed=1)


def build_course_map(draft: Draft, path: Path, network: Network, library: RoadLibrary) -> None:
    """The map of a course, made by day with the camera that looks back, on the way out."""
    out = map_scenario(draft.home)
    config = DescriptorConfig()
    regions = RegionsKey(config.regions, config.region_width, "set")
    rng = np.random.default_rng([draft.world, 11])
    with MapBuilder(path, model_key(network), regions, SamplingConfig()) as builder:
        for number, stretch in enumerate(draft.map):
            builder.begin_segment(f"stretch {number}", "rear")
            for row, route_m in enumerate(_places_m(stretch, rng)):
                raw = library[out].raw(route_m, stretch.left_m)
                builder.add(raw, _place(draft, library[out].drive.route, stretch, row, route_m))
        builder.finish(normalize, edge.__version__)


def _places_m(stretch: Stretch, rng: np.random.Generator) -> list[float]:
    places_m = [stretch.start_m]
    while places_m[-1] < stretch.end_m:
        places_m.append(places_m[-1] + rng.uniform(*stretch.spacing_m))
    return places_m[:-1]


def _place(draft: Draft, route: Route, stretch: Stretch, row: int, route_m: float) -> Place:
    if stretch.on_way:
        # Against the way, on the lane that the rig's offset expects.
        at_m = float(np.argmin(np.abs(draft.way.route_m - route_m)))
        east_m, north_m, heading_rad = draft.way.at(at_m, -RIG.left_reverse_m)
        heading_rad += math.pi
    else:
        east_m, north_m, heading_rad = route.at(route_m, draft.home.lane_m)
    lat_deg, lon_deg = geodetic(east_m + stretch.off_m[0], north_m + stretch.off_m[1], draft.lon_shift_deg)
    heading_deg = math.degrees(heading_rad) % 360 if stretch.headings else NAN
    return Place(row, lat_deg, lon_deg, ORIGIN_ALT_M, heading_deg, route_m)


def _judged(seed: int, draft: Draft, simulation: Simulation, alone: Simulation) -> Run:
    inputs = simulation.autopilot.inputs
    texts = tuple(
        (simulation.time_s(item.time_s), item.message.severity, item.message.text)
        for item in simulation.autopilot.received
        if item.message.get_type() == "STATUSTEXT"
    )
    run = Run(
        seed,
        _track(draft, simulation),
        _track(draft, alone),
        _sent(draft, simulation),
        np.array([item.error_after_m for item in (*inputs.resets, *inputs.fused)]),
        texts,
        inputs.source_set,
    )
    return replace(run, failures=failures(run, draft.rules))


def _track(draft: Draft, simulation: Simulation) -> Track:
    time_s, along_m, left_m, _, _, error_m, gps = np.array(simulation.rows).T
    row = along_m.astype(int).clip(0, len(draft.way.route_m) - 1)
    expected = (
        (gps == 0) & (np.array(draft.way.roads, object)[draft.way.road[row]] == draft.home) & ~draft.way.carried[row]
    )
    route_m = draft.way.route_m[row]
    known = [(stretch.start_m <= route_m) & (route_m < stretch.end_m) for stretch in draft.map if stretch.is_true]
    expected &= np.any(known, axis=0) if known else False
    for start_m, end_m in draft.unsent:
        expected &= ~((along_m >= start_m) & (along_m < end_m))
    return Track(time_s, along_m, left_m, error_m, gps != 0, expected)


def _sent(draft: Draft, simulation: Simulation) -> Sent:
    rows = np.array(simulation.rows)
    found = []
    for item in simulation.autopilot.received:
        position = _position(item.message, simulation)
        if position is not None:
            east_m, north_m, sigma_m, age_s = position
            at_s = simulation.time_s(item.time_s) - age_s
            true_m = [np.interp(at_s, rows[:, 0], rows[:, column]) for column in (3, 4)]
            error_m = math.hypot(east_m - true_m[0], north_m - true_m[1])
            found.append((simulation.time_s(item.time_s), error_m, sigma_m))
    return Sent(*np.array(found).reshape(-1, 3).T)


def _position(message: Any, simulation: Simulation) -> tuple[float, float, float, float] | None:
    """East, north, sigma (m) and age (s) of a position message, None for others."""
    shift_deg, kind = simulation._draft.lon_shift_deg, message.get_msgId()
    if kind == mavlink.MAVLINK_MSG_ID_COMMAND_INT and message.command == EXTERNAL_POSITION_ESTIMATE:
        return *east_north_m(message.x / 1e7, message.y / 1e7, shift_deg), message.param3, message.param2
    if kind == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_SENSOR:
        return *east_north_m(message.lat / 1e7, message.lon / 1e7, shift_deg), message.eph, 0.0
    if kind == mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE:
        origin_m = simulation.autopilot.origin_m or (0.0, 0.0)
        return message.y + origin_m[0], message.x + origin_m[1], math.sqrt(message.covariance[0]), 0.0
    return None
