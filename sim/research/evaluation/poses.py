"""Keypoint poses on simulated roads: what single ones are off by, and how far beside its lane a vehicle is seen.

Poses of single frames, without any filter: of the five places nearest to the truth that one counts on which most points
agree. Beside the lane (`capture`): a rear camera's map by day; home by a front camera, moved sideways from the lane of
the map. A single picture, every 20 m, is compared with the local map around the place nearest to it; a right pose is
one within RIGHT_M. Along a drive the recognizer has a picture every 2 m, the odometer and the course, and nothing else;
a frame is known if its pose is believed. Each drive is compared with the next road's map as well, as one of a vehicle
elsewhere.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import Config, DescriptorConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.feed import Feed, FeedImages, FeedRow, View, read_feed
from edge.geodesy import east_north
from edge.keypoints import Keypoints
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.pose import RelativePose, pose_to_keyframe
from edge.recognition.place_verification import PlaceVerification
from edge.recognition.recognizer import open_recognizer
from edge.reference_map import Drives, MapSet, ReferenceMap, open_map
from edge.reference_map.keypoint_records import camera_of, keypoints_of, points_of
from edge.sequence import MotionPrior
from edge_plugins.mapping.keypoint_rows import keypoints_key
from sim.maps.command import build_map
from sim.world.recording import recorded
from sim.world.scenario import LightName, Scenario

LENGTH_M, QUERY_M = 300.0, 5.0
DRIVES: dict[str, tuple[View, Scenario]] = {
    "front": ("front", Scenario(drive_seed=12, lane_m=2.25)),
    "home": ("rear", Scenario(drive_seed=13, direction="reverse")),
}
"""The view of the map's camera, and the drive on it: half a meter beside, and in the lane of the way home."""
LIGHTS: tuple[LightName, ...] = ("dusk", "night", "snow")
AROUND = 2


def rows(args: argparse.Namespace) -> Iterator[str]:
    """What keypoint poses are off by, without any filter."""
    yield "| drive | with a pose | along-track | cross-track | heading | rms over sigma |"
    yield "|---" * 6 + "|"
    for drive, light in product(DRIVES, LIGHTS):
        roads = []
        for road in args.seeds:
            view, made = DRIVES[drive]
            query = recorded(replace(made, seed=road, length_m=LENGTH_M, light=light), args.cache, QUERY_M)
            roads.append(_errors(mapped(args.cache, Scenario(road, LENGTH_M), view), query))
        yield _row(f"{drive}, {light}", roads)


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


def mapped(folder: Path, road: Scenario, view: View) -> ReferenceMap:
    """The map of a road by day, with keypoints, which is made where it is not there yet."""
    feed = recorded(replace(road, view=view, drive_seed=11), folder)
    path = feed.with_name(f"{feed.name}_map")
    if not path.exists():
        key, network = partial(keypoints_key, fov_deg=Scenario().fov_deg), Network.load(Path("grid"))
        build_map([read_feed(feed)], path, DescriptorConfig(), SamplingConfig(), network=network, keypoints=key)
    return open_map(path, every_file=True)


class Truth:
    """Where a drive's frames are beside the places of a map."""

    def __init__(self, reference: ReferenceMap) -> None:
        places = reference.places
        self._origin = float(places["lat_deg"][0]), float(places["lon_deg"][0])
        self._at_m = east_north(places["lat_deg"], places["lon_deg"], self._origin)
        faces_back = np.pi * (reference.header.segments[0].view == "rear")
        self._headings = np.radians(places["heading_deg"]) + faces_back

    def near(self, row: FeedRow) -> range:
        """Places around the one nearest to a frame."""
        nearest = int(np.hypot(*(self._at_m - self._here_m(row)).T).argmin())
        return range(max(0, nearest - AROUND), min(len(self._at_m), nearest + AROUND + 1))

    def off(self, row: FeedRow, place: int, right_m: float, ahead_m: float, turn_rad: float) -> NDArray[np.float64]:
        """What a pose beside a place is off by (3,): meters right and ahead, and radians turned."""
        heading = float(self._headings[place])
        cos, sin, off_m = np.cos(heading), np.sin(heading), self._here_m(row) - self._at_m[place]
        turn = (np.radians(row.heading_deg or 0.0) - heading + np.pi) % (2 * np.pi) - np.pi
        true = np.array([off_m @ (cos, -sin), off_m @ (sin, cos), turn])
        return np.asarray(np.array([right_m, ahead_m, turn_rad]) - true)

    def _here_m(self, row: FeedRow) -> NDArray[np.float64]:
        return np.asarray(east_north(np.array([row.lat_deg], float), np.array([row.lon_deg], float), self._origin)[0])


def _errors(reference: ReferenceMap, query: Path) -> tuple[NDArray[np.float64], int]:
    """What poses are off by and their sigmas (n, 2, 3): right, ahead, turned; and how many frames there were."""
    network, feed, truth = KeypointNetwork(), read_feed(query), Truth(reference)
    images, found = FeedImages(feed), []
    for index, row in enumerate(feed.rows):
        keypoints = network.extract(images.read(index))
        poses = [(pose, place) for place in truth.near(row) if (pose := _pose(reference, place, keypoints)) is not None]
        if poses:
            pose, place = max(poses, key=lambda one: one[0].inliers)
            off = truth.off(row, place, pose.right_m, pose.ahead_m, pose.turn_rad)
            found.append((off, np.sqrt(np.diag(pose.covariance))))
    images.close()
    return np.array(found), len(feed.rows)


