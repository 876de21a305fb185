"""comma2k19: one segment, a minute of driving.

    b0c9d2329ad1606b|2018-08-02--08-34-47/40/video.hevc      1164 x 874 at 20 Hz, without times
    .../40/global_pose/frame_times                           NumPy files without a suffix: seconds since the boot, (N,)
    .../40/global_pose/frame_positions, frame_velocities     of the camera, ECEF, m and m/s, (N, 3)
    .../40/global_pose/frame_orientations                    quaternions w, x, y, z, (N, 4)

Specified in the README of github.com/commaai/comma2k19; H. Schafer et al., arXiv:1812.05752. It calls the quaternions
rotations from ECEF to the camera (forward, right, down). In its Example_1 they are from the camera to ECEF: 0.9 degrees
(0.1 rms) off the course, where the inverse is 11 off. Logs of openpilot (rlog) are read by its tools only.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
from pyproj import Geod, Transformer

from edge.errors import FeedError
from edge.feed.reader import VideoPictures
from sim.datasets import ONE_CLOCK_S, ReadOptions, Traverse
from sim.datasets.field_of_view import of_focal_length
from sim.datasets.track import Track, TrackFix

FOCAL_PX, WIDTH_PX = 910.0, 1164  # of the EON's camera: utils/camera.py there
ARRAYS = "times", "positions", "velocities", "orientations"
RLOG_ONLY = (
    "no global_pose as in comma2k19, and only openpilot's tools read an rlog; run ffmpeg -r 20 -i fcamera.hevc -c copy"
    " fcamera.mp4 and docs/examples/openpilot_track.py RLOG > fcamera.csv, and import fcamera.mp4"
)


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The frames of a segment. FeedError names what is missing, or a video that has another number of frames."""
    if not (path / "global_pose").is_dir():
        raise FeedError(f"{path}: {RLOG_ONLY}")
    fixes, file = _fixes(path / "global_pose"), path / "video.hevc"
    if not file.is_file():
        raise FeedError(f"{file}: no such video; it comes with the segment")
    pictures = VideoPictures(file)
    with av.open(str(file)) as video:
        frames = sum(packet.size > 0 for packet in video.demux(video=0))
    if frames != len(fixes):
        raise FeedError(f"{file}: {frames} frames for the {len(fixes)} poses in global_pose")
    rows = Track(str(path), fixes).rows(str(file), list(map(str, range(frames))), [fix.stamp_ns for fix in fixes])
    name, fov_deg = f"{path.parent.name}-{path.name}", of_focal_length(str(path), FOCAL_PX, WIDTH_PX)
    return Traverse(name, f"comma2k19 {name}", rows, pictures, time_sigma_s=ONE_CLOCK_S, fov_deg=fov_deg)


def _fixes(folder: Path) -> list[TrackFix]:
    """The pose of each frame: its heading is that of the camera."""
    try:
        poses = np.column_stack([np.load(folder / f"frame_{name}") for name in ARRAYS])
    except (OSError, ValueError, EOFError) as error:
        raise FeedError(f"{folder}: cannot read its poses: {error}") from None
    if poses.shape[1] != 11 or not np.isfinite(poses).all():
        raise FeedError(f"{folder}: its poses are not 11 finite numbers for each frame")
    times_s, at_m, velocities_mps, (w, x, y, z) = poses[:, 0], poses[:, 1:4], poses[:, 4:7], poses[:, 7:].T
    ahead = np.column_stack([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)])
    to_degrees = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    (lon, lat, alt_m), (lon_1, lat_1, _) = (to_degrees.transform(*point.T) for point in (at_m, at_m + ahead))
    headings_deg = Geod(ellps="WGS84").inv(lon, lat, lon_1, lat_1)[0] % 360
    stamps_ns, speeds_mps = np.round(times_s * 1e9).astype(np.int64), np.linalg.norm(velocities_mps, axis=1)
    columns = (values.tolist() for values in (stamps_ns, lat, lon, alt_m, headings_deg, speeds_mps))
    return [replace(TrackFix(*values), source="estimate") for values in zip(*columns, strict=True)]
