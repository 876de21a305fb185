"""`lookback map`: build, inspect, list, split and sign reference maps."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from edge.camera.preprocessing import preprocessed_feed
from edge.commands.parser import fill_all
from edge.config import FIRST_NETWORK, Config, DescriptorConfig, SamplingConfig, load_config
from edge.descriptor.model_file import network_of_map
from edge.descriptor.network import Network
from edge.descriptor.open_network import open_network
from edge.errors import ConfigError, MapError
from edge.feed import Feed, FeedOptions
from edge.geodesy import POSITION_SOURCES
from edge.recognition.recognizer import model_key
from edge.reference_map.store import MapHeader, ReferenceMap, RegionsKey, open_map
from edge_plugins.mapping.builder import MapBuilder, Place
from edge_plugins.mapping.keypoint_rows import KeyOf, keypoints_key
from sim.datasets.found import open_recording
from sim.maps import adding_keypoints, export, layers
from sim.maps import files as map_files
from sim.maps.adding_keypoints import add_fov_option, camera_from, key_of_feeds
from sim.maps.describing import MEASURED, Work, add_by_cluster, add_feed
from sim.maps.known_distances import spell_distances
from sim.maps.shrinking import shrink_to
from sim.output import checked_option
from sim.traverse import driven_m


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback map`."""
    actions = parser.add_subparsers(required=True)

    build = actions.add_parser("build", help="build a map from feeds; each feed becomes a segment")
    build.add_argument("feeds", nargs="+", type=Path, metavar="FEED", help="a feed, MCAP file, video or log")
    build.add_argument("-o", "--output", type=Path, required=True, metavar="MAP", help="folder of the new map")
    about = "read [descriptor] and [sampling] from this file, and fov_deg, lens, flip, crop and mask of [camera]"
    build.add_argument("--config", type=Path, help=about)
    add_spacing_options(build)
    add_feed_options(build)
    build.add_argument(
        "--dimensions", type=int, metavar="D", help="reduce descriptors of regions to D dimensions (PCA)"
    )
    build.add_argument("--no-keypoints", action="store_true", help="without keypoints, 22.8 kB of each place")
    add_fov_option(build)
    build.add_argument("--cluster", metavar="ADDRESS", help="let the workers of a dask scheduler describe the feeds")
    build.add_argument("--replace", action="store_true", help="replace an existing map atomically")
    build.set_defaults(run=run_build)

    extend = actions.add_parser("extend", help="add feeds to a map and normalize all of its descriptors again")
    extend.add_argument("map", type=Path, metavar="MAP", help="the map's folder")
    extend.add_argument("feeds", nargs="+", type=Path, metavar="FEED", help="a feed, MCAP file, video or log")
    extend.add_argument("--model", type=Path, help="the network that the map was made with, unless it is grid or fc6")
    extend.set_defaults(run=_extend)

    about = "give a map keypoints, by the recordings that it was made of"
    adding_keypoints.add_arguments(actions.add_parser("keypoints", help=about))
    map_files.add_actions(actions)
    layers.add_actions(actions)
    export.add_arguments(actions)
    fill_all(actions, {"coverage": "sim.coverage.command"})


def add_spacing_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose frames; at most one of them."""
    spacing = parser.add_mutually_exclusive_group()
    spacing.add_argument("--spacing-m", type=float, metavar="M", help="use one frame every M meters")
    spacing.add_argument("--spacing-frames", type=int, metavar="N", help="use every Nth frame")
    spacing.add_argument("--interval-s", type=float, metavar="S", help="use one frame every S seconds")


def add_feed_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for recordings that do not say all that a feed says."""
    about = "video of a log (.tlog, .bin, .ulg); default: the video of the same name"
    parser.add_argument("--video", type=Path, metavar="FILE", help=about)
    about = "seconds from the log's first position to the video's first frame (default: by what both show)"
    parser.add_argument("--offset-s", type=float, metavar="S", help=about)
    parser.add_argument("--view", choices=("front", "rear"), help="where the camera of a video looked (default front)")