def _pose(reference: ReferenceMap, place: int, keypoints: Keypoints) -> RelativePose | None:
    key, records = reference.header.keypoints_key, reference.keypoints
    assert key is not None
    assert records is not None
    return pose_to_keyframe(keypoints, keypoints_of(records[place], key), points_of(records[place]), camera_of(key))


DARK: tuple[LightName, ...] = ("night", "dusk")
BESIDE_M, LANE_M = (0.0, 2.0, 3.0, 4.0, 5.0, 6.0), Scenario().lane_m
SPACING_M, EVERY, RIGHT_M = 2.0, 10, 2.0
CONFIG = Config(descriptor=DescriptorConfig(model="grid"))


def capture(args: argparse.Namespace) -> Iterator[str]:
    """How far beside the lane of its map a vehicle is seen by keypoints."""
    yield "| light | beside | right pose, alone | known along a drive | longest gap | position | rms over sigma |"
    yield "|---" * 7 + "|"
    roads = [Scenario(road, LENGTH_M) for road in args.seeds]
    maps = [mapped(args.cache, road, "rear") for road in roads]
    elsewhere = np.zeros(3, int)
    for light, beside_m in product(DARK, BESIDE_M):
        home = {"direction": "reverse", "light": light, "drive_seed": 13, "lane_m": beside_m - LANE_M}
        drives = [Scenario(road, LENGTH_M, **home) for road in args.seeds]  # type: ignore[arg-type]  # keys by name
        feeds = [read_feed(recorded(one, args.cache, SPACING_M)) for one in drives]
        alone = np.concatenate([_pictures(*one) for one in zip(maps, feeds, strict=True)])
        along = [_along(*one) for one in zip(maps, feeds, strict=True)]
        known = np.concatenate(along)
        off = known[np.isfinite(known[:, 1])]
        gap_m = max(np.diff([*one[np.isfinite(one[:, 1]), 0], one[-1, 0]]).max() for one in along)
        far_m, ratio = np.hypot(*off[:, 1:3].T), np.sqrt(np.square(off[:, 1:3] / off[:, 3:]).mean(axis=0))
        shares = f"{(alone <= RIGHT_M).mean():.2f} | {len(off) / len(known):.2f}"
        yield (
            f"| {light} | {beside_m:g} m | {shares} | {gap_m:.0f} m"
            f" | {np.median(far_m):.2f} / {np.percentile(far_m, 95):.2f} m | {ratio[0]:.2f}, {ratio[1]:.2f} |"
        )
        for of, feed in zip(maps, feeds[1:] + feeds[:1], strict=True) if len(maps) > 1 else ():
            believed = np.isfinite(_along(of, feed)[:, 1])
            elsewhere += believed.sum(), np.isfinite(_pictures(of, feed)).sum(), len(believed)
    yield f"\nElsewhere: {elsewhere[0]} of {elsewhere[2]} frames known, {elsewhere[1]} pictures with any pose."


def _pictures(of: ReferenceMap, feed: Feed) -> NDArray[np.float64]:
    """What each picture's pose is off by in meters, infinite without one."""
    map_set, images, truth = MapSet.of(of), FeedImages(feed), Truth(of)
    verification = PlaceVerification(CONFIG)
    verification.use_maps(map_set, Drives(map_set, SPACING_M))
    found = []
    for index in range(0, len(feed.rows), EVERY):
        row, near = feed.rows[index], truth.near(feed.rows[index])
        seen = verification.follow(images.read(index), [near[len(near) // 2]])
        off = truth.off(row, seen.place_index, seen.right_m, seen.ahead_m, seen.turn_rad) if seen else [np.inf] * 2
        found.append(np.hypot(*off[:2]))
    images.close()
    return np.array(found)


def _along(of: ReferenceMap, feed: Feed) -> NDArray[np.float64]:
    """Of each frame (n, 5): meters driven; what its pose is off by to the right and ahead, and their sigmas, or NaN."""
    recognizer = open_recognizer(CONFIG, map_set=MapSet.of(of))
    images, truth, found = FeedImages(feed), Truth(of), np.full((len(feed.rows), 5), np.nan)
    for index, row in enumerate(feed.rows):
        travel = MotionPrior(row.distance_m, course_rad=math.radians(row.heading_deg or 0.0))
        match = recognizer.observe(images.read(index), row.stamp_ns, travel)
        found[index, 0] = row.distance_m
        if match is not None and match.accepted and (seen := match.seen) is not None:
            off = truth.off(row, seen.place_index, seen.right_m, seen.ahead_m, seen.turn_rad)
            found[index, 1:] = *off[:2], *np.sqrt(np.diag(seen.covariance))[:2]
    images.close()
    return found
