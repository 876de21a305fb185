"""Which kind of recording a path is, by what lies there, and whatever it is as a feed."""

from __future__ import annotations

from pathlib import Path

from edge.errors import FeedError
from edge.feed import Feed, FeedHeader, FeedOptions, FeedRow, read_feed
from sim.datasets import KINDS, ReadOptions, check_files, open_dataset
from sim.datasets.importing import as_feed
from sim.datasets.mcap_file import is_feed
from sim.datasets.pictures import PICTURE_SUFFIXES, VIDEO_SUFFIXES, PictureFiles, list_pictures
from sim.datasets.video import holds_positions
from sim.datasets.video_log import LOG_SUFFIXES, log_beside

LAYOUTS = (
    ("stereo.timestamps", "robotcar"),
    ("mono_rear.timestamps", "robotcar"),
    ("times.txt", "kitti"),
    ("metadata.yaml", "rosbag"),
    ("front-imgs", "fred"),
    ("global_pose", "comma2k19"),
    ("rlog", "comma2k19"),
    ("rlog.[bz]*", "comma2k19"),
)
"""A file that only one layout has, and its kind."""


def open_recording(path: Path, options: FeedOptions | None = None) -> Feed:
    """A feed, or what `lookback import` would make one of, with all of its pictures, and nothing written. FeedError."""
    options = options or FeedOptions()
    kind = find_kind(path) if path.exists() else None
    if kind is None:
        return read_feed(path, options)
    if options.video is not None:
        raise FeedError(f"{path}: --video is for a log (.tlog, .bin, .ulg), and this is not one")
    return as_feed(open_dataset(kind, path, ReadOptions(offset_s=options.offset_s, view=options.view)), path)


def read_drive(path: Path) -> Feed:
    """A recording; or a folder of pictures that is no feed, in the order of their names. FeedError."""
    if not path.is_dir() or (path / "feed.toml").exists():
        return open_recording(path)
    files = [path / name for name in list_pictures(path)]
    height, width = PictureFiles(files).read(0).shape[:2]
    rows = tuple(FeedRow(file.name, number * 10**9) for number, file in enumerate(files))
    return Feed(path, FeedHeader(path.name, "front", width, height), rows, lambda: PictureFiles(files))


def find_kind(path: Path, positions: str | None = None) -> str | None:
    """A kind of KINDS; None for a feed, and for what `read_feed` reads without a conversion. FeedError names the path.

    positions: a log or a CSV file that is named for it.
    """
    if path.is_file():
        return _kind_of_file(path, positions)
    if not path.is_dir():
        raise FeedError(f"{path}: no such file or folder")
    check_files(path)
    if (path / "feed.toml").exists() or (path / "frames").is_dir():
        return None
    for sign, kind in LAYOUTS:
        if next(path.glob(sign), None):
            return kind
    pictures = [file.name for file in path.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES]
    if not pictures:
        videos = [file for file in path.iterdir() if file.suffix.lower() in VIDEO_SUFFIXES]
        has_track = videos and (positions or log_beside(path))
        if has_track or any(map(holds_positions, videos)):
            return "video-log" if has_track else "video"
        raise FeedError(
            f"{path}: neither a feed (feed.toml), nor pictures, nor a layout of {', '.join(sorted(KINDS))}; of a video,"
            f" name the file, and put its track ({', '.join(LOG_SUFFIXES)}) of the same name beside it"
        )
    has_table = positions or next(path.glob("*.csv"), None) or path.with_name(f"{path.name}.csv").is_file()
    return "pictures" if has_table else "geotagged"


def _kind_of_file(file: Path, positions: str | None) -> str | None:
    if file.suffix.lower() in {".bag", ".db3"} or (file.suffix.lower() == ".mcap" and not is_feed(file)):
        return "rosbag"
    if file.suffix.lower() not in VIDEO_SUFFIXES:
        return None
    if positions or log_beside(file):
        return "video-log"
    return "video" if holds_positions(file) else None
