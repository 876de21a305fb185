"""A video, and the log of the vehicle that carried the camera.

    drive.mp4   flight.tlog | flight.bin | flight.ulg

Neither says when the other began: `start_s` is the time from the log's first position to the video's first frame,
0 by default. A second off is a second's travel off.
"""

from __future__ import annotations

from pathlib import Path

from edge.errors import FeedError
from sim.datasets import ReadOptions, Traverse
from sim.datasets.flight_logs import read_log
from sim.datasets.pictures import open_video


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
