"""One keypoint pose on a map, on simulated roads, as the tables of docs/keypoints.md: poses, or what is believed.

Poses: one frame each, without any filter: of the five places nearest to the truth the one on which most points agree.
What is believed: see `keyframes`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge import __version__
from edge.config import DescriptorConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.feed import FeedImages, FeedRow, View, read_feed
from edge.geodesy import east_north
from edge.keypoints import Keypoints
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.pose import RelativePose, pose_to_keyframe
from edge.reference_map import MapSet, ReferenceMap, open_map
from edge.reference_map.keypoint_records import camera_of, keypoints_of, points_of
from edge_plugins.mapping.keypoint_rows import keypoints_key
from sim.maps.command import build_map
from sim.research.evaluation import keyframes
from sim.world.recording import record_drive
from sim.world.scenario import LightName, Scenario

LENGTH_M, QUERY_M = 300.0, 5.0
MAPPED = Scenario(length_m=LENGTH_M, drive_seed=11)
DRIVES: dict[str, tuple[View, Scenario]] = {
    "front": ("front", Scenario(length_m=LENGTH_M, drive_seed=12, lane_m=2.25)),
    "home": ("rear", Scenario(length_m=LENGTH_M, drive_seed=13, direction="reverse")),
}
"""The view of the map's camera, and the drive on it: half a meter beside, and in the lane of the way home."""
LIGHTS: tuple[LightName, ...] = ("dusk", "night", "snow")
ALL_LIGHTS = sorted({*LIGHTS, *(light for some in keyframes.LIGHTS.values() for light in some)})
AROUND = 2
DRAWS = 100
"""Between the seeds of two draws of a drive: of its speed, other cars, lit windows and noise."""


def rows(args: argparse.Namespace) -> Iterator[str]:
    """What keypoint poses are off by, without any filter."""
    mounts = Mounting(*args.map_mounted), Mounting(*args.mounted)
    yield "| drive | with a pose | along-track | cross-track | heading | rms over sigma |"
    yield "|---" * 6 + "|"
    for drive, light in product(DRIVES, args.light or LIGHTS):
        yield _row(f"{drive}, {light}", [_of_road(args.cache, drive, light, road, *mounts) for road in args.seeds])


def keyframes_on_map(args: argparse.Namespace) -> Iterator[str]:
    """What the recognizer believes, with keypoints and without."""
    yield from _tables(args, args.draws).on_map(args.light)


def keyframes_off_map(args: argparse.Namespace) -> Iterator[str]:
    """What it believes where no place is right."""
    yield from _tables(args, 1).off_map()


def keyframes_on_streets(args: argparse.Namespace) -> Iterator[str]:
    """What it believes on straight streets built alike."""
    seeds = " ".join(map(str, args.seeds))
    yield f"`python -m sim.research.evaluation streets --seeds {seeds} --draws {args.draws}` of version {__version__}:"
    yield ""
    yield from keyframes.on_streets(
        {repeats_m: _tables(args, args.draws, repeats_m) for repeats_m in keyframes.REPEATS_M}
    )


def _tables(args: argparse.Namespace, draws: int, repeats_m: float = 0) -> keyframes.Tables:
    """draws: drives of each light on each road."""
    drives = [partial(_long, args.cache, Mounting(*args.mounted), repeats_m, draw) for draw in range(draws)]
    return keyframes.Tables(args.seeds, partial(_long_map, args.cache, Mounting(*args.map_mounted), repeats_m), drives)


def _long(
    folder: Path, mounted: Mounting, repeats_m: float, draw: int, road: int, drive: str, light: LightName
) -> Path:
    road_of = {"seed": road, "length_m": keyframes.LENGTH_M, "repeats_m": repeats_m}
    made = mounted.of(replace(DRIVES[drive][1], light=light, **road_of))
    name = f"{_named(road, repeats_m)}_{keyframes.LENGTH_M:g}m_{drive}_{light}{mounted.name}" + f"_draw{draw}" * bool(
        draw
    )
    return recorded(folder / name, replace(made, drive_seed=made.drive_seed + DRAWS * draw), keyframes.SPACING_M)


def _long_map(folder: Path, mounted: Mounting, repeats_m: float, road: int, view: View) -> ReferenceMap:
    made = replace(MAPPED, seed=road, length_m=keyframes.LENGTH_M, repeats_m=repeats_m, view=view)
    return mapped(folder, mounted.of(made))


def _named(road: int, repeats_m: float) -> str:
    """A road, and after how much its houses repeat, if they do."""
    return f"{road}_each{repeats_m:g}" if repeats_m else str(road)


class Mounting(NamedTuple):
    """Degrees by which a camera looks down, and to the right."""

    down_deg: float
    right_deg: float

    @property
    def name(self) -> str:
        """Of what is made by it; "" for a camera that looks level along the road."""
        return f"_{self.down_deg:g}_{self.right_deg:g}" if any(self) else ""

    def of(self, scenario: Scenario) -> Scenario:
        """With a camera that is mounted so."""
        return replace(scenario, camera_down_deg=self.down_deg, camera_right_deg=self.right_deg)


