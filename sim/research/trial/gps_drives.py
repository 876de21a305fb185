"""Honest and spoofed GPS held against the places of simulated drives.

Each drive goes through the renderer, the network and the recognizer once. GPS has no part in that as long as wheels
measure the velocity, so many histories of GPS can be held against the same places, by the daemon's own comparison and
test. Where the velocity is that of GPS, which a spoofer carries along, each drive is recognized anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from edge.config import CameraConfig, Config, GatesConfig, MapConfig, RigConfig
from edge.descriptor.network import Network
from edge.feed.sampling import Sampler
from edge.localization import GPS_SIGMA_M, Displacement, GpsFix, Gyros, Own
from edge.localization.events import Frame
from edge.localization.gps_judge import GpsJudge, compare
from edge.reference_map import Route, open_map_set
from edge.sequence import PlaceMatch, Travel
from edge.sequence_matcher import SequenceMatcher
from sim import geodetic
from sim.research.trial.course_map import open_builder, place_at
from sim.research.trial.gps_histories import Array, History
from sim.trial.receiver_errors import WANDERS_AT_M, receiver_errors
from sim.trial.run import RIG, map_scenario
from sim.trial.views import RoadLibrary
from sim.world.scenario import Scenario

STEP_S, LENGTH_M = 0.1, 1600.0
MAP_SIGMA_M = 2.7
WORLDS = (401, 402, 403, 404, 405)
DRIVES = (
    Scenario(light="night", direction="reverse", drive_seed=2, length_m=LENGTH_M),
    Scenario(light="dusk", direction="forward", drive_seed=3, length_m=LENGTH_M),
    Scenario(light="rain", direction="forward", drive_seed=4, length_m=LENGTH_M),
    Scenario(light="snow", direction="forward", drive_seed=6, length_m=LENGTH_M),
)
RIG_OF_WORLDS: RigConfig = msgspec.structs.replace(RIG, sigma_forward_swapped_m=10.0, sigma_reverse_same_m=4.5)
"""As calibrated on these roads, in other light."""
WHEELS, HEADING_DEG = 0.03, 1.5
"""Errors of wheels, as a share, and of the heading: one standard deviation."""
TOLD = "disagrees", "wrong", "map wrong"
CALLED_M, SEEN_M = 50.0, (30.0, 48.0)
"""A drag-off should be called before the first; on a road with sightings there are some between the other two."""
BEGINS_M, SIGHTINGS = 20.0, 3


@dataclass(frozen=True)
class PlacedFrame:
    """A used frame: its row of the drive's time, its match, and the places that were passed before it without one."""

    row: int
    match: PlaceMatch | None
    missed: int


@dataclass(frozen=True)
class PlacedDrive:
    """A drive with the places that were recognized on it.

    time_s: (N,). true_m: east and north (N, 2). by_wheels_m: the same by wheels and
    heading, which are wrong by a little; NaN without.
    """

    light: str
    time_s: Array
    true_m: Array
    by_wheels_m: Array
    route: Route
    frames: tuple[PlacedFrame, ...]


@dataclass(frozen=True)
class Outcome:
    """A history of GPS on a drive.

    called_m: error of GPS when it was called wrong, NaN if it never was. told_m: when the pilot was told that GPS and
    the places disagree, or more. called_after_m: driven until the call, from where the error exceeds BEGINS_M. seen:
    whether places were recognized while the error was between SEEN_M. doubt: the greatest. driven_m: in all. warned:
    whether the vehicle was not recognized where GPS had it.
    """

    called_m: float
    told_m: float
    called_after_m: float
    seen: bool
    doubt: float
    driven_m: float
    warned: bool
    light: str


def build_map(world: int, seed: int, folder: Path, library: RoadLibrary, network: Network) -> Path:
    """The map of a road, whose positions are as wrong as an ordinary receiver makes them."""
    path = folder / f"map_{world}_{seed}"
    out = map_scenario(Scenario(seed=world, length_m=LENGTH_M))
    views, rng = library[out], np.random.default_rng([world, seed, 5])
    places_m = np.arange(0.0, LENGTH_M + 1, 2.0)
    errors_m = MAP_SIGMA_M / math.sqrt(2) * receiver_errors(len(places_m), 2.0, WANDERS_AT_M, rng)
    with open_builder(path, network, replace=True) as builder:
        builder.begin_segment("out", "rear", whole_sigma_m=0.0)
        for row, (route_m, error_m) in enumerate(zip(places_m, errors_m, strict=True)):
            pose = views.drive.route.at(route_m, out.lane_m)
            builder.add(views.raw(route_m), place_at(row, route_m, pose, error_m, MAP_SIGMA_M))
        builder.finish()
    return path


