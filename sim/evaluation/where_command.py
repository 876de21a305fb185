"""`lookback where PICTURE --map MAP`: where a single picture was taken, by its keypoints alone."""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from edge.descriptor.network import pictures_for
from edge.descriptor.normalize import normalize
from edge.descriptor.open_network import open_network
from edge.errors import MapError
from edge.feed.reader import decode_picture, read_picture
from edge.keypoints.network import KeypointNetwork
from edge.reference_map import open_map_set
from edge.reference_map.costs import CostMatcher
from edge.reference_map.keypoint_records import keypoints_of
from sim.evaluation.matched_points import verify
from sim.traverse import config_as_mapped

TRIED, SHOWN = 60, 6
"""Places that resemble it most are compared point by point, and so many are printed."""
FEWEST = 20
"""Inliers of a picture that shows a place; of 170 pictures another place had 7, and 19 at the 99th percentile."""
HEIGHT_PX = 240


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback where`."""
    parser.description = (
        "Where a single picture was taken: the places of a map with keypoints that share most points with it. Without"
        " a drive nothing else speaks for a place, so a person decides."
    )
    parser.add_argument("picture", type=Path, metavar="PICTURE", help="a file, by a camera that looks as the map's did")
    parser.add_argument("--map", type=Path, required=True, help="a map, or a folder of maps")
    about = "draw it beside the nearest places (.jpg, .png)"
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help=about)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    maps, image = open_map_set(args.map), read_picture(args.picture)
    if any(header.keypoints_key is None for header in maps.headers):
        raise MapError(f"{args.map}: no keypoints; add them with `lookback map keypoints`")
    config = config_as_mapped(maps.headers[0])
    network = open_network(config.descriptor)
    raw = network.describe(pictures_for(network.info, image, "left-right", config.descriptor.region_width))
    unit = normalize(raw[np.newaxis], *maps.statistics())
    costs = np.concatenate([CostMatcher.of(one).costs(unit)[0].min(axis=0) for one in maps.maps])
    own, found = KeypointNetwork().extract(image), []
    for place in np.argsort(costs, kind="stable")[:TRIED].tolist():
        key = maps.headers[maps.index.map_of(place)].keypoints_key
        assert key is not None
        found.append((verify(own, keypoints_of(maps.keypoints_of(place), key)).inliers, place))
    nearest = sorted(found, reverse=True)[:SHOWN]
    how = "taken near" if nearest[0][0] >= FEWEST else "shows no place for sure; with most inliers:"
    print(f"{args.picture}: {how} place {nearest[0][1]}")
    for inliers, place in nearest:
        record = maps.places[place]
        print(f"  place {place}: {inliers} inliers, {record['lat_deg']:.6f}, {record['lon_deg']:.6f}")
    if args.output:
        pictures = [decode_picture(f"place {place}", maps.thumbnail(place)) for _, place in nearest]
        scaled = [cv2.resize(one, (HEIGHT_PX * one.shape[1] // one.shape[0], HEIGHT_PX)) for one in (image, *pictures)]
        cv2.imwrite(str(args.output), np.hstack(scaled))
    return 0
