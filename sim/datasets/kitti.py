"""KITTI odometry: one sequence.

    dataset/sequences/00/image_2/000000.png ...   left color camera (3 right color, 0 and 1 gray)
    dataset/sequences/00/times.txt                seconds, a line a picture
    dataset/sequences/00/calib.txt                P0 to P3: the field of view of each camera
    dataset/poses/00.txt                          12 numbers a line: 3 x 4 pose of the left camera, row by row

Specified in readme.txt of its development kit; A. Geiger et al., CVPR 2012. Poses are in the frame of the first
camera (x right, y down, z ahead), so there is no north and no latitude: positions are local, x as east and
z as north, from which the camera's heading counts. Poses are published for sequences 00 to 10.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from edge.errors import FeedError
from edge.feed import FeedRow
from sim.datasets import ONE_CLOCK_S, ReadOptions, Traverse
from sim.datasets.field_of_view import of_kitti
from sim.datasets.pictures import PictureFiles, list_pictures
from sim.datasets.tables import read_numbers
from sim.datasets.track import from_local

CAMERAS = "image_2", "image_3", "image_0", "image_1"


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """One camera of a sequence; `camera` is the first of CAMERAS by default, `positions` another file of poses.

    FeedError names the file that is missing, or that has another number of lines than there are pictures.
    """
    camera = options.camera or next((one for one in CAMERAS if (path / one).is_dir()), CAMERAS[0])
    names = list_pictures(path / camera)
    poses_file = Path(options.positions) if options.positions else path.parents[1] / "poses" / f"{path.name}.txt"
    times_s = read_numbers(path / "times.txt", 1, "it comes with the sequence's calibration files")[:, 0]
    poses = read_numbers(poses_file, 12, "poses are published for sequences 00 to 10; --positions takes others")
    # Of an excerpt, the names say which lines are those of its pictures.
    numbers = [int(Path(name).stem) for name in names if Path(name).stem.isdigit()]
    for file, lines in ((path / "times.txt", len(times_s)), (poses_file, len(poses))):
        if lines != len(names) and not (len(numbers) == len(names) < lines and max(numbers) < lines):
            raise FeedError(f"{file}: {lines} lines for the {len(names)} pictures in {path / camera}")
    times_s, poses = (lines if len(lines) == len(names) else lines[numbers] for lines in (times_s, poses))
    ground_m = poses.reshape(-1, 3, 4)[:, [0, 2], 3]
    ahead = poses.reshape(-1, 3, 4)[:, [0, 2], 2]
    # Poses of another source may have no rotations.
    turns = bool(np.ptp(ahead, axis=0).any())
    headings_deg = (np.degrees(np.arctan2(*ahead.T)) % 360).tolist() if turns else [None] * len(names)
    covered_m = np.concatenate([[0.0], np.linalg.norm(np.diff(ground_m, axis=0), axis=1).cumsum()])
    rows = [
        FeedRow(
            f"{camera}/{name}",
            round(time_s * 1e9),
            *from_local(x_m, y_m),
            heading_deg=heading_deg,
            distance_m=float(distance_m),
            position_source="local",
            extra={"local_x_m": f"{x_m:.3f}", "local_y_m": f"{y_m:.3f}"},
        )
        for name, time_s, (x_m, y_m), heading_deg, distance_m in zip(
            names, times_s, ground_m.tolist(), headings_deg, covered_m, strict=True
        )
    ]
    pictures = PictureFiles([path / camera / name for name in names])
    about = f"kitti-{path.name}-{camera}", f"KITTI odometry {path.name} {camera}"
    notes = "local_x_m right and local_y_m ahead of the first picture"
    fov_deg = of_kitti(path / "calib.txt", camera, pictures.read(0).shape[1])
    return Traverse(*about, tuple(rows), pictures, notes=notes, time_sigma_s=ONE_CLOCK_S, fov_deg=fov_deg)
