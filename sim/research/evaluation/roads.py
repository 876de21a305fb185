"""Simulated roads, described once and driven as often as wanted: what the tables of the place belief share.

Each road is driven once with the rear camera by day (the map), and with the front camera in other lights. Descriptors
are kept in a folder: rendering takes minutes, all that follows seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config, RigConfig, SamplingConfig
from edge.descriptor.network import Network, pictures_for
from edge.geodesy import moved
from edge.localization import GPS_SIGMA_M, Odometry
from edge.localization.dead_reckoning import TurnAround
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import ModelKey
from edge.sequence import DeadReckoningPosition, Direction, MotionPrior
from edge_plugins.mapping.builder import Place
from sim.compare.temporary_map import MappedDrive, temporary_map
from sim.evaluation.metrics import Answers, answers_within
from sim.world.camera import open_renderer
from sim.world.recording import times_by_distance
from sim.world.scenario import LightName, Scenario

CALIBRATION: LightName = "day"
"""Of the drives that give the rig's offset and nothing else."""
LIGHTS: Mapping[Direction, tuple[LightName, ...]] = {
    "forward": ("dusk", "night", "rain", "snow"),
    "reverse": ("dusk", "night"),
}
SPACING_M = 2.0
TOLERANCE_M = 40.0
HOME_LEFT_M = 3.5  # of the map's drive is the lane home
FIRST_FRAME = 16  # the first that can have an answer
Cut = Literal["whole", "first half", "second half", "thirds"]
CUTS: tuple[Cut, ...] = ("whole", "first half", "second half", "thirds")
ORIGIN = (48.0, 11.0)
DRIFT = 0.05  # of dead reckoning, as [gates] drift_percent
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class DriveDescriptors:
    """A drive: raw descriptors (n, R, D), and of each frame the meters along the route and those driven (n,).

    east_north_m: (n, 2) where the vehicle was.
    """

    raw: NDArray[np.float32]
    route_m: Floats
    driven_m: Floats
    east_north_m: Floats

    def reckoned(self, lost_m: float, seed: int, origin: tuple[float, float] = ORIGIN) -> list[DeadReckoningPosition]:
        """By GPS, and since GPS was lost, by what was driven; lost_m: before the drive began, < 0 for GPS all the time.

        origin: latitude and longitude of meters.

        Errors are as large as they say: of GPS, and a share of what was driven since.
        """
        rng, since_m = np.random.default_rng(seed), np.maximum(0.0, lost_m + self.driven_m) * (lost_m >= 0)
        errors_m = GPS_SIGMA_M * rng.normal(size=2) + DRIFT * np.outer(since_m, rng.normal(size=2))
        sigmas_m = np.hypot(GPS_SIGMA_M, DRIFT * since_m)
        where = zip((self.east_north_m + errors_m).tolist(), sigmas_m.tolist(), strict=True)
        return [DeadReckoningPosition(*moved(*origin, *at_m), sigma_m) for at_m, sigma_m in where]


Case = tuple[Direction, LightName, Cut]
Drives = dict[tuple[LightName, Direction], DriveDescriptors]
World = tuple[DriveDescriptors, Drives]
"""A road as the rear camera saw it by day, and what the front camera saw on it."""


@dataclass(frozen=True)
class Beliefs:
    """Of each frame (n,): where it is believed to be, with which confidence, and the same of its best match alone.

    votes_m, by_votes: what is believed without dead reckoning.
    """

    along_m: Floats
    confidence: Floats
    match_m: Floats
    uniqueness: Floats
    votes_m: Floats
    by_votes: Floats

    @property
    def alone(self) -> Beliefs:
        """Without dead reckoning."""
        return replace(self, along_m=self.votes_m, confidence=self.by_votes)


