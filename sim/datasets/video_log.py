"""A video, and the log of the vehicle that carried the camera, or a GPX track of the same drive.

    drive.mp4   drive.gpx | flight.tlog | flight.bin | flight.ulg | a track of `track_files`

A GoPro's chapters beside the first (GX020042.MP4 after GX010042.MP4), and the videos in a folder, are one recording
with one track. Neither of the two has the clock of the other: `alignment` finds when the video began, unless
`offset_s`, the seconds from the track's first position to the video's first frame, or `start_time` says it. Without
`positions`, the log of the same name beside the video is used.

A log is also accepted in place of a feed (`lookback replay flight.tlog`), with the video of the same name beside it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from edge.errors import FeedError
from edge.feed import Feed, FeedOptions, FeedRow
from sim.datasets import ONE_CLOCK_S, ReadOptions, Traverse, open_dataset
from sim.datasets.alignment import Alignment, align, creation_time
from sim.datasets.field_of_view import of_video
from sim.datasets.flight_logs import LOGS, read_log
from sim.datasets.importing import as_feed
from sim.datasets.pictures import VIDEO_SUFFIXES, join_videos, video_files
from sim.datasets.tables import parse_time_ns
from sim.datasets.track_files import TRACKS

LOG_SUFFIXES = (*LOGS, *TRACKS)


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The frames of a video at the positions of a log. FeedError if their times do not overlap."""
    joined = join_videos(files := video_files(path))
    log = Path(options.positions) if options.positions is not None else log_beside(path)
    if log is None:
        raise FeedError(f"--positions: name the log or track ({', '.join(LOG_SUFFIXES)}) that belongs to {path}")
    track = read_log(log)
    first_ns = track.fixes[0].stamp_ns
    if log.suffix.lower() == ".srt" and options.start_time is None and options.offset_s is None:
        alignment = Alignment(0, ONE_CLOCK_S, "subtitles have the times of the video")
    elif options.start_time is None and options.offset_s is None:
        made = creation_time(files[0], joined.feeds[0].rows[-1].stamp_ns / 1e9)
        rows = [FeedRow(name, stamp_ns) for name, stamp_ns in zip(joined.names, joined.stamps_ns, strict=True)]
        alignment = align(str(path), rows, joined.pictures, track, made)
    else:
        start_ns = first_ns + round((options.offset_s or 0.0) * 1e9)
        start_ns = start_ns if options.start_time is None else parse_time_ns(options.start_time, "--start-time")
        words = f"the video began {(start_ns - first_ns) / 1e9:g} s after the track's first position, as was given"
        alignment = Alignment(start_ns, None, words)
    stamps_ns = [alignment.start_ns + stamp_ns for stamp_ns in joined.stamps_ns]
    fov_deg, lens = of_video(files[0], joined.feeds[0].header.width, joined.feeds[0].header.height)
    return Traverse(
        name=path.stem,
        source=f"{', '.join(file.name for file in files)} with {log.name}",
        rows=track.rows(str(path), joined.names, stamps_ns),
        pictures=joined.pictures,
        notes=alignment.how,
        alignment=alignment,
        fov_deg=fov_deg,
        lens=lens,
    )


def open_feed(log: Path, options: FeedOptions) -> Feed:
    """A log and its video as a feed; the entry point of `lookback.feeds`. FeedError."""
    video = options.video or _video_beside(log)
    read = ReadOptions(positions=str(log), offset_s=options.offset_s, view=options.view)
    return as_feed(open_dataset("video-log", video, read), log)


def log_beside(video: Path) -> Path | None:
    """The log or track of the same name as a video or a folder of videos, or the one in that folder; None without one.

    FeedError if there are several; of several kinds of tracks the first of TRACKS is used.
    """
    inside = sorted(video.iterdir()) if video.is_dir() else []
    found = _chosen(inside) or _chosen(_beside(video, LOG_SUFFIXES))
    if len(found) > 1:
        raise FeedError(f"--positions: name one of {', '.join(file.name for file in found)} for {video}")
    return found[0] if found else None


def _chosen(files: Sequence[Path]) -> list[Path]:
    """Logs and GPX tracks among the files, else those of the first other kind."""
    for kinds in ({*LOGS, ".gpx"}, *({suffix} for suffix in TRACKS)):
        found = [file for file in files if file.suffix.lower() in kinds]
        if found:
            return found
    return []


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
