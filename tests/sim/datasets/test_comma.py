"""A segment of comma2k19, written as its README and Example_1 have it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Transformer

pytest.importorskip("av")

from sim.datasets import open_dataset
from sim.datasets.comma import ARRAYS
from sim.datasets.found import find_kind
from tests.sim.datasets.test_recipes import write_part

COUNT, SPEED_MPS, BOOT_S = 41, 8.0, 46408.547498


def save(file: Path, values: NDArray[np.float64]) -> None:
    with file.open("wb") as output:  # np.save adds a suffix to the name of a file
        np.save(output, values)


@pytest.fixture
def segment(tmp_path: Path, degrees_at: Callable[..., tuple[float, float]]) -> Path:
    """Two seconds of driving north-east at 8 m/s, 30 m high; frame i is of the gray 20 + 5 i."""
    path = tmp_path / "b0c9d2329ad1606b|2018-08-02--08-34-47" / "40"
    (path / "global_pose").mkdir(parents=True)
    to_ecef = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    away_m = SPEED_MPS / 20 * np.sqrt(0.5) * np.arange(COUNT)
    lat, lon = np.array([degrees_at(m, m) for m in away_m]).T
    at_m, above_m = (np.column_stack(to_ecef.transform(lon, lat, np.full(COUNT, high))) for high in (30.0, 31.0))
    ahead = np.broadcast_to((at_m[-1] - at_m[0]) / np.linalg.norm(at_m[-1] - at_m[0]), at_m.shape)
    turned = np.stack([ahead, np.cross(at_m - above_m, ahead), at_m - above_m], axis=2)  # columns: ahead, right, down
    w = np.sqrt(1 + np.trace(turned, axis1=1, axis2=2)) / 2
    axis = [(turned[:, i, j] - turned[:, j, i]) / (4 * w) for i, j in ((2, 1), (0, 2), (1, 0))]
    poses = BOOT_S + np.arange(COUNT) / 20, at_m, SPEED_MPS * ahead, np.column_stack([w, *axis])
    for name, values in zip(ARRAYS, poses, strict=True):
        save(path / f"global_pose/frame_{name}", values)
    write_part(path / "video.hevc", list(range(20, 20 + 5 * COUNT, 5)), "libx265", "hevc")
    return path


def test_each_frame_is_at_its_pose(segment: Path, degrees_at: Callable[..., tuple[float, float]]) -> None:
    traverse = open_dataset(str(find_kind(segment)), segment)
    assert (len(traverse.rows), traverse.fov_deg) == (COUNT, 65.2)
    first = float(traverse.pictures.read(0).mean())
    for index in (17, 40):
        row, along_m = traverse.rows[index], SPEED_MPS * index / 20 * np.sqrt(0.5)
        assert row.stamp_ns == pytest.approx((BOOT_S + index / 20) * 1e9, abs=1e3)
        assert (row.lat_deg, row.lon_deg) == pytest.approx(degrees_at(along_m, along_m), abs=1e-8)
        assert (row.alt_m, row.heading_deg, row.speed_mps) == pytest.approx((30, 45, SPEED_MPS), abs=1e-3)
        assert float(traverse.pictures.read(index).mean()) - first == pytest.approx(5 * index, abs=2)


def test_what_is_missing_is_one_line(segment: Path, refused: Callable[..., None]) -> None:
    times, *others = (segment / f"global_pose/frame_{name}" for name in ARRAYS)
    save(times, np.load(times)[:40])
    refused("comma2k19", segment, "global_pose: cannot read its poses: .*dimension")
    for file in others:
        save(file, np.load(file)[:40])
    refused("comma2k19", segment, "video.hevc: 41 frames for the 40 poses in global_pose")
    times.unlink()
    refused("comma2k19", segment, "cannot read its poses: .*frame_times")
    (segment / "global_pose").rename(segment / "gone")
    for name in ("rlog", "rlog.bz2", "rlog.zst"):
        (segment / name).touch()
        refused(str(find_kind(segment)), segment, "only openpilot's tools read an rlog; .* import fcamera.mp4")
        (segment / name).unlink()
