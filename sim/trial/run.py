"""One drive: the daemon beside a simulated autopilot on a pseudo-terminal, both in simulated time.

Whenever the daemon waits for a frame, the clock, the vehicle and the autopilot move on. The daemon is the real one, and
so are the messages; only its pictures come as descriptors (`sim.trial.views`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import CameraConfig, Config, DescriptorConfig, MapConfig, RigConfig, TelemetryConfig
from edge.daemon import Daemon
from edge.journal.records import PluginFailed
from edge.opened_parts import OpenedParts
from edge.telemetry.codec import Message
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE
from edge.telemetry.link import Link
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.plugin import Mapping
from edge_plugins.page import PageConfig
from sim import geodetic
from sim.journal import records_of
from sim.trial.draft import Draft
from sim.trial.records import Array, FixErrors, TrialRun, TruthTrack
from sim.trial.simulation import STEP_S, NullLink, Simulation
from sim.trial.views import PlacedNetwork, RoadLibrary
from sim.vehicle.position_inputs import east_north_m, vision_deg
from sim.vehicle.protection import protection_levels
from sim.vehicle.pty_link import Cable
from sim.world.scenario import LightName, Scenario, View

JOURNAL = "journal.jsonl"
RECORDED_EVERY_S = 1.2
"""A stream's positions are recorded once per second."""
RIG = RigConfig(
    ahead_forward_swapped_m=32.0,
    sigma_forward_swapped_m=4.1,
    ahead_reverse_same_m=-1.0,
    left_reverse_m=3.5,
    sigma_reverse_same_m=2.8,
    look_sigma_m=0.05,
)
"""Of the simulated rig, as `lookback calibrate` measures it."""


class TrialDrive:
    """A draft, driven once with the daemon and once without; its journal stays in `folder`.

    The map is made on the way, by a second camera. A course overrides what is different about it.
    """

    def __init__(self, draft: Draft, seed: int, folder: Path, library: RoadLibrary) -> None:
        self.draft, self.seed, self.library = draft, seed, library
        self.journal = folder / JOURNAL
        self.network = PlacedNetwork(library)

    def run(self, driven: Callable[[float], object] = lambda meters: None) -> TrialRun:
        """driven: called with each few meters of the drive with the daemon, which needs nearly all of the time."""
        for suffix in (".jsonl", ".height"):
            self.journal.with_suffix(suffix).unlink(missing_ok=True)  # of an earlier drive
        with TemporaryDirectory(dir=self.journal.parent) as passing, closing(Cable()) as link:
            map_path = Path(passing) / "map"
            self.make_map(map_path)
            simulation = self.simulation(link, driven)
            simulation.show(self.network)
            self.run_daemon(simulation, self.config(f"serial:{link.device}:921600", map_path))
        alone = self.simulation(NullLink())
        while not alone.ended:
            alone.step()
        return self.judged(simulation, alone)

    def make_map(self, path: Path) -> None:
        """The map before the drive."""
        path.mkdir()

    def simulation(self, link: Link, driven: Callable[[float], object] = lambda meters: None) -> Simulation:
        """The vehicle at its start."""
        return Simulation(self.draft, link, self.seed, driven)

    def config(self, connection: str, map_path: Path) -> Config:
        """The defaults, but for the rig; nothing is kept from an earlier drive."""
        front, rear = CameraConfig(kind="sim", view="front"), CameraConfig(kind="sim", view="rear")
        if self.draft.keypoints:
            front, rear = (msgspec.structs.replace(one, fov_deg=self.draft.home.fov_deg) for one in (front, rear))
        return Config(
            camera=front,
            descriptor=DescriptorConfig(keep_statistics_min=0.0),
            map=MapConfig(path=str(map_path)),
            rig=RIG,
            telemetry=TelemetryConfig(connection=connection, emit="auto", journal=str(self.journal.resolve())),
            plugins={
                "mapping": MappingConfig(str(map_path), camera=rear, keypoints=self.draft.keypoints),
                "page": PageConfig(port=0),
            },
        )

    def run_daemon(self, simulation: Simulation, config: Config, until_s: float = math.inf) -> None:
        """To the end of the drive, or up to a moment of it."""
        mapping = simulation.rear if config.of(MappingConfig).folder else None
        with ExitStack() as parts:
            opened = OpenedParts(
                config,
                parts,
                lambda: simulation.now_ns,
                frames=simulation,
                mapping_frames=mapping,
                network=self.network,
            )
            daemon = Daemon(opened)
            while daemon.turn() and simulation.time_s() < until_s:
                opened.plugins.ask("mapping", Mapping.wait)
            if simulation.ended:
                daemon.last_words()
        for failed in records_of(self.journal, PluginFailed):
            raise RuntimeError(f"plug-in {failed.plugin}: {failed.why}")

    def judged(self, simulation: Simulation, alone: Simulation) -> TrialRun:
        """Both drives, by the truth."""
        levels = protection_levels(simulation.autopilot.received)
        levels[:, 0] = [simulation.time_s(at_s) for at_s in levels[:, 0]]
        tracks = _track(self.draft, simulation), _track(self.draft, alone)
        return TrialRun(self.seed, self.draft.world, *tracks, _sent(self.draft, simulation, self.journal), levels)