def described(scenario: Scenario, folder: Path, network: Network) -> DriveDescriptors:
    """Render a drive at each SPACING_M and describe it, unless `folder` has it."""
    road = f"{network.info.sha256[:12]}_{scenario.seed}_{scenario.length_m:g}m_{SPACING_M:g}m"
    path = folder / f"{road}_{scenario.view}_{scenario.direction}_{scenario.light}_{scenario.drive_seed}.npz"
    drive = scenario.drive()
    if not path.exists():
        times_s = times_by_distance(drive, SPACING_M)
        renderer = open_renderer(scenario, drive)
        images = (renderer.render(drive.pose(time_s, 0.0), time_s) for time_s in times_s)
        raw = np.stack([network.describe(pictures_for(network.info, one, "left-right", 0.4)) for one in images])
        renderer.close()
        route_m, driven_m = [drive.route_m(time_s) for time_s in times_s], [drive.distance_m(t) for t in times_s]
        np.savez(path, raw=raw, route_m=route_m, distance_m=driven_m)
    stored = np.load(path)
    poses = [drive.pose(drive.time_at_s(driven_m)) for driven_m in stored["distance_m"].tolist()]
    east_north_m = np.array([(pose.east_m, pose.north_m) for pose in poses])
    return DriveDescriptors(stored["raw"], stored["route_m"], stored["distance_m"], east_north_m)


def kept(cut: Cut, places: int) -> list[tuple[int, int]]:
    """Which places [start, end) of the map are left."""
    half, third = places // 2, places // 3
    return {
        "whole": [(0, places)],
        "first half": [(0, half)],
        "second half": [(half, places)],
        "thirds": [(0, third), (2 * third, places)],
    }[cut]


def believe(
    road: DriveDescriptors,
    query: DriveDescriptors,
    cut: Cut,
    *,
    rig: RigConfig | None = None,
    reckoned: Sequence[DeadReckoningPosition | None] | None = None,
) -> Beliefs:
    """What is believed, frame by frame, on a drive over a road of which a part is mapped.

    reckoned: of each frame, None where there was no GPS yet, or never.
    """
    config = Config(rig=rig or RigConfig(), sampling=SamplingConfig(spacing_m=SPACING_M))
    found = np.full((len(query.raw), 6), np.nan)
    found[:, 1::2] = 0.0
    at = zip(road.east_north_m.tolist(), road.route_m.tolist(), strict=True)
    places = [Place(row, *moved(*ORIGIN, *at_m), route_m=along_m) for row, (at_m, along_m) in enumerate(at)]
    parts = [
        MappedDrive(road.raw[start:end].astype(np.float32), places[start:end], "rear")
        for start, end in kept(cut, len(places))
    ]
    with temporary_map(parts, ModelKey("cached", "0" * 64, "fc6", road.raw.shape[2])) as map_set:
        matcher, turn_around, route_m = SequenceMatcher(map_set, config), TurnAround(), map_set.places["route_m"]
        for frame, (raw, driven_m) in enumerate(
            zip(query.raw.astype(np.float32), query.driven_m.tolist(), strict=True)
        ):
            turn_around.add(Odometry(0, *query.east_north_m[frame].tolist()))
            dead_reckoning = reckoned[frame] if reckoned else None
            travel = MotionPrior(driven_m, course_rad=turn_around.course_rad, dead_reckoning=dead_reckoning)
            match = matcher.push(raw, travel)
            if match is not None and match.confidence > 0:
                found[frame, :2] = route_m[match.place_index], match.confidence
            if match is not None and match.alone.confidence > 0:
                found[frame, 4:] = route_m[match.alone.place_index], match.alone.confidence
            if matcher.best is not None and frame >= config.sequence_frames - 1:
                found[frame, 2:4] = route_m[matcher.best.place_index], matcher.best.uniqueness
    return Beliefs(*found.T)


def offset_m(query: DriveDescriptors, whole: Beliefs) -> float:
    """Meters of the route by which unique matches lie beyond the vehicle."""
    unique = whole.uniqueness >= AcceptanceConfig().uniqueness_min
    return float(np.median((whole.match_m - query.route_m)[unique]))


def rig_of(way: Direction, ahead_m: float) -> RigConfig:
    """As `calibrate` would write it; ahead_m: as `offset_m` has it."""
    if way == "forward":
        return RigConfig(ahead_forward_swapped_m=ahead_m)
    return RigConfig(ahead_reverse_same_m=-ahead_m, left_reverse_m=HOME_LEFT_M)


