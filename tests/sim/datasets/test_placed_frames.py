"""Frames with positions: KITTI odometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.feed import FeedImages, read_feed
from edge.geodesy import east_north_of
from sim.compare.truth import errors_between, points_of
from sim.datasets import ReadOptions, open_dataset
from sim.datasets.track import from_local

WritePictures = Callable[[Path, list[str]], None]
IndexOf = Callable[[NDArray[np.uint8]], int]
Import = Callable[..., int]
Refused = Callable[..., None]


@pytest.fixture
def kitti_path(tmp_path: Path, write_pictures: WritePictures) -> Path:
    """Ten pictures 0.5 m apart, ahead and then to the right; the road climbs, which y (down) shows."""
    sequence = tmp_path / "dataset/sequences/00"
    write_pictures(sequence / "image_2", [f"{i:06d}.png" for i in range(10)])
    (sequence / "times.txt").write_text("".join(f"{0.1037 * i:.6e}\n" for i in range(10)))
    lines = []
    for i in range(10):
        x_m, z_m = 0.5 * max(i - 5, 0), 0.5 * min(i, 5)
        pose = np.column_stack([np.eye(3), [x_m, -0.02 * i, z_m]])
        lines.append(" ".join(f"{value:.6e}" for value in pose.ravel()))
    (tmp_path / "dataset/poses").mkdir()
    (tmp_path / "dataset/poses/00.txt").write_text("\n".join(lines) + "\n")
    return sequence


def test_kitti_has_local_positions(kitti_path: Path, tmp_path: Path, sim_import: Import) -> None:
    rows = open_dataset("kitti", kitti_path).rows
    assert [row.distance_m for row in rows] == pytest.approx(np.arange(10) * 0.5)
    assert rows[8].extra == {"local_x_m": "1.500", "local_y_m": "2.500"}
    assert (rows[8].stamp_ns, rows[8].position_source, rows[8].file) == (829_600_000, "local", "image_2/000008.png")
    at = rows[8].lat_deg, rows[8].lon_deg
    assert from_local(1.5, 2.5) == at
    assert east_north_of(*at, (0.0, 0.0)) == pytest.approx((1.5, 2.5), abs=1e-4)
    sim_import("kitti", kitti_path, "-o", tmp_path / "feed", "--spacing-m", 1, "--width", 32)
    feed = read_feed(tmp_path / "feed")
    assert [row.extra["source_frame"] for row in feed.rows] == ["0", "2", "4", "6", "8"]
    assert FeedImages(feed).read(4).shape == (24, 32, 3)
    errors_m = errors_between(*points_of("positions", feed, feed))
    assert errors_m[1, 4] == pytest.approx(math.hypot(1.5, 1.5))
    assert np.flatnonzero(errors_m[2] <= 1.2).tolist() == [1, 2, 3]


def test_of_an_excerpt_of_kitti_the_names_say_which_lines_are_its(kitti_path: Path) -> None:
    for number in (0, 1, 2, 9):
        (kitti_path / f"image_2/{number:06d}.png").unlink()
    (kitti_path / "image_2").rename(kitti_path / "image_0")
    rows = open_dataset("kitti", kitti_path).rows
    assert [row.file[:7] + row.file[-5] for row in rows] == [f"image_0{number}" for number in range(3, 9)]
    assert (rows[5].stamp_ns, rows[5].extra["local_x_m"], rows[5].distance_m) == (829_600_000, "1.500", 2.5)


def test_kitti_is_found_from_inside_its_folder(kitti_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(kitti_path)
    assert open_dataset("kitti", Path()).name == "kitti-00-image_2"


def test_kitti_files_that_do_not_belong_together_are_named(kitti_path: Path, refused: Refused) -> None:
    poses, times = kitti_path.parents[1] / "poses/00.txt", kitti_path / "times.txt"
    whole = poses.read_text()
    poses.write_text("\n".join(whole.splitlines()[:9]))
    refused("kitti", kitti_path, r"poses/00\.txt: 9 lines for the 10 pictures in .*sequences/00/image_2")
    poses.write_text(whole.replace("0.000000e+00", "", 1))
    refused("kitti", kitti_path, r"poses/00\.txt: line 1: not 12 numbers")
    poses.unlink()
    refused("kitti", kitti_path, r"poses/00\.txt: cannot read it: No such file.*published for sequences 00 to 10")
    times.write_text("0.0\nx\n")
    refused("kitti", kitti_path, r"times\.txt: line 2: not 1 number: 'x'")
    refused("kitti", kitti_path, r"image_3: cannot read this folder: No such file", ReadOptions(camera="image_3"))
