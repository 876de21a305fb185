"""FRED, Flooded Road Environments: made from what is published of it, never tried on its files.

One sequence of KITTI-style/ (QUT, github.com/CMalone-Jupiter/python-FRED):

    Cambogan_20250811_113017/front-imgs/<us>.png, back-imgs/<us>.png    names are stamps in microseconds
    Cambogan_20250811_113017/utm/<us>.txt                               easting and northing in zone 56, south

The yaw in imu/ is not used, since neither its unit nor its direction are published.
`camera` is front by default, or rear.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from edge.errors import FeedError
from edge.feed import View
from sim.datasets import ONE_CLOCK_S, ReadOptions, Traverse
from sim.datasets.pictures import PictureFiles, list_pictures
from sim.datasets.tables import read_numbers
from sim.datasets.track import Track, TrackFix, from_local

ZONE = "56J"  # Brisbane


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """One camera of a sequence. FeedError names what is missing."""
    view: View = "rear" if options.camera == "rear" else "front"
    if options.camera not in (None, "front", "rear"):
        raise FeedError(f"--camera: {options.camera!r} is neither front nor rear")
    folder = path / ("front-imgs" if view == "front" else "back-imgs")
    names = list_pictures(folder)
    rows = Track(str(path / "utm"), list(_fixes(path))).rows(
        str(folder), names, [_stamp_ns(folder / name) for name in names]
    )
    pictures = PictureFiles([folder / name for name in names])
    return Traverse(
        f"{path.name}-{view}", f"FRED {path.name} {folder.name}", rows, pictures, view, time_sigma_s=ONE_CLOCK_S
    )


def _fixes(path: Path) -> Iterator[TrackFix]:
    for file in sorted((path / "utm").glob("*.txt")):
        east_m, north_m = read_numbers(file, 2, "it has an easting and a northing")[0].tolist()
        yield TrackFix(_stamp_ns(file), *from_local(east_m, north_m, ZONE), source="gps")


def _stamp_ns(file: Path) -> int:
    if not file.stem.isdigit():
        raise FeedError(f"{file}: its name is no stamp in microseconds")
    return int(file.stem) * 1000