@dataclass(frozen=True)
class BeliefScore:
    """Answers by belief, and meters driven on each part of the map before it is believed."""

    belief: Answers
    first_m: list[float]


def judge(query: DriveDescriptors, mapped_m: Floats, beliefs: Beliefs, ahead_m: float) -> BeliefScore:
    """Frames beyond the map's end by less than the tolerance count if they are wrong, and not if they are right."""
    true_m = query.route_m + ahead_m
    on_map = np.abs(mapped_m - true_m[:, np.newaxis]).min(axis=1) <= SPACING_M
    right = np.abs(beliefs.along_m - true_m) <= TOLERANCE_M
    believed = right & (beliefs.confidence >= AcceptanceConfig().confidence_from)
    edges = np.flatnonzero(np.diff(on_map, prepend=False, append=False))
    first_m = [
        float(query.driven_m[enter + believed[enter:leave].argmax()] - query.driven_m[enter])
        if believed[enter:leave].any()
        else np.inf
        for enter, leave in zip(edges[::2], edges[1::2], strict=True)
    ]
    answered, off_m = np.where(beliefs.confidence > 0, beliefs.confidence, np.nan), np.abs(beliefs.along_m - true_m)
    counted = slice(FIRST_FRAME, None)
    return BeliefScore(answers_within(answered[counted], off_m[counted], on_map[counted], TOLERANCE_M), first_m)


def scenarios(seed: int, length_m: float) -> tuple[Scenario, dict[tuple[LightName, Direction], Scenario]]:
    """Of a road's map by the rear camera, and of the front camera's drives over it."""
    scene = partial(Scenario, seed=seed, length_m=length_m)
    ways = enumerate(product((CALIBRATION, *LIGHTS["forward"]), LIGHTS), start=2)
    return scene(view="rear", drive_seed=1), {
        (light, way): scene(light=light, direction=way, drive_seed=drive_seed)
        for drive_seed, (light, way) in ways
        if light in (CALIBRATION, *LIGHTS[way])
    }


def worlds(seeds: Sequence[int], length_m: float, folder: Path, network: str = "grid") -> Iterator[World]:
    """The road of each seed as the rear camera saw it, and the drives on it."""
    opened = Network.load(Path(network))
    for seed in seeds:
        mapping, driving = scenarios(seed, length_m)
        drives = {case: described(scene, folder, opened) for case, scene in driving.items()}
        yield described(mapping, folder, opened), drives


def judge_world(
    road: DriveDescriptors, drives: Drives, draws: int = 1
) -> Iterator[tuple[Case, BeliefScore, list[BeliefScore]]]:
    """Each drive over the road with each part of it mapped: by the votes alone, and with dead reckoning.

    GPS was lost where the drive begins. draws: of the errors since then, and of GPS.
    """
    for way in LIGHTS:
        calibration = drives[CALIBRATION, way]
        ahead_m = offset_m(calibration, believe(road, calibration, "whole"))
        rig = rig_of(way, ahead_m)
        for cut, light in product(CUTS, LIGHTS[way]):
            query = drives[light, way]
            mapped_m = np.concatenate([road.route_m[start:end] for start, end in kept(cut, len(road.raw))])
            beliefs = [believe(road, query, cut, rig=rig, reckoned=query.reckoned(0.0, seed)) for seed in range(draws)]
            by_votes = judge(query, mapped_m, beliefs[0].alone, ahead_m)
            yield (way, light, cut), by_votes, [judge(query, mapped_m, one, ahead_m) for one in beliefs]


def foreign_confidence(seen: Sequence[World]) -> Floats:
    """The confidence of each frame of each drive on the map of every other road, by the votes alone."""
    found = [
        believe(road, drive, "whole").confidence
        for (road, _), (_, drives) in permutations(seen, 2)
        for drive in drives.values()
    ]
    return np.concatenate([np.zeros(0), *found])
