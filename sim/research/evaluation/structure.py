"""How far off the shape of the street has a vehicle in opposite views, on simulated roads or in your own recording.

The map by day, with keypoints: by a rear camera, driven over the same way, and by a front camera, driven home. Each
drive has its own lane, shakes, and has a picture every 2 m. The place that is believed is off by a normal error of
BELIEVED_SIGMA_M, as sequence matches are. A match is right within RIGHT_M of the truth.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import CameraConfig, Config
from edge.feed import Feed, FeedImages, View, read_feed
from edge.geodesy import east_north
from edge.keypoints.network import KeypointNetwork
from edge.recognition.structure_matcher import StructureMatcher
from edge.reference_map import MapSet, ReferenceMap, open_map_set
from edge.sequence import Direction, Order, PlaceMatch
from edge.structure import StructureMatch
from edge.structure.path import DrivePath
from sim.research.evaluation import poses
from sim.world.recording import recorded
from sim.world.scenario import LightName, Scenario

LENGTH_M, SPACING_M = 1000.0, 2.0
CASES: dict[str, tuple[View, Direction, tuple[LightName, ...]]] = {
    "the same way, a rear camera's map": ("rear", "forward", ("dusk", "night", "rain", "snow")),
    "home, a front camera's map": ("front", "reverse", ("dusk", "night")),
}
LANES_M = (1.0, 1.75, 2.5)
"""Of the draws; the map's is 1.75."""
BELIEVED_SIGMA_M, RIGHT_M, APART_M = 7.0, 5.0, 10.0
LAGS_M = (10, 20, 40)
HEAD = "matches; one in | right | along-track, mean and sd | cross-track | rms over sigma | within 2 sigma | alike"


def rows(args: argparse.Namespace) -> Iterator[str]:
    """Where the shape of the street has a vehicle in opposite views."""
    yield f"| drive | {HEAD} {', '.join(map(str, LAGS_M))} m apart |"
    yield "|---" * 8 + "|"
    for name, (view, way, lights) in CASES.items():
        found = []
        for light in lights:
            drives = [
                _errors(MapSet.of(_mapped(args.cache, road, view)), _recorded(args.cache, road, way, light, draw))
                for road, draw in product(args.seeds, range(args.draws))
            ]
            yield _row(f"{name}, {light}", drives)
            found += drives
        yield _row(f"{name}, all", found)


def of_recording(args: argparse.Namespace) -> Iterator[str]:
    """The same of a recording with positions, by a map with keypoints whose camera faced the other way."""
    yield f"| recording | {HEAD} {', '.join(map(str, LAGS_M))} m apart |"
    yield "|---" * 8 + "|"
    yield _row(args.feed.name, [_errors(open_map_set(args.map), read_feed(args.feed))])


def _mapped(folder: Path, road: int, view: View) -> ReferenceMap:
    return poses.mapped(folder, Scenario(road, LENGTH_M), view)


def _recorded(folder: Path, road: int, way: Direction, light: LightName, draw: int) -> Feed:
    made = Scenario(road, LENGTH_M, direction=way, light=light, lane_m=LANES_M[draw % len(LANES_M)], shaking=1.0)
    made = replace(made, drive_seed=100 * draw + (13 if way == "forward" else 14))
    return read_feed(recorded(made, folder, SPACING_M))


def _errors(maps: MapSet, feed: Feed) -> NDArray[np.float64]:
    """Of each APART_M (n, 4): what a match is off by along-track and cross-track, and their sigmas; NaN of none."""
    header, rng, network = feed.header, np.random.default_rng(0), KeypointNetwork()
    camera = CameraConfig(view=header.view, fov_deg=UNSET if header.fov_deg is None else header.fov_deg)
    matcher = StructureMatcher(maps, Config(camera=camera), lambda: network, APART_M)
    truth, images = DriveTruth(maps, feed), FeedImages(feed)
    found = np.full((int(truth.driven_m[-1] / APART_M) + 1, 4), np.nan)
    order: Order = "swapped" if truth.way == "forward" else "same"
    for index in range(len(feed.rows)):
        believed_m = truth.along_m[index] + rng.normal(0.0, BELIEVED_SIGMA_M)
        place = int(np.abs(truth.route_m - believed_m).argmin())
        believed = PlaceMatch(place, place, truth.way, order, 1.0, 0.0, 1.0, accepted=True)
        matcher.add(images.read(index), (truth.ground_m[index, 0], truth.ground_m[index, 1]))
        if (seen := matcher.match(believed)) is not None:
            found[int(truth.driven_m[index] / APART_M)] = truth.off(index, seen)
    images.close()
    return found


