"""One drive of a course: the daemon beside a simulated autopilot on a pseudo-terminal, both in simulated time.

Whenever the daemon waits for a frame, the clock, the vehicle and the autopilot move on. The daemon is the real one, and
so are the messages; only its pictures come as descriptors (`sim.trial.views`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from edge.config import (
    CameraConfig,
    Config,
    DescriptorConfig,
    GatesConfig,
    MapConfig,
    MappingConfig,
    MotionConfig,
    PageConfig,
    RigConfig,
    SamplingConfig,
    TelemetryConfig,
)
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.motion import CameraMotion
from edge.motion.height import WINDOWS_MOST
from edge.opened_parts import OpenedParts
from edge.recognizer import model_key
from edge.reference_map import LearnedFolder
from edge.reference_map.builder import NAN, MapBuilder, Place
from edge.reference_map.store import RegionsKey
from edge.telemetry.codec import Message
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE
from sim import ORIGIN_ALT_M, geodetic
from sim.maps.learning import learn
from sim.trial.cameras import PlacedNetwork
from sim.trial.draft import Course, Draft, Stretch
from sim.trial.receiver_errors import WANDERS_AT_M, receiver_errors
from sim.trial.rules import Array, Run, Sent, Track, failures, within_protection_level
from sim.trial.simulation import STEP_S, Silent, Simulation
from sim.trial.views import RoadLibrary
from sim.vehicle.position_inputs import east_north_m
from sim.vehicle.protection import protection_levels
from sim.vehicle.pty_link import PtyLink, open_pty
from sim.world.route import Route
from sim.world.scenario import LightName, Scenario, View
from sim.world.sensor import CAMERA_HIGH_M

JOURNAL = "journal.jsonl"
MAP_SIGMA_M = math.sqrt(2)
"""Accuracy of a map's positions, as stated and as simulated: of the distance, as receivers state it."""
RECORDED_EVERY_S = 1.2
"""A stream's positions are recorded once per second."""
RIG = RigConfig(
    ahead_forward_swapped_m=32.0,
    sigma_forward_swapped_m=4.1,
    ahead_reverse_same_m=-1.0,
    left_reverse_m=3.5,
    parallax=2.4,
    sigma_reverse_same_m=2.8,
)
"""Of the simulated rig, as `lookback calibrate` measures it."""


def drive(
    course: Course,
    seed: int,
    length_m: float,
    world: int,
    folder: Path,
    library: RoadLibrary,
    driven: Callable[[float], object] = lambda meters: None,
) -> Run:
    """Drive a course once with the daemon and once without; its journal stays in `folder`.

    driven: called with each few meters of the drive with it, which needs nearly all of the time.
    """
    network = PlacedNetwork.load()
    assert isinstance(network, PlacedNetwork)
    network.library = library
    draft = drafted(course, seed, length_m, world)
    with TemporaryDirectory(dir=folder) as passing:
        map_path = Path(passing) / "map"
        if draft.maps_live:
            map_path.mkdir()
        else:
            build_course_map(draft, map_path, network, library, seed)
        with closing(open_pty()) as link:
            simulation = Simulation(draft, link, seed, driven)
            simulation.show(network)
            _run_daemon(simulation, draft, link, map_path, folder, network)
    alone = Simulation(drafted(course, seed, length_m, world), Silent(), seed)
    while not alone.ended:
        alone.step()
        if draft.origin_m is not None:
            alone.autopilot.set_origin(*draft.origin_m)  # which somebody else sets then
    return _judged(seed, draft, simulation, alone, folder / JOURNAL)


def drafted(course: Course, seed: int, length_m: float, world: int) -> Draft:
    """The course of a seed."""
    draft = Draft(np.random.default_rng([seed, 7]), max(length_m, course.least_m), world)
    course.lay(draft)
    return draft


def _run_daemon(
    simulation: Simulation, draft: Draft, link: PtyLink, map_path: Path, folder: Path, network: Network
) -> None:
    config = _settings(draft, link, map_path, folder)
    if draft.height is not None:
        heights_m = (CAMERA_HIGH_M * draft.height,) * WINDOWS_MOST
        height = msgspec.structs.replace(CameraMotion(config).height.kept, heights_m=heights_m)
        (folder / JOURNAL).with_suffix(".height").write_bytes(msgspec.json.encode(height))
    mapping = simulation.rear if draft.maps_live else None
    for until_s in (draft.killed_s, math.inf):
        if until_s is None:
            continue
        with ExitStack() as parts:
            opened = OpenedParts(
                config, parts, lambda: simulation.now_ns, frames=simulation, mapping_frames=mapping, network=network
            )
            daemon = Daemon(opened)
            while daemon.turn() and simulation.time_s() < until_s:
                pass
            if simulation.ended:
                daemon.last_words()
        if not simulation.ended:
            link.receive()  # what it said when its parts were closed; a daemon that is killed says nothing
            simulation.is_heard = False
            while simulation.time_s() < until_s + draft.down_s and not simulation.ended:
                simulation.take(STEP_S)
            simulation.is_heard = True


