"""A video, and the log of the vehicle that carried the camera.

    drive.mp4   flight.tlog | flight.bin | flight.ulg

`start_s` is the time from the log's first position to the video's first frame, 0 by default; neither file has it. An
error of a second displaces all positions by a second of travel.

A log is also accepted in place of a feed (`lookback replay flight.tlog`), with the video of the same name beside it.
"""

from __future__ import annotations

from pathlib import Path

from edge.errors import FeedError
from edge.feed import Feed, FeedOptions
from sim.datasets import ReadOptions, Traverse, open_dataset
from sim.datasets.flight_logs import read_log
from sim.datasets.importing import as_feed
from sim.datasets.pictures import VIDEO_SUFFIXES, open_video


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The frames of a video at the positions of a log. FeedError if their times do not overlap."""
    feed, pictures = open_video(path)
    if options.positions is None:
        raise FeedError(f"--positions: name the log (.tlog, .bin or .ulg) that belongs to {path}")
    log = Path(options.positions)
    track = read_log(log)
    start_ns = track.fixes[0].stamp_ns + round((options.start_s or 0.0) * 1e9)
    stamps_ns = [start_ns + row.stamp_ns for row in feed.rows]
    return Traverse(
        name=path.stem,
        view=options.view or "front",
        source=f"{path.name} with {log.name}",
        rows=track.rows(str(path), [str(index) for index in range(len(stamps_ns))], stamps_ns),
        pictures=pictures,
        notes=f"the video began {options.start_s or 0.0:g} s after the log's first position",
    )


def open_feed(log: Path, options: FeedOptions) -> Feed:
    """A log and its video as a feed; the entry point of `lookback.feeds`. FeedError."""
    video = options.video or _video_beside(log)
    read = ReadOptions(positions=str(log), start_s=options.video_start_s, view=options.view)
    return as_feed(open_dataset("video-log", video, read), log, lambda: open_video(video)[1])


def _video_beside(log: Path) -> Path:
    videos = [file for file in sorted(log.parent.glob("*")) if file.stem == log.stem]
    videos = [file for file in videos if file.suffix.lower() in VIDEO_SUFFIXES]
    if len(videos) != 1:
        found = ", ".join(file.name for file in videos) or "none"
        raise FeedError(f"{log}: name its video with --video; videos of the same name beside it: {found}")
    return videos[0]