def map_scenario(home: Scenario, camera: tuple[View, LightName, int] = ("rear", "day", 1)) -> Scenario:
    """The drive that makes the map of a road, by a level camera; camera: its view, the light and the drive's seed."""
    view, light, drive_seed = camera
    level = msgspec.structs.replace(home, camera_down_deg=0.0, camera_right_deg=0.0)
    return msgspec.structs.replace(level, view=view, light=light, direction="forward", drive_seed=drive_seed)


def _track(draft: Draft, simulation: Simulation) -> TruthTrack:
    time_s, along_m, left_m, east_m, north_m, error_m, gps, _ = np.array(simulation.rows).T
    end_east_m, end_north_m, _ = draft.way.at(draft.legs[-1].to_m)
    end_off_m = math.hypot(east_m[-1] - end_east_m, north_m[-1] - end_north_m)
    return TruthTrack(time_s, along_m, left_m, error_m, gps != 0, end_off_m)


def _sent(draft: Draft, simulation: Simulation, journal: Path) -> FixErrors:
    rows = np.array(simulation.rows)
    known_s, known_m = _known_sigmas(journal, simulation)
    found = []

    def add(arrived_s: float, east_m: float, north_m: float, sigma_m: float, at_s: float) -> None:
        way_m, *true_m = (float(np.interp(at_s, rows[:, 0], rows[:, column])) for column in (1, 3, 4))
        off_m, heading_rad = (east_m - true_m[0], north_m - true_m[1]), draft.way.at(way_m)[2]
        sin, cos = math.sin(heading_rad), math.cos(heading_rad)
        along_m, cross_track_m = off_m[0] * sin + off_m[1] * cos, off_m[0] * cos - off_m[1] * sin
        found.append((arrived_s, math.hypot(*off_m), sigma_m, along_m, cross_track_m, at_s))

    origin_m = simulation.autopilot.origin_m
    origin_deg = geodetic(*origin_m) if origin_m else None
    for item in simulation.autopilot.received:
        position = read_position(item.message, origin_deg)
        if position is not None:
            east_m, north_m, sigma_m, age_s = position
            arrived_s = simulation.time_s(item.time_s)
            last = int(np.searchsorted(known_s, arrived_s + STEP_S, side="right")) - 1
            if last >= 0 and arrived_s - known_s[last] <= RECORDED_EVERY_S:
                sigma_m = min(sigma_m, known_m[last])
            add(arrived_s, east_m, north_m, sigma_m, arrived_s - age_s)
    columns: Array = np.array(sorted(found)).reshape(-1, 6).T
    return FixErrors(columns[0], columns[1], columns[2], columns[3:5].T, columns[5])


def _known_sigmas(journal: Path, simulation: Simulation) -> Array:
    """When positions were recorded as sent, in seconds, and their standard deviations (2, n): of a stream, of some."""
    boot_s = simulation.time_s(simulation.autopilot.booted_s)
    events = (msgspec.json.decode(line) for line in journal.read_bytes().splitlines())
    found = [(boot_s + one["send_boot_s"], one["sigma_m"]) for one in events if one["event"] == "fix_sent"]
    return np.array(found).reshape(-1, 2).T


def read_position(
    message: Message, origin_deg: tuple[float, float] | None = None
) -> tuple[float, float, float, float] | None:
    """East, north, sigma (m) and age (s) of a position message, None for others.

    origin_deg: latitude and longitude of the autopilot's origin, which a vision position needs; its sigma is infinite,
    since the message's lacks the error of the map.
    """
    kind = message.get_msgId()
    if kind == mavlink.MAVLINK_MSG_ID_COMMAND_INT and message.command == EXTERNAL_POSITION_ESTIMATE:
        return *east_north_m(message.x / 1e7, message.y / 1e7), message.param3, message.param2
    if kind == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_SENSOR:
        return *east_north_m(message.lat / 1e7, message.lon / 1e7), message.eph, 0.0
    if kind == mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE and origin_deg is not None:
        return *east_north_m(*vision_deg(message, origin_deg)), math.inf, 0.0
    return None
