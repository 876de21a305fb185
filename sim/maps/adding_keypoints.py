"""`lookback map keypoints`: give a map keypoints from the recordings that it was made of."""

from __future__ import annotations

import argparse
import logging
import shutil
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from edge.camera.preprocessing import preprocessed_feed
from edge.config import CameraConfig, Config, load_config
from edge.errors import ConfigError, MapError
from edge.feed import Feed, FeedImages
from edge.files import AtomicFolder
from edge.keypoints.lens import DriveKeypoints
from edge.keypoints.network import KeypointNetwork
from edge.reference_map import ReferenceMap, open_map
from edge.reference_map.checksums import FileKey, sha256_of
from edge.reference_map.keypoint_file import KeypointsKey
from edge.reference_map.store import HEADER, KEYPOINTS, PLACES, encode_header
from edge_plugins.mapping.keypoint_rows import (
    ASSUMED,
    ASSUMED_DEG,
    ASSUMED_FOCAL_SIGMA,
    KeyOf,
    KeypointRows,
    keypoints_key,
)
from sim.datasets import USUAL_FOV
from sim.datasets.found import open_recording
from sim.maps.known_distances import spell_distances
from sim.output import checked_option
from sim.traverse import driven_m, with_course

log = logging.getLogger(__name__)

WHERE = "set [camera] fov_deg in a config and name it by --config, or use --fov-deg"
CHANGED = (PLACES, KEYPOINTS)
"""Files of a map."""


def add_fov_option(parser: argparse.ArgumentParser) -> None:
    """Of the pictures."""
    about = "horizontal field of view of the pictures in degrees, in place of the recording's own; keypoints need it"
    parser.add_argument("--fov-deg", type=float, metavar="DEG", help=about)


def camera_from(args: argparse.Namespace, camera: CameraConfig) -> CameraConfig:
    """[camera] with the field of view of the option. ConfigError where both say it, or it is out of range."""
    if args.fov_deg is None:
        return camera
    if camera.fov_deg is not UNSET:
        raise ConfigError(f"--fov-deg: {args.config} has [camera] fov_deg = {camera.fov_deg:g}; remove one of the two")
    return checked_option(camera, "--fov-deg", fov_deg=args.fov_deg)


def key_of_feeds(feeds: Sequence[Feed]) -> KeyOf | None:
    """Of a new map by the field of view and the lens that all recordings have, `ASSUMED` where none says it.

    None: nor does any say where it was driven, so that no point has a distance. MapError for several.
    """
    found = {(feed.header.fov_deg, feed.header.alone) for feed in feeds}
    if len(found) > 1:
        spelled = ", ".join(f"{feed.path}: {feed.header.fov_deg or 'not known'}" for feed in feeds)
        what = "field of view" if len({fov_deg for fov_deg, _ in found}) > 1 else "lens"
        raise MapError(f"a map with keypoints has one {what}; build several maps, or use {WHERE} ({spelled})")
    ((fov_deg, lens),) = found
    if fov_deg is not None:
        return partial(keypoints_key, fov_deg=fov_deg, lens=lens)
    if all(driven_m(feed) is None for feed in feeds):
        return None
    log.warning("%s: its field of view is %s: --fov-deg DEG (%s)", feeds[0].header.name, ASSUMED, USUAL_FOV)
    return partial(keypoints_key, fov_deg=ASSUMED_DEG, focal_sigma=ASSUMED_FOCAL_SIGMA)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback map keypoints`."""
    parser.add_argument("map", type=Path, metavar="MAP", help="the map's folder")
    parser.add_argument("feeds", nargs="+", type=Path, metavar="FEED", help="the recordings that it was made of")
    parser.add_argument(
        "--config", type=Path, help="read fov_deg, lens, flip, crop and mask of [camera] from this file"
    )
    add_fov_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """The command."""
    camera = camera_from(args, (load_config(args.config) if args.config else Config()).camera)
    feeds = [preprocessed_feed(open_recording(path), camera) for path in args.feeds]
    key_of = key_of_feeds(feeds)
    if key_of is None:
        raise ConfigError(f"{args.map}: without positions or distances, keypoints need a field of view; {WHERE}")
    key = add_keypoints(open_map(args.map, every_file=True), feeds, key_of)
    print(
        f"{args.map}: {key.most} keypoints of each place, {key.place_bytes / 1e3:.1f} kB, for {key.fov_deg:g} degrees"
    )
    for line in spell_distances(open_map(args.map)):
        print(f"{args.map}: {line}")
    return 0


def add_keypoints(reference_map: ReferenceMap, feeds: list[Feed], key_of: KeyOf) -> KeypointsKey:
    """Write the map anew with keypoints of all places, in place of those that it has. MapError.

    feeds: all that its drives were made of, by their names.
    """
    path, header = reference_map.path, reference_map.header
    by_name = {feed.header.name: feed for feed in feeds}
    missing = [one.source for one in header.segments if one.source not in by_name]
    if missing:
        raise MapError(f"{path}: its drive {missing[0]} is of none of these recordings; name all that it was made of")
    with AtomicFolder(path) as new:
        for name in header.files.keys() - {*CHANGED}:
            shutil.copyfile(path / name, new.path / name)
        rows, extract = KeypointRows(new.path / KEYPOINTS, key_of), KeypointNetwork().extract
        places, segments = reference_map.places.copy(), list(header.segments)
        for number, segment in enumerate(segments):
            own, feed = places[segment.start : segment.end], by_name[segment.source]
            finder = DriveKeypoints(extract)
            for image in _pictures(feed, own["row"]):
                rows.add(*finder.add(image))
            rows.add(*finder.rest())
            moved = with_course(feed)
            if moved.header.heading_is_course and np.isnan(own["heading_deg"]).all():
                # A map of an earlier version, which had no use for a heading.
                own["heading_deg"] = [moved.rows[row].heading_deg for row in own["row"]]
                segments[number] = msgspec.structs.replace(segment, heading_is_course=True)
        key = rows.finish(places, segments)
        (new.path / PLACES).write_bytes(places.tobytes())
        files = {
            **header.files,
            **{name: FileKey((new.path / name).stat().st_size, sha256_of(new.path / name)) for name in CHANGED},
        }
        made = msgspec.structs.replace(
            header.with_keypoints(key), segments=tuple(segments), files=files, header_sha256=""
        )
        (new.path / HEADER).write_bytes(encode_header(made))
        new.put_in_place()
    return key


def _pictures(feed: Feed, rows: NDArray[np.int32]) -> Iterator[NDArray[np.uint8]]:
    if rows.max() >= len(feed.rows):
        raise MapError(
            f"{feed.path}: {len(feed.rows)} pictures, but the map has its picture {rows.max()}; another drive?"
        )
    images = FeedImages(feed)
    try:
        for row in rows.tolist():
            yield images.read(row)
    finally:
        images.close()
