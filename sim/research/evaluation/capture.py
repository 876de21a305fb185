"""How far beside the lane of its map a vehicle is seen by keypoints: in single pictures, and along a drive.

A rear camera's map by day, without and with a front camera's of the way home in its own lane; home by a front camera,
moved sideways from the lane of the first drive, below zero away from the other lane, at last turned. A single picture,
every 20 m, is compared with the local map around the place nearest to it; a right pose is one within RIGHT_M. Along a
drive the recognizer has a picture every 2 m, the odometer and the course, and nothing else; a frame is known if its
pose is believed. Each drive is compared with the next road's map of both ways as well, as one of a vehicle elsewhere.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from itertools import product

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.config import Config, DescriptorConfig
from edge.feed import Feed, FeedImages, read_feed
from edge.recognition.place_verification import PlaceVerification
from edge.recognition.recognizer import open_recognizer
from edge.reference_map import Drives, MapSet
from edge.sequence import MotionPrior
from sim.research.evaluation.poses import LENGTH_M, Truth, mapped
from sim.world.recording import recorded
from sim.world.scenario import LightName, Scenario

LANE_M = Scenario().lane_m
BESIDE = *((float(beside_m), 0.0) for beside_m in (-5, -3, 0, 3, 4, 5, 6, 8)), (5.0, 10.0), (5.0, -10.0)
"""Meters beside the lane, and degrees by which the camera is turned to the right."""
DRIVES = {"out": 1, "out, home": 2}
"""Of the map, by day: the way home is driven in its own lane, by a front camera."""
LIGHTS: tuple[LightName, ...] = ("night", "dusk")
SPACING_M, EVERY, RIGHT_M = 2.0, 10, 2.0
CONFIG = Config(descriptor=DescriptorConfig(model="grid"))


def rows(args: argparse.Namespace) -> Iterator[str]:
    """How far beside the lane of its map a vehicle is seen by keypoints."""
    yield (
        "| map | light | beside | turned | right pose, alone | known along a drive | longest gap | position"
        " | rms over sigma |"
    )
    yield "|---" * 9 + "|"
    roads = [Scenario(road, LENGTH_M) for road in args.seeds]
    out = [mapped(args.cache, road, "rear") for road in roads]
    back = [mapped(args.cache, road, "front", direction="reverse", drive_seed=14) for road in roads]
    elsewhere = np.zeros(3, int)
    for (drives_of, count), light, (beside_m, turned_deg) in product(DRIVES.items(), LIGHTS, BESIDE):
        maps = [MapSet.of(both[:count]) for both in zip(out, back, strict=True)]
        way = {"direction": "reverse", "lane_m": beside_m - LANE_M, "camera_right_deg": turned_deg}
        home = Scenario(length_m=LENGTH_M, light=light, drive_seed=13, **way)  # type: ignore[arg-type]  # keys by name
        drives = [replace(home, seed=road) for road in args.seeds]
        feeds = [read_feed(recorded(one, args.cache, SPACING_M)) for one in drives]
        alone = np.concatenate([_pictures(*one) for one in zip(maps, feeds, strict=True)])
        along = [_along(*one) for one in zip(maps, feeds, strict=True)]
        known = np.concatenate(along)
        off = known[np.isfinite(known[:, 1])]
        gap_m = max(np.diff([*one[np.isfinite(one[:, 1]), 0], one[-1, 0]]).max() for one in along)
        far_m, ratio = np.hypot(*off[:, 1:3].T), np.sqrt(np.square(off[:, 1:3] / off[:, 3:]).mean(axis=0))
        shares = f"{(alone <= RIGHT_M).mean():.2f} | {len(off) / len(known):.2f}"
        yield (
            f"| {drives_of} | {light} | {beside_m:g} m | {turned_deg:g} deg | {shares} | {gap_m:.0f} m"
            f" | {np.median(far_m):.2f} / {np.percentile(far_m, 95):.2f} m | {ratio[0]:.2f}, {ratio[1]:.2f} |"
        )
        for of, feed in zip(maps, feeds[1:] + feeds[:1], strict=True) if len(maps) > 1 and count > 1 else ():
            believed = np.isfinite(_along(of, feed)[:, 1])
            elsewhere += believed.sum(), np.isfinite(_pictures(of, feed)).sum(), len(believed)
    yield f"\nElsewhere: {elsewhere[0]} of {elsewhere[2]} frames known, {elsewhere[1]} pictures with any pose."


def _pictures(map_set: MapSet, feed: Feed) -> NDArray[np.float64]:
    """What each picture's pose is off by in meters, infinite without one."""
    images, truth = FeedImages(feed), Truth(map_set)
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


def _along(map_set: MapSet, feed: Feed) -> NDArray[np.float64]:
    """Of each frame (n, 5): meters driven; what its pose is off by to the right and ahead, and their sigmas, or NaN."""
    recognizer = open_recognizer(CONFIG, map_set=map_set)
    images, truth, found = FeedImages(feed), Truth(map_set), np.full((len(feed.rows), 5), np.nan)
    for index, row in enumerate(feed.rows):
        travel = MotionPrior(row.distance_m, course_rad=math.radians(row.heading_deg or 0.0))
        match = recognizer.observe(images.read(index), row.stamp_ns, travel)
        found[index, 0] = row.distance_m
        if match is not None and match.accepted and (seen := match.seen) is not None:
            off = truth.off(row, seen.place_index, seen.right_m, seen.ahead_m, seen.turn_rad)
            found[index, 1:] = *off[:2], *np.sqrt(np.diag(seen.covariance))[:2]
    images.close()
    return found
