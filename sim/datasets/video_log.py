"""A video, and the log of the vehicle that carried the camera, or a GPX track of the same drive.

    drive.mp4   drive.gpx | flight.tlog | flight.bin | flight.ulg

Neither of the two has the clock of the other: `alignment` finds when the video began, unless `offset_s`, the seconds
from the track's first position to the video's first frame, or `start_time` says it. Without `positions`, the log of the
same name beside the video is used.

A log is also accepted in place of a feed (`lookback replay flight.tlog`), with the video of the same name beside it.
"""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime, timezone
from pathlib import Path

from edge.errors import FeedError
from edge.feed import Feed, FeedOptions
from sim.datasets import ReadOptions, Traverse, open_dataset
from sim.datasets.alignment import Alignment, align, creation_time
from sim.datasets.flight_logs import read_log
from sim.datasets.importing import as_feed
from sim.datasets.pictures import VIDEO_SUFFIXES, open_video

LOG_SUFFIXES = (".gpx", ".tlog", ".bin", ".ulg")


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The frames of a video at the positions of a log. FeedError if their times do not overlap."""
    feed, pictures = open_video(path)
    log = Path(options.positions) if options.positions is not None else log_beside(path)
    if log is None:
        raise FeedError(f"--positions: name the log or track ({', '.join(LOG_SUFFIXES)}) that belongs to {path}")
    track = read_log(log)
    first_ns = track.fixes[0].stamp_ns
    if options.start_time is None and options.offset_s is None:
        made = creation_time(path, feed.rows[-1].stamp_ns / 1e9)
        alignment = align(str(path), feed.rows, pictures, track, made)
    else:
        start_ns = first_ns + round((options.offset_s or 0.0) * 1e9)
        start_ns = start_ns if options.start_time is None else parse_time_ns(options.start_time)
        words = f"the video began {(start_ns - first_ns) / 1e9:g} s after the track's first position, as was given"
        alignment = Alignment(start_ns, None, words)
    stamps_ns = [alignment.start_ns + row.stamp_ns for row in feed.rows]
    return Traverse(
        name=path.stem,
        source=f"{path.name} with {log.name}",
        rows=track.rows(str(path), [str(index) for index in range(len(stamps_ns))], stamps_ns),
        pictures=pictures,
        notes=alignment.how,
        alignment=alignment,
    )


def open_feed(log: Path, options: FeedOptions) -> Feed:
    """A log and its video as a feed; the entry point of `lookback.feeds`. FeedError."""
    video = options.video or _video_beside(log)
    read = ReadOptions(positions=str(log), offset_s=options.offset_s, view=options.view)
    return as_feed(open_dataset("video-log", video, read), log, lambda: open_video(video)[1])


def log_beside(video: Path) -> Path | None:
    """The log or track of the same name as a video; None if there is none. FeedError if there are several."""
    logs = _beside(video, LOG_SUFFIXES)
    if len(logs) > 1:
        raise FeedError(f"--positions: name one of {', '.join(file.name for file in logs)} for {video}")
    return logs[0] if logs else None


def parse_time_ns(text: str) -> int:
    """Nanoseconds since 1970 of an ISO 8601 time, in UTC unless it says otherwise. FeedError."""
    try:
        # Python 3.10 does not know the Z.
        moment = datetime.fromisoformat(text[:-1] + "+00:00" if text.endswith(("Z", "z")) else text)
    except ValueError:
        raise FeedError(f"--start-time: {text!r} is not a time such as 2026-05-04T12:30:00Z") from None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)
    return round(moment.timestamp() * 1e6) * 1000


def _video_beside(log: Path) -> Path:
    videos = _beside(log, VIDEO_SUFFIXES)
    if len(videos) != 1:
        found = ", ".join(file.name for file in videos) or "none"
        raise FeedError(f"{log}: name its video with --video; videos of the same name beside it: {found}")
    return videos[0]


def _beside(one: Path, suffixes: Collection[str]) -> list[Path]:
    """Files of the same name but for the suffix."""
    files = [file for file in sorted(one.parent.glob("*")) if file.stem == one.stem]
    return [file for file in files if file.suffix.lower() in suffixes]
