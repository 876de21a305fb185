"""Miniatures of FRED, and of what docs/recordings.md has a recipe for, in the layouts that are published."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

pytest.importorskip("av")

import av

from edge.feed import read_feed
from sim.datasets import ReadOptions, open_dataset
from sim.datasets.found import find_kind
from sim.datasets.track import from_local

Degrees = Callable[[float, float], tuple[float, float]]
Import = Callable[..., int]
WritePictures = Callable[[Path, list[str]], None]
EXAMPLES = Path(__file__).parents[3] / "docs/examples"
BEGUN_S = 1_710_097_985.0


def write_part(
    file: Path, levels: list[int], codec: Literal["libx264", "libx265"] = "libx264", layout: str = "mpegts"
) -> None:
    """A part of a video, 20 pictures a second, each of its own gray."""
    with av.open(str(file), "w", format=layout) as container:
        stream = container.add_stream(codec, rate=20)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for index, level in enumerate(levels):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), level, np.uint8), "bgr24")
            frame.pts, frame.time_base = index, Fraction(1, 20)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def test_both_cameras_of_a_sidewalk_robot_share_the_wall_clock(
    tmp_path: Path, degrees_at: Degrees, sim_import: Import
) -> None:
    """4 s at 2 m/s to the east; the rear camera begins 1.5 s after the front one."""
    (tmp_path / "recordings").mkdir()
    rows = [
        f"{lat},{lon},{(BEGUN_S + second) * 1000:.0f}"
        for second in range(5)
        for lat, lon in [degrees_at(2.0 * second, 0)]
    ]
    (tmp_path / "gps_data_20699.csv").write_text("\n".join(["latitude,longitude,timestamp", *rows, ""]))
    for camera, uid, late_s in (("front", "1000", 0.0), ("rear", "1001", 1.5)):
        for part in range(2):
            name = f"a1b2_frodobot_20699__uid_s_{uid}__uid_e_video_2024031019130{5 + part}.ts"
            write_part(tmp_path / "recordings" / name, [40 + 4 * (20 * part + index) for index in range(20)])
        lines = [f"{index},{BEGUN_S + late_s + index / 20:.3f}" for index in range(40)]
        times = tmp_path / f"{camera}_camera_timestamps_20699.csv"
        times.write_text("\n".join(["frame_id,timestamp", *lines, ""]))
        subprocess.run([sys.executable, EXAMPLES / "frodobots_pictures.py", camera, uid], cwd=tmp_path, check=True)
        positions = ("--positions", tmp_path / "gps_data_20699.csv", "--view", camera)
        found = open_dataset("pictures", tmp_path / camera, ReadOptions(positions=str(positions[1])))
        assert len(found.rows) == 40
        for index in (0, 25):
            at = degrees_at(2 * (late_s + index / 20), 0.0)
            assert (found.rows[index].lat_deg, found.rows[index].lon_deg) == pytest.approx(at, abs=1e-7)
            assert float(found.pictures.read(index).mean()) == pytest.approx(40 + 4 * index, abs=4)
        sim_import("pictures", tmp_path / camera, *positions, "-o", tmp_path / f"{camera}_feed")
        assert read_feed(tmp_path / f"{camera}_feed").header.view == camera


def test_names_of_vpr_datasets_downloader(
    tmp_path: Path, write_pictures: WritePictures, index_of: Callable[..., int]
) -> None:
    names = [
        "@0500234.35@6957706.19@56@J@-27.50407@0153.00237@180809_1545_00010@@270@@@@@@.jpg",
        "@0500240.10@6957706.19@56@J@-27.50408@0153.00243@180809_1545_00002@@@@@@@@.jpg",
    ]
    write_pictures(tmp_path / "queries", names)
    subprocess.run(["sh", "-e", EXAMPLES / "utm_names.sh"], cwd=tmp_path, check=True)
    traverse = open_dataset("pictures", tmp_path / "queries", ReadOptions(fps=1.0))
    assert [row.file for row in traverse.rows] == names[::-1], "by pano_id, not by name"
    last = traverse.rows[1]
    assert (last.lat_deg, last.lon_deg) == pytest.approx((-27.50407, 153.00237))
    assert index_of(traverse.pictures.read(1)) == 0


def test_the_columns_of_teslas_extractor(tmp_path: Path, write_pictures: WritePictures) -> None:
    write_pictures(tmp_path / "clip", [f"{number:06}.jpg" for number in range(1, 4)])
    rows = [f"1,GEAR_DRIVE,{number},10.5,{51 + number / 1e5},7.1,90" for number in range(3)]
    header = "version,gear_state,frame_seq_no,vehicle_speed_mps,latitude_deg,longitude_deg,heading_deg"
    (tmp_path / "clip.csv").write_text("\n".join([header, *rows, ""]))
    options = ReadOptions(columns="speed=vehicle_speed_mps", fps=36.0)
    found = open_dataset("pictures", tmp_path / "clip", options)
    assert [row.lat_deg for row in found.rows] == pytest.approx([51.0, 51.00001, 51.00002])
    assert {(row.speed_mps, row.heading_deg) for row in found.rows} == {(10.5, 90.0)}


def test_a_sequence_of_flooded_roads(tmp_path: Path, write_pictures: WritePictures) -> None:
    sequence = tmp_path / "Cambogan_20250811_113017"
    stamps_us = [1_754_875_817_000_000 + 100_000 * index for index in range(6)]
    for folder in ("front-imgs", "back-imgs"):
        write_pictures(sequence / folder, [f"{stamp_us}.png" for stamp_us in stamps_us])
    (sequence / "utm").mkdir()
    for index, stamp_us in enumerate(stamps_us):
        (sequence / f"utm/{stamp_us + 20_000}.txt").write_text(f"{512_000.0 + index} {6_943_000.0}\n")
    assert find_kind(sequence) == "fred"
    rear = open_dataset("fred", sequence, ReadOptions(camera="rear"))
    assert (rear.view, len(rear.rows), rear.rows[0].lat_deg) == ("rear", 6, None)
    first = rear.rows[1]
    assert (first.lat_deg, first.lon_deg) == pytest.approx(from_local(512_000.8, 6_943_000.0, "56J"), abs=1e-7)
    assert first.position_source == "gps"
    assert -27.7 < (first.lat_deg or 0.0) < -27.6