def feed_options(args: argparse.Namespace) -> FeedOptions:
    """What the options say. ConfigError if a value is out of range."""
    if args.offset_s is not None and not np.isfinite(args.offset_s):
        raise ConfigError(f"--offset-s: {args.offset_s} is not a number of seconds")
    return FeedOptions(args.view, args.video, args.offset_s)


def sampling_from(args: argparse.Namespace, otherwise: SamplingConfig) -> SamplingConfig:
    """The sampling that the options ask for, or `otherwise`. ConfigError if a value is out of range."""
    if args.spacing_m is not None:
        return checked_option(otherwise, "--spacing-m", by="distance", spacing_m=args.spacing_m)
    if args.spacing_frames is not None:
        return checked_option(otherwise, "--spacing-frames", by="frames", spacing_frames=args.spacing_frames)
    if args.interval_s is not None:
        return checked_option(otherwise, "--interval-s", by="time", interval_s=args.interval_s)
    return otherwise


def build_map(
    feeds: list[Feed],
    output: Path,
    descriptor: DescriptorConfig,
    sampling: SamplingConfig,
    *,
    must_have_distance: bool = False,
    dimensions: int | None = None,
    replace: bool = False,
    network: Network | None = None,
    keypoints: KeyOf | None = None,
    keeps_pictures: bool = True,
    describe: Callable[[MapBuilder, Network], None] | None = None,
) -> MapHeader:
    """Describe every chosen frame of the feeds and write the map at `output`, shrunk to so many `dimensions`.

    network: instead of the one that `descriptor` names. keypoints: the key of a map that has them. keeps_pictures:
    small ones of places. describe: adds the feeds to the map instead.
    """
    network = network or open_network(descriptor)
    regions = RegionsKey.of(descriptor)
    if dimensions is not None and not 1 <= dimensions <= network.info.dimensions:
        raise ConfigError(f"--dimensions: {dimensions} is not between 1 and the network's {network.info.dimensions}")
    key = model_key(network)
    shrink = shrink_to(dimensions or network.info.dimensions, network.info.dimensions)
    of_map = key, regions, sampling
    with MapBuilder(
        output, *of_map, shrink=shrink, replace=replace, keypoints=keypoints, keeps_pictures=keeps_pictures
    ) as builder:
        if describe is not None:
            describe(builder, network)
        for feed in feeds if describe is None else ():
            add_feed(builder, feed, network, regions, sampling, must_have_distance=must_have_distance)
        header = builder.finish()
        _print_unused(builder)
        return header


def _print_unused(builder: MapBuilder) -> None:
    for why, count in builder.unused.items():
        print(f"{count} positions are not used, since they {why}; their places are recognized, without a position")


def add_map(builder: MapBuilder, other: ReferenceMap) -> None:
    """Add all places of a map of the same model and regions, with segments and raw descriptors, as if driven again."""
    raw, records, key = other.raw(), other.places, other.header.keypoints_key
    for segment in other.header.segments:
        builder.begin_segment(
            segment.source,
            segment.view,
            has_odometer=segment.moved_as_driven,
            whole_sigma_m=segment.whole_sigma_m,
            heading_is_course=segment.heading_is_course,
        )
        for index in range(segment.start, segment.end):
            known = {name: records[name][index].item() for name in ("row", "route_m", *MEASURED)}
            source = POSITION_SOURCES[records["position_source"][index]]
            place = Place(**known, thumbnail=other.thumbnail(index), position_source=source)
            builder.add(raw[index].astype(np.float32), place)
            if builder.keypoints is not None and other.keypoints is not None and key is not None:
                builder.keypoints.add_record(other.keypoints[index], key)


