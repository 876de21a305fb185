"""`lookback replay`: recognize the places of a recording; prints events as JSON lines, always the same ones."""

from __future__ import annotations

import argparse
import logging
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import msgspec
from tqdm import tqdm

from edge.camera.preprocessing import preprocessed_feed
from edge.config import Config, SamplingConfig, load_config
from edge.descriptor.model_file import network_of_map
from edge.descriptor.network import Network
from edge.feed import Feed
from edge.journal.records import FrameUsed
from edge.localization.place_fix import frame_used
from edge.recognition.recognizer import PlaceRecognizer, open_recognizer
from edge.reference_map import Route, open_map_set
from edge.reference_map.checksums import ChecksumSchedule
from edge.reference_map.store import MapHeader
from edge.sequence import PlaceMatch
from sim.datasets.found import open_recording
from sim.maps.command import add_feed_options, add_spacing_options, feed_options, sampling_from
from sim.output import checked_option, writing
from sim.traverse import config_as_mapped, driven_m, traverse

log = logging.getLogger(__name__)

CHECK_BYTES = 64 << 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback replay`."""
    about = "a feed, an MCAP file, a video, or an autopilot log (.tlog) with its video"
    parser.add_argument("feed", type=Path, metavar="FEED", help=about)
    parser.add_argument("--map", type=Path, required=True, help="a map, or a folder of maps")
    parser.add_argument("--model", type=Path, help="the network that the map was made with, unless it is grid or fc6")
    parser.add_argument("--config", type=Path, help="read all settings of the recognizer from this file")
    parser.add_argument("--sequence-length", type=int, metavar="L", help="frames in a sequence")
    parser.add_argument("--confidence-from", type=float, metavar="P", help="probability from which a place is accepted")
    parser.add_argument("--all", action="store_true", help="write a line for every used frame, not only for events")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write to this file, not to standard output")
    add_spacing_options(parser)
    add_feed_options(parser)
    parser.set_defaults(run=run)


def replay(
    recognizer: PlaceRecognizer, feed: Feed, sampling: SamplingConfig, faults: Counter[str] | None = None
) -> Iterator[tuple[FrameUsed, PlaceMatch | None]]:
    """Each used frame of the feed and its match, in order. MapError for a map that is damaged, if there is no other.

    faults: see `traverse`.
    """
    checksums = recognizer.map_set.checksum_schedule()
    while _exclude_damaged(recognizer, checksums, recognizer.matcher.search.folders_in_use):
        pass
    route = Route(recognizer.map_set)
    for item in traverse(feed, sampling, faults=faults):
        match = item.match(recognizer)
        if match is not None and match.accepted:
            behind = recognizer.map_set.folders_behind(match.place_index, recognizer.config.sequence_frames)
            if _exclude_damaged(recognizer, checksums, behind):
                match, route = None, Route(recognizer.map_set)
        rig = recognizer.config.rig
        yield frame_used(item.frame.index, item.frame.stamp_ns, match, route, rig, item.missed), match


def _exclude_damaged(recognizer: PlaceRecognizer, checksums: ChecksumSchedule, folders: list[Path]) -> bool:
    """Check the maps in some folders now; True if one is damaged, and excluded from now on."""
    while not checksums.is_verified(folders):
        damaged = checksums.step(CHECK_BYTES, folders)
        if damaged:
            maps = recognizer.map_set.without(damaged)
            maps.excluded[-1].log()
            recognizer.use_maps(maps)
            return True
    return False


def as_line(used: FrameUsed) -> str:
    """A record as replay writes it: without its tag, since all of them are frames."""
    fields = msgspec.to_builtins(used)
    del fields["event"]
    return msgspec.json.encode(fields).decode() + "\n"


def with_options(config: Config, length: int | None, confidence_from: float | None) -> Config:
    """The config with the command's options in place of its own keys. ConfigError names a bad option."""
    sequence, acceptance = config.sequence, config.acceptance
    if length is not None:
        sequence = checked_option(sequence, "--sequence-length", length=length)
    if confidence_from is not None:
        acceptance = checked_option(acceptance, "--confidence-from", confidence_from=confidence_from)
    return msgspec.structs.replace(config, sequence=sequence, acceptance=acceptance)


def load_config_for_map(path: Path, header: MapHeader) -> Config:
    """A config file, with the network of the map where it names none."""
    config = load_config(path)
    model = config.descriptor.model or network_of_map(header.model.name)
    return msgspec.structs.replace(config, descriptor=msgspec.structs.replace(config.descriptor, model=model))


def config_for_feed(config: Config, feed: Feed) -> Config:
    """The config with what the feed says of its camera; frames by time where nothing says how far they are apart."""
    header, camera, sampling = feed.header, config.camera, config.sampling
    if header.fov_deg is not None:
        camera = msgspec.structs.replace(camera, fov_deg=header.fov_deg, **msgspec.structs.asdict(header.alone))
    camera = msgspec.structs.replace(camera, view=header.view)
    if sampling.by == "distance" and driven_m(feed) is None:
        words = "no distances or positions in it: a frame every %g s; they must be as far apart as the map's places"
        log.warning(f"%s: {words}", feed.path, sampling.interval_s)
        sampling = msgspec.structs.replace(sampling, by="time")
    return msgspec.structs.replace(config, camera=camera, sampling=sampling)


def run(args: argparse.Namespace, network: Network | None = None) -> int:
    """The command; network: in place of the one that its config names."""
    feed = open_recording(args.feed, feed_options(args))
    maps = open_map_set(args.map)
    made = maps.headers[0]
    config = load_config_for_map(args.config, made) if args.config else config_as_mapped(made)
    config = with_options(config, args.sequence_length, args.confidence_from)
    feed = preprocessed_feed(feed, config.camera)
    config = config_for_feed(msgspec.structs.replace(config, sampling=sampling_from(args, config.sampling)), feed)
    network = Network.load(args.model) if args.model else network
    recognizer = open_recognizer(config, network=network, map_set=maps)
    for excluded in recognizer.map_set.excluded:
        excluded.log()
    lines = (used for used, _ in replay(recognizer, feed, config.sampling))
    if args.output:
        with writing(args.output) as stream:
            _write(lines, stream, feed, every=args.all)
    else:
        _write(lines, sys.stdout, feed, every=args.all)
    return 0


def _write(lines: Iterator[FrameUsed], stream: TextIO, feed: Feed, *, every: bool) -> None:
    """Write the lines, with a bar unless they go to the terminal themselves; a closing line goes to standard error."""
    used = believed = events = 0
    hidden = True if stream.isatty() else None
    with tqdm(total=len(feed.rows), desc=feed.header.name, unit="frame", disable=hidden, leave=False) as bar:
        for line in lines:
            used, believed, events = used + 1, believed + line.accepted, events + line.emitted
            bar.update(line.frame + 1 - bar.n)
            if every or line.emitted:
                stream.write(as_line(line))
    print(f"{feed.path}: {believed} of {used} used frames accepted, {events} events", file=sys.stderr)