def _row(name: str, roads: Sequence[tuple[NDArray[np.float64], int]]) -> str:
    """Frames of all roads together, and each figure of the road on which it is worst. roads: as `_errors`."""
    worst, rms = [], []
    for off, _ in roads:
        size = np.abs(off[:, 0, [1, 0, 2]]) * (1, 1, np.degrees(1))
        worst.append(np.percentile(size, (50, 95), axis=0).T)
        rms.append(np.sqrt(np.square(off[:, 0] / off[:, 1]).mean(axis=0))[[1, 0, 2]])
    units = zip(np.max(worst, axis=0), ("m", "m", "deg"), strict=True)
    spelled = [f"{median:.2f} / {nearly:.2f} {unit}" for (median, nearly), unit in units]
    spelled.append(", ".join(f"{one:.2f}" for one in np.max(rms, axis=0)))
    posed, frames = sum(len(off) for off, _ in roads), sum(count for _, count in roads)
    return f"| {name} | {posed} of {frames} | {' | '.join(spelled)} |"


def _of_road(
    folder: Path, drive: str, light: LightName, road: int, of_map: Mounting, mounted: Mounting
) -> tuple[NDArray[np.float64], int]:
    """Of the vehicle's poses, not the camera's; as `_errors`."""
    view, made = DRIVES[drive]
    reference = mapped(folder, of_map.of(replace(MAPPED, seed=road, view=view)))
    scenario = mounted.of(replace(made, seed=road, light=light))
    off, count = _errors(reference, recorded(folder / f"{road}_{drive}_{light}{mounted.name}", scenario, QUERY_M))
    off[:, 0, 2] -= np.radians(mounted.right_deg)
    return off, count


def recorded(path: Path, scenario: Scenario, spacing_m: float) -> Path:
    """The folder of a drive, which is recorded where it is not there yet."""
    if not path.exists():
        record_drive(scenario, path, spacing_m=spacing_m)
    return path


def mapped(folder: Path, made: Scenario) -> ReferenceMap:
    """The map of a drive, which is made where it is not there yet."""
    mounted = Mounting(made.camera_down_deg, made.camera_right_deg)
    way = "_home" if made.direction == "reverse" else ""
    name = f"{_named(made.seed, made.repeats_m)}_{made.length_m:g}m_{made.view}{way}{mounted.name}"
    path = folder / f"{name}_map"
    if not path.exists():
        feed = recorded(folder / name, made, 2.0)
        key, network = partial(keypoints_key, fov_deg=Scenario().fov_deg), Network.load(Path("grid"))
        build_map([read_feed(feed)], path, DescriptorConfig(), SamplingConfig(), network=network, keypoints=key)
    return open_map(path, every_file=True)


class Truth:
    """Where a drive's frames are beside the places of some maps."""

    def __init__(self, maps: MapSet) -> None:
        self._places = places = maps.places
        self._origin = (float(places["lat_deg"][0]), float(places["lon_deg"][0]))
        self._at_m = east_north(places["lat_deg"], places["lon_deg"], self._origin)
        index = maps.index
        faces_back = [index.view(index.segment_of(place)) == "rear" for place in range(len(places))]
        self._headings = np.radians(places["heading_deg"]) + np.pi * np.array(faces_back)

    def near(self, row: FeedRow) -> range:
        """Places around the one nearest to a frame."""
        nearest = int(np.hypot(*(self._at_m - self._here(row)).T).argmin())
        return range(max(0, nearest - AROUND), min(len(self._places), nearest + AROUND + 1))

    def off(self, row: FeedRow, place: int, pose: tuple[float, float, float]) -> NDArray[np.float64]:
        """What a pose beside a place is off by (3,): all in meters right and ahead, and radians turned."""
        assert row.heading_deg is not None
        heading = float(self._headings[place])
        right, ahead = _turned(self._here(row) - self._at_m[place], heading)
        turn = (np.radians(row.heading_deg) - heading + np.pi) % (2 * np.pi) - np.pi
        return np.asarray(np.array(pose) - np.array([right, ahead, turn]))

    def _here(self, row: FeedRow) -> NDArray[np.float64]:
        assert row.lat_deg is not None
        assert row.lon_deg is not None
        (here,) = east_north(np.array([row.lat_deg]), np.array([row.lon_deg]), self._origin)
        return np.asarray(here)


def _errors(reference: ReferenceMap, query: Path) -> tuple[NDArray[np.float64], int]:
    """What poses are off by and their sigmas (n, 2, 3): right, ahead, turned; and how many frames there were."""
    network, feed, where = KeypointNetwork(), read_feed(query), Truth(MapSet.of(reference))
    images = FeedImages(feed)
    found = []
    for index, row in enumerate(feed.rows):
        keypoints = network.extract(images.read(index))
        poses = [(pose, place) for place in where.near(row) if (pose := _pose(reference, place, keypoints)) is not None]
        if poses:
            pose, place = max(poses, key=lambda one: one[0].inliers)
            off = where.off(row, place, (pose.right_m, pose.ahead_m, pose.turn_rad))
            found.append((off, np.sqrt(np.diag(pose.covariance))))
    images.close()
    return np.array(found), len(feed.rows)


def _pose(reference: ReferenceMap, place: int, keypoints: Keypoints) -> RelativePose | None:
    key, records = reference.header.keypoints_key, reference.keypoints
    assert key is not None
    assert records is not None
    return pose_to_keyframe(keypoints, keypoints_of(records[place], key), points_of(records[place]), camera_of(key))


def _turned(moved_m: NDArray[np.float64], heading: float) -> tuple[float, float]:
    """East and north as right and ahead."""
    cos, sin = np.cos(heading), np.sin(heading)
    return float(moved_m @ (cos, -sin)), float(moved_m @ (sin, cos))