def run_build(args: argparse.Namespace, network: Network | None = None) -> int:
    """The command `map build`; network: in place of the one that its config names."""
    config = load_config(args.config) if args.config else Config(descriptor=DescriptorConfig(model=FIRST_NETWORK))
    descriptor = config.descriptor
    sampling = sampling_from(args, config.sampling)
    if args.video is not None and len(args.feeds) > 1:
        raise ConfigError(
            "--video is for one log; with several, name each video like its log (a.tlog, a.mp4) and omit --video"
        )
    if args.output.exists() and not args.replace:
        raise MapError(f"{args.output}: already exists; remove it, name another folder, or --replace")
    camera = camera_from(args, config.camera)
    feeds = [preprocessed_feed(open_recording(path, feed_options(args)), camera) for path in args.feeds]
    is_metric = args.spacing_m is not None
    if sampling.by == "distance" and not is_metric:
        every = f"no distances or positions in it, so there is a place every {sampling.interval_s:g} s"
        for feed in feeds:
            if driven_m(feed) is None:
                print(f"{feed.path}: {every}")
    keypoints, describe = None if args.no_keypoints else key_of_feeds(feeds), None
    if args.cluster:
        settings = msgspec.structs.replace(config, descriptor=descriptor, camera=camera)
        work = Work(settings, feed_options(args), sampling, is_metric, keypoints is not None)
        describe = partial(add_by_cluster, paths=args.feeds, work=work, address=args.cluster)
    options = {"must_have_distance": is_metric, "dimensions": args.dimensions, "replace": args.replace}
    options["keeps_pictures"] = camera.keep_pictures
    made_by = args.output, descriptor, sampling
    header = build_map(feeds, *made_by, **options, network=network, keypoints=keypoints, describe=describe)
    print(f"{args.output}: {header.places} places in {len(header.segments)} segment(s)")
    print_keypoints(args.output, header)
    if keypoints is None and not args.no_keypoints:
        print(f"{args.output}: without keypoints: its recordings have no positions, distances or field of view")
    return 0


def print_keypoints(path: Path, header: MapHeader) -> None:
    """For people: from where a new map has its headings, and how many of its places have distances."""
    course = [segment.source for segment in header.segments if segment.heading_is_course]
    if course:
        print(f"{path}: no heading for most pictures of {', '.join(course)}: the course of the positions is used")
    for line in spell_distances(open_map(path)):
        print(f"{path}: {line}")


def _key_of(old: ReferenceMap, feeds: list[Feed]) -> KeyOf | None:
    """Of further places of a map with keypoints. MapError where another network made those, or by another camera."""
    had = old.header.keypoints_key
    if had is None:
        return None
    for feed in feeds:
        if feed.header.fov_deg is None:
            print(f"{feed.path}: its field of view is not known, and taken to be the map's, {had.fov_deg:g} degrees")
        elif feed.header.fov_deg != had.fov_deg:
            seen = f"{feed.header.fov_deg:g} degrees wide, the map's {had.fov_deg:g}"
            raise MapError(f"{feed.path}: its pictures are {seen}; build a map of its own in the same folder")
        elif feed.header.alone != had.alone:
            raise MapError(f"{feed.path}: its lens is not the map's; build a map of its own in the same folder")
    if keypoints_key(had.height, had.width, had.fov_deg).sha256 != had.sha256:
        raise MapError(f"{old.path}: its keypoints are of another network {had.network}; build the map again")
    return lambda height, width: had


def _extend(args: argparse.Namespace) -> int:
    old = open_map(args.map, every_file=True)
    feeds = [open_recording(path) for path in args.feeds]
    header = old.header
    name = str(args.model or network_of_map(header.model.name))
    network = open_network(DescriptorConfig(model=name, provider=header.model.provider))
    key = model_key(network)
    if key != header.model:
        raise MapError(f"{args.map}: made with another model, so nothing can be added; name the map's with --model")
    shrink = shrink_to(header.dimensions, key.dimensions)
    of_map = key, header.regions, header.sampling
    with MapBuilder(args.map, *of_map, shrink=shrink, replace=True, keypoints=_key_of(old, feeds)) as builder:
        add_map(builder, old)
        for feed in feeds:
            add_feed(builder, feed, network, header.regions, header.sampling)
        header = builder.finish()
        _print_unused(builder)
    print(f"{args.map}: {header.places} places in {len(header.segments)} segment(s)")
    print_keypoints(args.map, header)
    return 0