def _settings(draft: Draft, link: PtyLink, map_path: Path, folder: Path) -> Config:
    """The defaults, but for the rig and what the course asks for; nothing is kept from an earlier drive."""
    for suffix in (".jsonl", ".bound", ".height"):
        (folder / JOURNAL).with_suffix(suffix).unlink(missing_ok=True)
    origin = (*geodetic(*draft.origin_m, draft.lon_shift_deg), ORIGIN_ALT_M) if draft.origin_m else ()
    mapping = MappingConfig(str(map_path), camera=CameraConfig(kind="sim", view="rear"))
    return Config(
        camera=CameraConfig(kind="sim", view="front"),
        descriptor=DescriptorConfig(keep_statistics_min=0.0),
        map=MapConfig(path=str(map_path)),
        motion=MotionConfig(use=draft.motion),
        mapping=mapping if draft.maps_live else MappingConfig(),
        page=PageConfig(port=0),
        rig=RIG,
        gates=GatesConfig(doubted_gps=draft.doubted_gps),
        telemetry=msgspec.structs.replace(
            TelemetryConfig(),
            connection=f"serial:{link.device}:921600",
            emit=draft.emit,
            journal=str((folder / JOURNAL).resolve()),
            origin=origin,
        ),
    )


def map_scenario(home: Scenario, camera: tuple[View, LightName, int] = ("rear", "day", 1)) -> Scenario:
    """The drive that makes the map of a road; camera: see `Stretch`."""
    view, light, drive_seed = camera
    return msgspec.structs.replace(home, view=view, light=light, direction="forward", drive_seed=drive_seed)


def build_course_map(draft: Draft, path: Path, network: Network, library: RoadLibrary, seed: int) -> None:
    """The map of a course, made on the way out; by day with the camera that looks back, unless it has layers.

    Each stretch is a drive of its own, with errors of GPS that are as large as the accuracy that it states.
    """
    config = DescriptorConfig()
    regions = RegionsKey(config.regions, config.region_width, "set")
    rngs = np.random.default_rng([draft.world, 11]), np.random.default_rng([seed, 13])
    numbers = range(len(draft.map))
    cameras = dict.fromkeys(stretch.camera for stretch in draft.map)
    by_camera = [[number for number in numbers if draft.map[number].camera == camera] for camera in cameras]
    for part in by_camera if draft.layers else [numbers]:
        folder = path / f"{part[0]}" if draft.layers else path
        with MapBuilder(folder, model_key(network), regions, SamplingConfig()) as builder:
            for number in part:
                _drive_stretch(builder, draft, number, library, rngs)
            builder.finish()
    if draft.layers:
        learn(path).keep(LearnedFolder(path))


def _drive_stretch(
    builder: MapBuilder,
    draft: Draft,
    number: int,
    library: RoadLibrary,
    rngs: tuple[np.random.Generator, np.random.Generator],
) -> None:
    """rngs: of the places, and of GPS."""
    stretch = draft.map[number]
    out = map_scenario(draft.home, stretch.camera)
    builder.begin_segment(stretch.recording or f"stretch {number}", out.view)
    seen = out if stretch.looks is None else msgspec.structs.replace(out, seed=stretch.looks)
    places_m = _places_m(stretch, rngs[0])
    off_m = _errors_m(places_m, rngs[1]) + np.array(stretch.off_m)
    for row, route_m in enumerate(places_m):
        raw = library[seen].raw(draft.seen_m(route_m), 0.0 if stretch.looks else stretch.left_m)
        builder.add(raw, _place(draft, library[out].drive.route, stretch, row, route_m, off_m[row]))


def _places_m(stretch: Stretch, rng: np.random.Generator) -> list[float]:
    places_m = [stretch.start_m]
    while places_m[-1] < stretch.end_m:
        places_m.append(places_m[-1] + rng.uniform(*stretch.spacing_m))
    return places_m[:-1]


def _errors_m(places_m: list[float], rng: np.random.Generator) -> Array:
    """East and north (n, 2) of each place of a drive."""
    length_m = places_m[-1] - places_m[0]
    errors = receiver_errors(int(length_m) + 2, 1.0, WANDERS_AT_M, rng)
    rows = np.array([int(route_m - places_m[0]) for route_m in places_m])
    off_m: Array = MAP_SIGMA_M / math.sqrt(2) * errors[rows]
    return off_m


def _place(draft: Draft, route: Route, stretch: Stretch, row: int, route_m: float, off_m: Array) -> Place:
    if stretch.on_way:
        # Against the way, on the lane that the rig's offset expects.
        at_m = float(np.argmin(np.abs(draft.way.route_m - route_m)))
        east_m, north_m, heading_rad = draft.way.at(at_m, -RIG.left_reverse_m - stretch.left_m)
        heading_rad += math.pi
    else:
        east_m, north_m, heading_rad = route.at(route_m, draft.home.lane_m + stretch.left_m)
    lat_deg, lon_deg = geodetic(east_m + off_m[0], north_m + off_m[1], draft.lon_shift_deg)
    heading_deg = math.degrees(heading_rad) % 360 if stretch.headings else NAN
    known = row, lat_deg, lon_deg, ORIGIN_ALT_M, heading_deg, route_m
    return Place(*known, position_sigma_m=MAP_SIGMA_M, position_source="gps")


