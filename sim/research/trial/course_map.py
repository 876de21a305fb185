"""The map of a course, made before the drive."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from edge.config import DescriptorConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.keypoints.network import KeypointNetwork
from edge.recognition.recognizer import model_key
from edge.reference_map.store import RegionsKey
from edge_plugins.mapping.builder import NAN, MapBuilder, Place
from edge_plugins.mapping.keypoint_rows import MOST_OF_PLACE, keypoints_key
from sim import ORIGIN_ALT_M, geodetic
from sim.research.trial.course import CourseDraft, MapStretch
from sim.trial.records import Array
from sim.trial.run import RIG, map_scenario
from sim.trial.simulation import WANDERS_AT_M, receiver_errors
from sim.trial.views import RoadLibrary
from sim.world.route import WorldRoute
from sim.world.scenario import Scenario

MAP_SIGMA_M = math.sqrt(2)
"""Accuracy of a map's positions, as stated and as simulated: of the distance, as receivers state it."""


def build_map(draft: CourseDraft, path: Path, network: Network, library: RoadLibrary, seed: int) -> Array:
    """The map of a course, made on the way out by day, with the camera that faces back.

    Each stretch is a drive of its own, with errors of GPS that are as large as the accuracy that it states. Answers
    those of the last one (n, 3): arc length, and meters east and north.
    """
    errors_m = np.empty((0, 3))
    rngs = np.random.default_rng([draft.world, 11]), np.random.default_rng([seed, 13])
    with open_builder(path, network, keypoints=draft.keypoints) as builder:
        for number in range(len(draft.map)):
            errors_m = _drive_stretch(builder, draft, number, library, rngs)
        builder.finish()
    return errors_m


def _drive_stretch(
    builder: MapBuilder,
    draft: CourseDraft,
    number: int,
    library: RoadLibrary,
    rngs: tuple[np.random.Generator, np.random.Generator],
) -> Array:
    """rngs: of the places, and of GPS. Its errors, see `build_map`."""
    stretch = draft.map[number]
    out = map_scenario(draft.home, stretch.camera)
    whole_sigma_m = None if stretch.late_m else 0.0
    builder.begin_segment(
        stretch.recording or f"stretch {number}", out.view, has_odometer=True, whole_sigma_m=whole_sigma_m
    )
    seen = out if stretch.appearance is None else msgspec.structs.replace(out, seed=stretch.appearance)
    places_m = _places_m(stretch, rngs[0])
    from_m, to_m = stretch.off_within_m
    is_off = np.array([from_m <= route_m < to_m for route_m in places_m])
    off_m = map_errors_m(places_m, rngs[1]) + np.outer(is_off, stretch.off_m)
    view, finder = library[seen], KeypointNetwork() if builder.keypoints else None
    for row, route_m in enumerate(places_m):
        at_m = draft.seen_m(route_m), 0.0 if stretch.appearance else stretch.left_m
        builder.add(view.raw(*at_m), _place(draft, library[out].drive.route, stretch, row, route_m, off_m[row]))
        if builder.keypoints and finder:
            if at_m not in view.keypoints:
                view.keypoints[at_m] = finder.extract(view.picture(*at_m), MOST_OF_PLACE)
            builder.keypoints.add(view.keypoints[at_m])
    return np.column_stack([places_m, off_m])


def _places_m(stretch: MapStretch, rng: np.random.Generator) -> list[float]:
    places_m = [stretch.start_m]
    while places_m[-1] < stretch.end_m:
        places_m.append(places_m[-1] + rng.uniform(*stretch.spacing_m))
    return places_m[:-1]


def map_errors_m(places_m: list[float], rng: np.random.Generator) -> Array:
    """East and north (n, 2) by which each place of a drive is wrong, as its stated accuracy says."""
    length_m = places_m[-1] - places_m[0]
    errors = receiver_errors(int(length_m) + 2, 1.0, WANDERS_AT_M, rng)
    rows = np.array([int(route_m - places_m[0]) for route_m in places_m])
    off_m: Array = MAP_SIGMA_M / math.sqrt(2) * errors[rows]
    return off_m


def open_builder(path: Path, network: Network, *, replace: bool = False, keypoints: bool = False) -> MapBuilder:
    """A builder of a map whose pictures are described as by default; keypoints: with those of each place."""
    regions = RegionsKey.of(DescriptorConfig())
    key = partial(keypoints_key, fov_deg=Scenario().fov_deg) if keypoints else None
    return MapBuilder(path, model_key(network), regions, SamplingConfig(), replace=replace, keypoints=key)


def _place(draft: CourseDraft, route: WorldRoute, stretch: MapStretch, row: int, route_m: float, off_m: Array) -> Place:
    if stretch.on_way:
        # Against the way, on the lane that the rig's offset expects.
        at_m = float(np.argmin(np.abs(draft.way.route_m - route_m)))
        east_m, north_m, heading_rad = draft.way.at(at_m, -RIG.left_reverse_m - stretch.left_m)
        heading_rad += math.pi
    else:
        at_m = max(0.0, route_m - stretch.late_m)
        east_m, north_m, heading_rad = route.at(at_m, draft.home.lane_m + stretch.left_m)
    pose = east_m, north_m, heading_rad if stretch.headings else NAN
    return place_at(row, route_m, pose, off_m)


def place_at(
    row: int,
    route_m: float,
    pose: tuple[float, float, float],
    off_m: Array,
    sigma_m: float = MAP_SIGMA_M,
) -> Place:
    """A place whose position is wrong by off_m, (2,) east and north; pose: meters east and north, and heading."""
    east_m, north_m, heading_rad = pose
    lat_deg, lon_deg = geodetic(east_m + off_m[0], north_m + off_m[1])
    known = row, lat_deg, lon_deg, ORIGIN_ALT_M, math.degrees(heading_rad) % 360, route_m
    return Place(*known, position_sigma_m=sigma_m, position_source="gps")
