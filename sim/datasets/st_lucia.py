"""St Lucia, multiple times of day: one drive as it unpacks.

    190809_0845/webcam_video.avi   or its frames in that folder
    190809_0845/fGPS.txt           a line a frame: 27.50407166666666500000,153.00236500000000000000

A. Glover, W. Maddern, M. Milford, G. Wyeth, ICRA 2010; https://github.com/arrenglover/openfabmap/wiki/Datasets. The
latitudes are written without their sign, and are south. The receiver reported about every tenth frame and the file
repeats it, so positions are interpolated between the lines where they change.
"""

from __future__ import annotations

from pathlib import Path

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
    # Where lines repeat, `Track` goes straight from each change to the next.
    fixes = [
        Fix(stamp_ns, -abs(lat_deg), lon_deg)
        for stamp_ns, (lat_deg, lon_deg) in zip(stamps_ns, degrees.tolist(), strict=False)
    ]
    track = Track(str(file), fixes)
    return Traverse(
        name=path.name,
        source=f"St Lucia {path.name}",
        rows=track.rows(str(frames), names, stamps_ns),
        pictures=pictures,
    )