class DriveTruth:
    """Where a drive's frames are on the first drive of a map: along it, and to its left."""

    def __init__(self, maps: MapSet, feed: Feed) -> None:
        places = maps.places[slice(*maps.index.segment(0))]
        self.route_m = places["route_m"].astype(np.float64)
        origin = float(places["lat_deg"][0]), float(places["lon_deg"][0])
        degrees = np.array([(row.lat_deg, row.lon_deg) for row in feed.rows], dtype=np.float64).T
        line = east_north(places["lat_deg"], places["lon_deg"], origin)
        self.ground_m = east_north(degrees[0], degrees[1], origin)
        self.driven_m = np.concatenate([[0.0], np.hypot(*np.diff(self.ground_m, axis=0).T).cumsum()])
        path, nearest = (
            DrivePath(self.route_m, line, np.zeros(len(line))),
            np.hypot(*(self.ground_m[:, np.newaxis] - line).T).argmin(axis=0),
        )
        at = [path.beside(int(row), spot[np.newaxis]) for row, spot in zip(nearest, self.ground_m, strict=True)]
        self.along_m, self.left_m = np.concatenate(at, axis=1)
        self.way: Direction = "forward" if self.along_m[-1] > self.along_m[0] else "reverse"

    def off(self, index: int, seen: StructureMatch) -> tuple[float, float, float, float]:
        """Meters ahead of and to the left of the truth in the direction of travel, and the sigmas."""
        sign = 1 if self.way == "forward" else -1
        then = index - seen.frames
        frames = np.arange(len(self.along_m))
        along_m, left_m = (float(np.interp(then, frames, one)) for one in (self.along_m, self.left_m))
        ahead_m = self.route_m[seen.place_index] + seen.ahead_m - along_m
        return sign * ahead_m, sign * (seen.left_m - left_m), *seen.sigma_m


def _row(name: str, drives: Sequence[NDArray[np.float64]]) -> str:
    off = np.concatenate(drives)
    known = off[np.isfinite(off[:, 0])]
    right = known[np.abs(known[:, 0]) <= RIGHT_M]
    ratio = right[:, :2] / right[:, 2:4]
    spread = [
        f"{mean:+.2f}, {sd:.2f} m" for mean, sd in zip(right[:, :2].mean(axis=0), right[:, :2].std(axis=0), strict=True)
    ]
    rms, within = np.sqrt(np.square(ratio).mean(axis=0)), (np.abs(ratio) <= 2).mean(axis=0)
    errors = [np.where(np.abs(one[:, 0]) <= RIGHT_M, one[:, 0], np.nan) for one in drives]
    alike = ", ".join(f"{alikeness(errors, lag_m * SPACING_M / APART_M):.2f}" for lag_m in LAGS_M)
    counts = f"{len(known)}; {len(off) * APART_M / max(len(known), 1):.0f} m | {len(right) / max(len(known), 1):.3f}"
    both = [" and ".join(f"{one:.2f}" for one in pair) for pair in (rms, within)]
    return f"| {name} | {counts} | {' | '.join(spread)} | {' | '.join(both)} | {alike} |"


def alikeness(drives: list[NDArray[np.float64]], lag_m: float) -> float:
    """Correlation of errors (n,) so many meters apart, each less its drive's mean; NaN where unknown."""
    lag, pairs = round(lag_m / SPACING_M), []
    for off_m in drives:
        own = off_m - np.nanmean(off_m)
        pairs.append(np.stack([own[:-lag], own[lag:]]))
    both = np.concatenate(pairs, axis=1)
    one, other = both[:, ~np.isnan(both).any(axis=0)]
    return float((one @ other) / np.sqrt((one @ one) * (other @ other)))
