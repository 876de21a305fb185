"""How far beside the lane of its map a vehicle is seen by keypoints: in single pictures, and along a drive.

A rear camera's map by day, without and with a front camera's of the way home in its own lane; home by a front camera,
moved sideways from the lane of the first drive. A single picture, every 20 m, is compared with the local map
around the place nearest to it; a right pose is one within RIGHT_M. Along a drive the recognizer has a picture every 2
m, the odometer and the course, and nothing else; a frame is known if its pose is believed. Each drive is compared with
the next road's map as well, as one of a vehicle elsewhere.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import Config, DescriptorConfig
from edge.feed import Feed, FeedImages, read_feed
from edge.recognition.place_verification import PlaceVerification
from edge.recognition.recognizer import open_recognizer
from edge.reference_map import Drives, MapSet
from edge.sequence import KeyframeMatch, MotionPrior
from sim.research.evaluation import poses
from sim.world.scenario import LightName, Scenario

BESIDE_M, LANE_M = (0.0, 2.0, 3.0, 4.0, 5.0, 6.0), Scenario().lane_m
OUT, HOME = replace(poses.MAPPED, view="rear"), replace(poses.MAPPED, direction="reverse", drive_seed=14)
DRIVES = {"out": (OUT,), "out, home": (OUT, HOME)}
"""Of the map, by day: the way home is driven in its own lane, by a front camera."""
LIGHTS: tuple[LightName, ...] = ("night", "dusk")
SPACING_M, EVERY, RIGHT_M = 2.0, 10, 2.0
CONFIG = Config(descriptor=DescriptorConfig(model="grid"))


def rows(args: argparse.Namespace) -> Iterator[str]:
    """How far beside the lane of its map a vehicle is seen by keypoints."""
    yield "| map | light | beside | right pose, alone | known along a drive | longest gap | position | rms over sigma |"
    yield "|---" * 8 + "|"
    elsewhere = np.zeros(3, int)
    for (drives, made), light, beside_m in product(DRIVES.items(), args.light or LIGHTS, BESIDE_M):
        maps = [MapSet.of([poses.mapped(args.cache, replace(one, seed=road)) for one in made]) for road in args.seeds]
        feeds = [_recorded(args.cache, road, light, beside_m) for road in args.seeds]
        alone = np.concatenate([_pictures(*one) for one in zip(maps, feeds, strict=True)])
        along = [_along(*one) for one in zip(maps, feeds, strict=True)]
        known = np.concatenate(along)
        off = known[np.isfinite(known[:, 1])]
        gap_m = max(np.diff([*one[np.isfinite(one[:, 1]), 0], one[-1, 0]]).max() for one in along)
        far_m, ratio = np.hypot(*off[:, 1:3].T), np.sqrt(np.square(off[:, 1:3] / off[:, 3:]).mean(axis=0))
        shares = f"{(alone <= RIGHT_M).mean():.2f} | {len(off) / len(known):.2f}"
        yield (
            f"| {drives} | {light} | {beside_m:g} m | {shares} | {gap_m:.0f} m"
            f" | {np.median(far_m):.2f} / {np.percentile(far_m, 95):.2f} m | {ratio[0]:.2f}, {ratio[1]:.2f} |"
        )
        for mapped, feed in zip(maps, feeds[1:] + feeds[:1], strict=True) if len(maps) > 1 else ():
            believed = np.isfinite(_along(mapped, feed)[:, 1])
            elsewhere += (believed.sum(), np.isfinite(_pictures(mapped, feed)).sum(), len(believed))
    yield f"\nElsewhere: {elsewhere[0]} of {elsewhere[2]} frames known, {elsewhere[1]} pictures with any pose."


def _recorded(folder: Path, road: int, light: LightName, beside_m: float) -> Feed:
    made = Scenario(road, poses.LENGTH_M, direction="reverse", light=light, drive_seed=13, lane_m=beside_m - LANE_M)
    return read_feed(poses.recorded(folder / f"{road}_capture_{light}_{beside_m:g}m", made, SPACING_M))


def _pictures(map_set: MapSet, feed: Feed) -> NDArray[np.float64]:
    """What each picture's pose is off by in meters, infinite without one."""
    images, truth, found = FeedImages(feed), poses.Truth(map_set), list[float]()
    verification = PlaceVerification(CONFIG)
    verification.use_maps(map_set, Drives(map_set, SPACING_M))
    for index in range(0, len(feed.rows), EVERY):
        near = truth.near(feed.rows[index])
        seen = verification.follow(images.read(index), [near[len(near) // 2]])
        found.append(float(np.hypot(*_off(truth, feed, index, seen)[:2])) if seen else math.inf)
    images.close()
    return np.array(found)


def _along(map_set: MapSet, feed: Feed) -> NDArray[np.float64]:
    """Of each frame (n, 5): meters driven; what its pose is off by to the right and ahead, and their sigmas, or NaN."""
    recognizer = open_recognizer(CONFIG, map_set=map_set)
    images, truth, found = FeedImages(feed), poses.Truth(map_set), np.full((len(feed.rows), 5), np.nan)
    for index, row in enumerate(feed.rows):
        assert row.heading_deg is not None
        travel = MotionPrior(row.distance_m, course_rad=math.radians(row.heading_deg))
        match = recognizer.observe(images.read(index), row.stamp_ns, travel)
        found[index, 0] = row.distance_m
        if match is not None and match.accepted and match.seen is not None:
            sigmas = np.sqrt(np.diag(match.seen.covariance))
            found[index, 1:] = *_off(truth, feed, index, match.seen)[:2], *sigmas[:2]
    images.close()
    return found


def _off(truth: poses.Truth, feed: Feed, index: int, seen: KeyframeMatch) -> NDArray[np.float64]:
    return truth.off(feed.rows[index], seen.place_index, (seen.right_m, seen.ahead_m, seen.turn_rad))
