"""A road without pictures: what of it a map covers and by how much that is wrong, and how it is driven."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.geodesy import moved
from edge.reference_map.map_set import MapSet
from edge.reference_map.store import ModelKey, RegionsKey, open_map
from edge_plugins.mapping.builder import MapBuilder, Place
from sim.world.scenario import View

HOME = (-27.0, 153.0)
SPACING_M = 2.0
Points = NDArray[np.float64]


@dataclass(frozen=True)
class Stretch:
    """Meters of the road that a segment of the map covers, by how much its positions are wrong, and what it states.

    continues: it is no segment of its own, but of one with the stretch before, which ends where it begins. recording:
    that it comes from, by default one of its own. has_odometer: whether its meters were measured. whole_sigma_m: see
    `Segment`. late_m: by how much its positions, and the heading of a log with an odometer, are further
    along the road than its pictures. backward: it was driven the other way, its camera looked ahead, so the same way.
    crept: first and last meter of the road between which its GPS moved away, and by how much to the east and north.
    """

    begins_m: float
    ends_m: float
    east_m: float = 0.0
    north_m: float = 0.0
    sigma_m: float = math.sqrt(2)
    continues: bool = False
    recording: str = ""
    has_odometer: bool = False
    whole_sigma_m: float | None = 0.0
    late_m: float = 0.0
    backward: bool = False
    crept: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 0.0)

    def off_m(self, at_m: float) -> Points:
        """East and north (2,), by which a position is wrong."""
        begins_m, ends_m, east_m, north_m = self.crept
        share = min(max((at_m - begins_m) / (ends_m - begins_m), 0.0), 1.0)
        return np.array([self.east_m + share * east_m, self.north_m + share * north_m])


@dataclass(frozen=True)
class Course:
    """What is driven, and what is wrong. scale, heading_deg: of the autopilot's velocity; None draws them by seed.

    map_off_m: east and north, of the whole map; lane_m: right of the map's drive. None draws them by seed as well.
    off_at_m: where the vehicle leaves the road, and how. alias: meters of the drive during which the unmapped road
    looks like the map from `alias_from_m` on. steers: the autopilot steers by its own estimate (closed loop).
    pose_segments: those that poses are of, by chance one of them; lines are of the first that is there. late_s: by how
    much a frame is older than it says. late_rows: by how many rows of the map the keypoints of its places are late.
    """

    road_m: float = 1200.0
    stretches: tuple[Stretch, ...] = (Stretch(0.0, 1200.0),)
    scale: float | None = None
    heading_deg: float | None = None
    map_off_m: tuple[float, float] | None = None
    lane_m: float | None = None
    gps: bool = True
    off_at_m: float = math.inf
    off_how: str = ""
    alias: tuple[float, float] = (math.inf, math.inf)
    alias_from_m: float = 0.0
    steers: bool = False
    speed_mps: float = 8.0
    laps: int = 1
    poses: bool = False
    pose_segments: tuple[int, ...] = (0,)
    late_s: float = 0.0
    late_rows: int = 0


def road_line(length_m: float, rng: np.random.Generator) -> tuple[Points, Points]:
    """East and north (n, 2) of a winding road at each meter, and its headings in radians (n,)."""
    s = np.arange(0.0, length_m + 1.0)
    phase = rng.uniform(0, 2 * np.pi, 3)
    heading = phase[0] + 0.7 * np.sin(2 * np.pi * s / 520 + phase[1]) + 0.25 * np.sin(2 * np.pi * s / 170 + phase[2])
    steps = np.column_stack([np.sin(heading), np.cos(heading)])
    return np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)[:-1]]), heading


def lap_line(length_m: float, laps: int) -> tuple[Points, Points]:
    """Laps of a circle."""
    s = np.arange(0.0, length_m * laps + 1.0)
    heading = 2 * np.pi * s / length_m
    steps = np.column_stack([np.sin(heading), np.cos(heading)])
    return np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)[:-1]]), heading


def build_maps(
    path: Path, line: Points, heading: Points, stretches: tuple[Stretch, ...]
) -> tuple[MapSet, list[tuple[int, float, float, int]]]:
    """A map whose segments are those stretches; for each its first place, its first and last meter of the road."""
    raw = np.zeros((2, 4), np.float32)
    found: list[tuple[int, float, float, int]] = []
    index = 0
    key = ModelKey("test", "0" * 64, "fc6", 4), RegionsKey("left-right", 0.4)
    with MapBuilder(path, *key, SamplingConfig(), replace=True) as builder:
        for number, stretch in enumerate(stretches):
            before = found.pop() if stretch.continues else (index, stretch.begins_m, 0.0, 0)
            if not stretch.continues:
                recording = stretch.recording or f"stretch {number}"
                view: View = "front" if stretch.backward else "rear"
                whole_m = stretch.whole_sigma_m
                builder.begin_segment(recording, view, has_odometer=stretch.has_odometer, whole_sigma_m=whole_m)
            at_m = np.arange(stretch.begins_m, min(stretch.ends_m, len(line) - 1), SPACING_M)[
                :: -1 if stretch.backward else 1
            ]
            for row, s in enumerate(at_m):
                logged = min(int(s + stretch.late_m), len(line) - 1)
                course_rad = heading[
                    logged if stretch.has_odometer else int(s)
                ]  # wheels, heading, positions: of one log
                east_m, north_m = line[logged] + stretch.off_m(s)
                lat_deg, lon_deg = moved(*HOME, float(east_m), float(north_m))
                route_m = (before[3] + row) * SPACING_M
                known = (
                    index + row,
                    lat_deg,
                    lon_deg,
                    0.0,
                    math.degrees(course_rad + math.pi * stretch.backward) % 360,
                    route_m,
                )
                builder.add(raw, Place(*known, position_sigma_m=stretch.sigma_m, position_source="gps"))
            begins_m = before[1] if stretch.continues else float(at_m[0])
            found.append((before[0], begins_m, float(at_m[-1]), before[3] + len(at_m)))
            index += len(at_m)
        builder.finish()
    return MapSet.of(open_map(path)), found