def _judged(seed: int, draft: Draft, simulation: Simulation, alone: Simulation, journal: Path) -> Run:
    inputs = simulation.autopilot.inputs
    texts = tuple(
        (simulation.time_s(item.time_s), item.message.severity, item.message.text)
        for item in simulation.autopilot.received
        if item.message.get_type() == "STATUSTEXT"
    )
    run = Run(
        seed,
        draft.world,
        _track(draft, simulation),
        _track(draft, alone),
        _sent(draft, simulation, journal),
        np.array([item.error_after_m for item in (*inputs.resets, *inputs.fused)]),
        texts,
        inputs.source_set,
        _levels(simulation),
    )
    return replace(run, failures=failures(run, (*draft.rules, within_protection_level)))


def _levels(simulation: Simulation) -> Array:
    levels = protection_levels(simulation.autopilot.received)
    levels[:, 0] = [simulation.time_s(at_s) for at_s in levels[:, 0]]
    return levels


def _track(draft: Draft, simulation: Simulation) -> Track:
    time_s, along_m, left_m, east_m, north_m, error_m, gps = np.array(simulation.rows).T
    row = along_m.astype(int).clip(0, len(draft.way.route_m) - 1)
    expected = (
        (gps == 0) & (np.array(draft.way.roads, object)[draft.way.road[row]] == draft.home) & ~draft.way.carried[row]
    )
    route_m = draft.way.route_m[row]
    known = [(stretch.start_m <= route_m) & (route_m < stretch.end_m) for stretch in draft.map if stretch.is_true]
    expected &= np.any(known, axis=0) if known else False
    for start_m, end_m in draft.unsent:
        expected &= ~((along_m >= start_m) & (along_m < end_m))
    end_east_m, end_north_m, _ = draft.way.at(draft.legs[-1].to_m)
    end_off_m = math.hypot(east_m[-1] - end_east_m, north_m[-1] - end_north_m)
    return Track(time_s, along_m, left_m, error_m, gps != 0, expected, end_off_m)


def _sent(draft: Draft, simulation: Simulation, journal: Path) -> Sent:
    rows = np.array(simulation.rows)
    known_s, known_m = _known_sigmas(journal, simulation)
    found = []
    for item in simulation.autopilot.received:
        position = read_position(item.message, simulation.autopilot.origin_m or (0.0, 0.0), draft.lon_shift_deg)
        if position is not None:
            east_m, north_m, sigma_m, age_s = position
            at_s = simulation.time_s(item.time_s) - age_s
            true_m = [np.interp(at_s, rows[:, 0], rows[:, column]) for column in (3, 4)]
            error_m = math.hypot(east_m - true_m[0], north_m - true_m[1])
            arrived_s = simulation.time_s(item.time_s)
            last = int(np.searchsorted(known_s, arrived_s + STEP_S, side="right")) - 1
            if last >= 0 and arrived_s - known_s[last] <= RECORDED_EVERY_S:
                sigma_m = min(sigma_m, known_m[last])
            found.append((arrived_s, error_m, sigma_m))
    columns: Array = np.array(found).reshape(-1, 3).T
    return Sent(columns[0], columns[1], columns[2])


def _known_sigmas(journal: Path, simulation: Simulation) -> Array:
    """When positions were recorded as sent, in seconds, and their standard deviations (2, n): of a stream, of some."""
    boot_s = simulation.time_s(simulation.autopilot.booted_s)
    events = (msgspec.json.decode(line) for line in journal.read_bytes().splitlines())
    found = [(boot_s + one["send_boot_s"], one["sigma_m"]) for one in events if one["event"] == "fix_sent"]
    return np.array(found).reshape(-1, 2).T


def read_position(
    message: Message, origin_m: tuple[float, float] = (0.0, 0.0), shift_deg: float = 0.0
) -> tuple[float, float, float, float] | None:
    """East, north, sigma (m) and age (s) of a position message, None for others.

    origin_m: of the autopilot's local frame. shift_deg: by which the simulation's origin was moved east.
    """
    kind = message.get_msgId()
    if kind == mavlink.MAVLINK_MSG_ID_COMMAND_INT and message.command == EXTERNAL_POSITION_ESTIMATE:
        return *east_north_m(message.x / 1e7, message.y / 1e7, shift_deg), message.param3, message.param2
    if kind == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_SENSOR:
        return *east_north_m(message.lat / 1e7, message.lon / 1e7, shift_deg), message.eph, 0.0
    if kind == mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE:
        return message.y + origin_m[0], message.x + origin_m[1], _ardupilot_sigma_m(message.covariance), 0.0
    return None


def _ardupilot_sigma_m(covariance: Sequence[float]) -> float:
    """As its filter reads a VISION_POSITION_ESTIMATE (`cbrtf` in GCS_MAVLINK::handle_vision_position_estimate)."""
    return float(np.cbrt(sum(covariance[axis] ** 2 for axis in (0, 6, 11))))
