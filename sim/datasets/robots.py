"""Two public data sets with front and rear cameras: made from what is published of them, never tried on their files.

FrodoBots-2K (sidewalk robots; huggingface.co/datasets/frodobots/FrodoBots-2K), one ride:

    ride_20699_17c99e_20240310191305/gps_data_20699.csv                 latitude,longitude,timestamp (ms)
    ride_.../front_camera_timestamps_20699.csv, rear_camera_...         frame_id,timestamp (s), a line a picture
    ride_.../control_data_20699.csv                                     linear,angular,rpm_1 to rpm_4,timestamp (s)
    ride_.../recordings/*uid_s_1000*video*.ts front, 1001 rear          parts of the videos, in the order of their names

The two cameras are not synchronized (they start 1 to 7 s apart, drift, and the rear one has gaps), so each picture has
the wall clock of its own line; where the parts hold more or fewer pictures than lines, the last ones are unused. GPS
jumps: positions that would need more than 30 m/s are skipped. `control_data` is not used: the unit of rpm is unknown.

FRED, Flooded Road Environments (QUT, github.com/CMalone-Jupiter/python-FRED), one sequence of KITTI-style/:

    Cambogan_20250811_113017/front-imgs/<us>.png, back-imgs/<us>.png    names are stamps in microseconds
    Cambogan_20250811_113017/utm/<us>.txt                               easting and northing in zone 56, south

The yaw in imu/ is not used, since neither its unit nor its direction are published.
`camera` is front by default, or rear.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from edge.errors import FeedError
from edge.feed import View
from edge.geodesy import east_north_of
from sim.datasets import ONE_CLOCK_S, ReadOptions, Traverse
from sim.datasets.pictures import JoinedPictures, PictureFiles, list_pictures, natural_key, open_video
from sim.datasets.tables import read_numbers, read_records
from sim.datasets.track import Fix, Track, from_local

MOST_MPS = 30.0
FRED_ZONE = "56J"  # Brisbane
UID = {"front": "1000", "rear": "1001"}


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """One camera of a ride or a sequence. FeedError names what is missing."""
    view: View = "rear" if options.camera == "rear" else "front"
    if options.camera not in (None, "front", "rear"):
        raise FeedError(f"--camera: {options.camera!r} is neither front nor rear")
    return _fred(path, view) if (path / "utm").is_dir() else _frodobots(path, view)


def _fred(path: Path, view: View) -> Traverse:
    folder = path / ("front-imgs" if view == "front" else "back-imgs")
    names = list_pictures(folder)
    fixes = list(_fred_fixes(path))
    rows = Track(str(path / "utm"), fixes).rows(str(folder), names, [_stamp_ns(folder / name) for name in names])
    pictures = PictureFiles([folder / name for name in names])
    return Traverse(
        f"{path.name}-{view}", f"FRED {path.name} {folder.name}", rows, pictures, view, time_sigma_s=ONE_CLOCK_S
    )


def _fred_fixes(path: Path) -> Iterator[Fix]:
    for file in sorted((path / "utm").glob("*.txt")):
        east_m, north_m = read_numbers(file, 2, "it has an easting and a northing")[0].tolist()
        yield Fix(_stamp_ns(file), *from_local(east_m, north_m, FRED_ZONE), source="gps")


def _stamp_ns(file: Path) -> int:
    if not file.stem.isdigit():
        raise FeedError(f"{file}: its name is no stamp in microseconds")
    return int(file.stem) * 1000


def _frodobots(path: Path, view: View) -> Traverse:
    times = _one(path, f"{view}_camera_timestamps_*.csv")
    stamps_ns = [round(record.number("timestamp") * 1e9) for record in read_records(times, ("timestamp",), "")]
    files = sorted(
        (file for file in (path / "recordings").glob(f"*uid_s_{UID[view]}*.ts") if "audio" not in file.name),
        key=lambda file: natural_key(file.name),
    )
    if not files:
        raise FeedError(f"{path / 'recordings'}: no part of the {view} video (*uid_s_{UID[view]}*.ts)")
    opened = [open_video(file) for file in files]
    names = [
        f"{file.name} {row}" for file, (feed, _) in zip(files, opened, strict=True) for row in range(len(feed.rows))
    ]
    used = min(len(names), len(stamps_ns))
    gps = _one(path, "gps_data_*.csv")
    track = Track(str(gps), _without_jumps(gps))
    pictures = JoinedPictures([one for _, one in opened], [len(feed.rows) for feed, _ in opened])
    return Traverse(
        name=f"{path.name}-{view}",
        source=f"FrodoBots-2K {path.name} {view}",
        rows=track.rows(str(path), names[:used], stamps_ns[:used]),
        pictures=pictures,
        view=view,
        notes=f"{len(names)} pictures and {len(stamps_ns)} times of them",
        time_sigma_s=ONE_CLOCK_S,
    )


def _without_jumps(file: Path) -> Iterator[Fix]:
    last: Fix | None = None
    for record in read_records(file, ("latitude", "longitude", "timestamp"), "it has the positions of the ride"):
        stamp_ns = round(record.number("timestamp") * 1e6)
        fix = Fix(stamp_ns, record.number("latitude"), record.number("longitude"), source="gps")
        if last is not None:
            moved_m = math.hypot(*east_north_of(fix.lat_deg, fix.lon_deg, (last.lat_deg, last.lon_deg)))
            if stamp_ns <= last.stamp_ns or moved_m > MOST_MPS * (stamp_ns - last.stamp_ns) / 1e9:
                continue
        last = fix
        yield fix


def _one(path: Path, pattern: str) -> Path:
    found = sorted(path.glob(pattern))
    if len(found) != 1:
        raise FeedError(f"{path}: {len(found) or 'no'} file(s) {pattern}; a folder holds one ride")
    return found[0]
