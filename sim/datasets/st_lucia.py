"""St Lucia, multiple times of day: one drive as it unpacks.

    190809_0845/webcam_video.avi   or its frames in that folder
    190809_0845/fGPS.txt           a line a frame: 27.50407166666666500000,153.00236500000000000000

A. Glover, W. Maddern, M. Milford, G. Wyeth, ICRA 2010; https://github.com/arrenglover/openfabmap/wiki/Datasets. The
latitudes are written without their sign, and are south. The receiver reported about every tenth frame and the file
repeats it, so positions are interpolated between the lines where they change.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from sim.datasets import ReadOptions, Traverse
from sim.datasets.pictures import frames_of
from sim.datasets.tables import read_numbers
from sim.datasets.track import Fix, Track

VIDEO = "webcam_video.avi"
NOMINAL_FPS = 15.0


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """One drive. FeedError if fGPS.txt or the frames are missing, or a line is no position."""
    frames = path / VIDEO if (path / VIDEO).is_file() else path
    names, stamps_ns, pictures = frames_of(frames, options.fps or NOMINAL_FPS)
    file = path / "fGPS.txt"
    degrees = read_numbers(file, 2, "it comes with the drive and has a position for each frame", separator=",")
    count = min(len(degrees), len(names))
    changes = np.flatnonzero(np.any(np.diff(degrees[:count], axis=0, prepend=math.nan) != 0, axis=1))
    fixes = [Fix(stamps_ns[at], -abs(float(degrees[at, 0])), float(degrees[at, 1])) for at in {*changes, count - 1}]
    # While the car stands no line changes: a gap is no loss of the receiver here.
    track = Track(str(file), fixes, max_gap_s=math.inf)
    return Traverse(
        name=path.name,
        view=options.view or "front",
        source=f"St Lucia {path.name}",
        rows=track.rows(str(frames), names, stamps_ns),
        pictures=pictures,
    )
