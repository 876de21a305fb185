"""`lookback import`: convert pictures, a video with its track or log, a ROS bag or a published data set to a feed."""

from __future__ import annotations

import argparse
import math
from dataclasses import fields
from pathlib import Path

from tqdm import tqdm

from edge.config import SamplingConfig
from edge.errors import ConfigError, FeedError
from edge.extras import install_command
from edge.feed import Feed, read_feed
from sim.datasets import KINDS, ReadOptions, Traverse, open_dataset
from sim.datasets.found import find_kind
from sim.datasets.importing import choose_rows, write_feed
from sim.datasets.summary import summarize
from sim.maps.adding_keypoints import add_fov_option
from sim.maps.command import add_spacing_options, sampling_from


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback import`."""
    parser.description = "Convert a recording in another layout to a feed."
    parser.epilog = _kinds()
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    about = "the layout (default: what lies at PATH); see below"
    parser.add_argument("kind", metavar="KIND", nargs="?", choices=sorted(KINDS), help=about)
    parser.add_argument("path", metavar="PATH", type=Path, help="folder or file of the recording")
    parser.add_argument("-o", "--output", metavar="FEED", type=Path, required=True, help="folder for the new feed")
    _add_read_options(parser)
    add_spacing_options(parser)
    parser.add_argument("--length-m", metavar="M", type=float, default=math.inf, help="only the first M meters")
    parser.add_argument("--width", metavar="PIXELS", type=int, help="resize the pictures to this width")
    parser.add_argument("--skip-unreadable", action="store_true", help="skip pictures that cannot be read")
    parser.add_argument("--lossless", action="store_true", help="write PNG instead of JPEG")
    parser.set_defaults(run=import_dataset)


def _add_read_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--camera", help="camera or topic, such as stereo/left, mono_left, image_2")
    parser.add_argument("--positions", help="source of positions: a track, a log, a CSV file, a topic, or ins | gps")
    parser.add_argument("--columns", metavar="KIND=COLUMN,...", help="columns of a CSV file: time=t,lat=y,lon=x,file=f")
    parser.add_argument("--names", metavar="FILE", type=Path, help="only the pictures in this list")
    parser.add_argument("--fps", metavar="HZ", type=float, help="pictures a second, for layouts without times")
    start = parser.add_mutually_exclusive_group()
    start.add_argument("--offset-s", metavar="S", type=float, help="from the track's first position to the first frame")
    start.add_argument("--start-time", metavar="TIME", help="when the first frame was taken, 2026-05-04T12:30:00Z")
    parser.add_argument("--crop-bottom", metavar="ROWS", type=int, help="crop rows that show the vehicle itself")
    parser.add_argument("--view", choices=["front", "rear"], help="direction of the camera")
    add_fov_option(parser)


def _kinds() -> str:
    """Each kind with its options, and its usual ground truth."""
    lines = ["kinds, their options, and their usual ground truth and tolerance:"]
    for name, kind in sorted(KINDS.items()):
        options = " ".join(f"--{option.replace('_', '-')}" for option in sorted(kind.options))
        unit = "frames" if kind.truth == "rows" else "m"
        lines.append(f"  {name:14} {kind.what}\n{'':17}{options}; {kind.truth}, {kind.tolerance:g} {unit}")
    return "\n".join([*lines, "", "Without a spacing: a picture every 2 m where positions are known, otherwise all."])


def import_dataset(args: argparse.Namespace) -> int:
    """Write the feed; SetupError, in one line, for a bad recording, option or folder."""
    _check_ranges(args)
    kind = args.kind or find_kind(args.path, args.positions)
    if kind is None:
        read_feed(args.path)  # FeedError for what is no recording at all
        raise FeedError(
            f"{args.path}: needs no conversion: name it to `lookback map build`, `replay` and `try` as it is"
        )
    options = {option.name: getattr(args, option.name) for option in fields(ReadOptions)}
    traverse = open_dataset(kind, args.path, ReadOptions(**options))
    placed = any(row.lat_deg is not None or row.distance_m is not None for row in traverse.rows)
    otherwise = SamplingConfig(by="distance" if placed else "frames")
    chosen = choose_rows(
        traverse,
        sampling_from(args, otherwise),
        must_have_distance=args.spacing_m is not None or args.length_m < math.inf,
        length_m=args.length_m,
    )
    progress = tqdm(chosen, unit="frame", desc=args.output.name)
    count = write_feed(
        traverse, args.output, progress, width=args.width, skip_unreadable=args.skip_unreadable, lossless=args.lossless
    )
    feed = read_feed(args.output)
    print(f"{args.output}: {count} frames of {len(traverse.rows)}, from {traverse.source}")
    for word, line in summarize(feed):
        print(f"  {word:<13} {line}")
    print(f"  {'sheet':<13} {_write_sheet(feed, traverse)}")
    return 0


def _write_sheet(feed: Feed, traverse: Traverse) -> str:
    """Write the page beside the feed's header; the page's path, or what it needs."""
    try:
        from sim.datasets import sheet
    except ModuleNotFoundError as error:
        return f"needs {error.name}: {install_command('import')}"
    page = feed.path / sheet.NAME
    page.write_text(sheet.render(feed, traverse.alignment), encoding="utf-8")
    return str(page)


def _check_ranges(args: argparse.Namespace) -> None:
    """ConfigError names the option."""
    for option, value in (("--fps", args.fps), ("--length-m", args.length_m), ("--width", args.width)):
        # Not `value <= 0`: that would let NaN through.
        if value is not None and not value > 0:
            raise ConfigError(f"{option}: {value:g} is not above 0")
    if args.crop_bottom is not None and args.crop_bottom < 0:
        raise ConfigError(f"--crop-bottom: {args.crop_bottom} is not 0 or more")
    if args.offset_s is not None and not math.isfinite(args.offset_s):
        raise ConfigError(f"--offset-s: {args.offset_s} is not a number of seconds")