def truth(scenario: Scenario, speed_mps: float, seed: int) -> tuple[Array, Array, Array]:
    """Seconds (N,), meters along the road (N,), and positions (N, 2) of a drive at about that speed."""
    rng, sign = np.random.default_rng([seed, 4]), 1.0 if scenario.direction == "forward" else -1.0
    route, route_m, speed = scenario.drive().route, [5.0 if sign > 0 else LENGTH_M - 5.0], speed_mps
    while 2.0 < route_m[-1] < LENGTH_M - 2.0:
        speed += STEP_S * 0.1 * (speed_mps - speed) + rng.normal(0.0, 0.05)
        route_m.append(route_m[-1] + sign * speed * STEP_S)
    true_m = np.array([route.at(m, sign * scenario.lane_m)[:2] for m in route_m])
    time_s: Array = np.arange(len(route_m), dtype=np.float64) * STEP_S
    return time_s, np.array(route_m), true_m


def place(
    scenario: Scenario, map_path: Path, seed: int, library: RoadLibrary, history: History | None = None
) -> PlacedDrive:
    """Recognize the places of a drive. history: of GPS, whose velocity is that of the vehicle; None: wheels."""
    rng = np.random.default_rng([seed, 6])
    time_s, route_m, true_m = truth(scenario, float(rng.uniform(5.0, 14.0)), seed)
    velocity = np.gradient(true_m, STEP_S, axis=0)
    if history is not None:
        offsets = history(time_s, true_m, np.random.default_rng([seed, 8]))
        velocity += np.gradient(_smooth(np.nan_to_num(offsets)), STEP_S, axis=0)
    odometer_m = np.cumsum(np.hypot(*velocity.T)) * STEP_S * (1.0 + rng.normal(0.0, 0.015) * (history is None))
    config = Config(camera=CameraConfig(kind="sim", view="front"), map=MapConfig(path=str(map_path)), rig=RIG_OF_WORLDS)
    maps = open_map_set(map_path)
    matcher, sampler, frames = SequenceMatcher(maps, config), Sampler(config.sampling), []
    for row, (at_s, at_m, driven_m) in enumerate(zip(time_s, route_m, odometer_m, strict=True)):
        if sampler.is_place(round(at_s * 1e9), float(driven_m)):
            raw = library[scenario].raw(float(at_m))
            match = matcher.push(raw, Travel(float(driven_m), sampler.missed))
            frames.append(PlacedFrame(row, match, sampler.missed))
    turned, scale = math.radians(rng.normal(0.0, HEADING_DEG)), 1.0 + rng.normal(0.0, WHEELS)
    turn = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    by_wheels_m = scale * (true_m - true_m[0]) @ turn
    return PlacedDrive(scenario.light, time_s, true_m, by_wheels_m, Route(maps), tuple(frames))


def _smooth(offsets: Array) -> Array:
    """Over about 4 s, as a filter that knows the accelerations follows a receiver."""
    window = np.hanning(round(8.0 / STEP_S) + 1)
    padded = np.pad(offsets, ((len(window) // 2, len(window) // 2), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(one, window / window.sum(), mode="valid") for one in padded.T])


def judge(drive: PlacedDrive, offsets: Array, gates: GatesConfig = GatesConfig()) -> Outcome:  # noqa: B008  # frozen
    """Hold a history of GPS against the places of a drive."""
    error_m = np.hypot(*offsets.T)
    config = Config(gates=gates, rig=RIG_OF_WORLDS)
    judged = GpsJudge(config)
    judged.use_route(drive.route)
    driven_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(drive.true_m, axis=0).T))])
    seen, doubt, begins_m, called, told_m, warned = 0, 0.0, math.nan, (math.nan, math.nan), math.nan, False
    for frame in drive.frames:
        gps = None
        if math.isnan(begins_m) and error_m[frame.row] > BEGINS_M:
            begins_m = driven_m[frame.row]
        if not math.isnan(error_m[frame.row]):
            at_m = drive.true_m[frame.row] + offsets[frame.row]
            gps = GpsFix(*geodetic(float(at_m[0]), float(at_m[1])), GPS_SIGMA_M)
        stamp_ns, by_wheels_m = round(drive.time_s[frame.row] * 1e9), drive.by_wheels_m[frame.row].tolist()
        gyros = Gyros(drive.time_s[frame.row])  # whose bias is in the heading of `by_wheels_m`
        motion = None if math.isnan(by_wheels_m[0]) else Displacement(1, by_wheels_m[0], by_wheels_m[1], gyros=gyros)
        judged.update(Frame(stamp_ns, frame.match, without_gps=motion, gps=gps, missed=frame.missed), Own(), None)
        verdict = judged.verdict
        if SEEN_M[0] < error_m[frame.row] < SEEN_M[1] and frame.match is not None:
            seen += compare(frame.match, gps, drive.route, RIG_OF_WORLDS, config.sequence_frames) is not None
        if verdict.state == "wrong" and math.isnan(called[0]):
            called = float(error_m[frame.row]), float(driven_m[frame.row] - begins_m)
        if verdict.state in TOLD and math.isnan(told_m):
            told_m = float(error_m[frame.row])
        doubt, warned = max(doubt, verdict.doubt or 0.0), warned or verdict.state == "not recognized"
    return Outcome(called[0], told_m, called[1], seen >= SIGHTINGS, doubt, float(driven_m[-1]), warned, drive.light)
