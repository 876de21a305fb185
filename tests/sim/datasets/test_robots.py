"""Miniatures of FrodoBots-2K and FRED, in the layouts that are published."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av")

import av

from sim.datasets import ReadOptions, open_dataset
from sim.datasets.found import find_kind
from sim.datasets.track import from_local

Degrees = Callable[[float, float], tuple[float, float]]
Refused = Callable[..., None]
BEGUN_S = 1_710_097_985.0


def write_part(file: Path, levels: list[int]) -> None:
    """A part of a video, 20 pictures a second, each of its own gray."""
    with av.open(str(file), "w", format="mpegts") as container:
        stream = container.add_stream("libx264", rate=20)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for index, level in enumerate(levels):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), level, np.uint8), "bgr24")
            frame.pts, frame.time_base = index, Fraction(1, 20)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def write_ride(ride: Path, degrees_at: Degrees) -> None:
    """4 s at 2 m/s to the east; the rear camera begins 1.5 s after the front one, and GPS jumps once."""
    (ride / "recordings").mkdir(parents=True)
    for camera, uid, late_s in (("front", 1000, 0.0), ("rear", 1001, 1.5)):
        for part in range(2):
            write_part(
                ride / f"recordings/a1b2_frodobot_20699__uid_s_{uid}__uid_e_video_2024031019130{5 + part}.ts",
                [40 + 4 * (20 * part + index) for index in range(20)],
            )
        lines = [f"{index},{BEGUN_S + late_s + index / 20:.3f}" for index in range(40)]
        (ride / f"{camera}_camera_timestamps_20699.csv").write_text("frame_id,timestamp\n" + "\n".join(lines) + "\n")
    rows = []
    for second in range(5):
        lat_deg, lon_deg = degrees_at(2.0 * second if second != 2 else 900.0, 0.0)
        rows.append(f"{lat_deg},{lon_deg},{(BEGUN_S + second) * 1000:.0f}")
    (ride / "gps_data_20699.csv").write_text("latitude,longitude,timestamp\n" + "\n".join(rows) + "\n")


def test_both_cameras_of_a_sidewalk_robot_share_the_wall_clock(tmp_path: Path, degrees_at: Degrees) -> None:
    ride = tmp_path / "ride_20699_17c99e_20240310191305"
    write_ride(ride, degrees_at)
    assert find_kind(ride) == "frodobots"
    for camera, late_s in (("front", 0.0), ("rear", 1.5)):
        found = open_dataset("frodobots", ride, ReadOptions(camera=camera))
        assert (found.view, len(found.rows)) == (camera, 40)
        for index in (0, 25):
            lat_deg, lon_deg = degrees_at(2 * (late_s + index / 20), 0.0)
            assert (found.rows[index].lat_deg, found.rows[index].lon_deg) == pytest.approx((lat_deg, lon_deg), abs=1e-7)
            assert float(found.pictures.read(index).mean()) == pytest.approx(40 + 4 * index, abs=4)
        found.pictures.close()


def test_a_ride_without_a_part_is_named(tmp_path: Path, degrees_at: Degrees, refused: Refused) -> None:
    ride = tmp_path / "ride"
    write_ride(ride, degrees_at)
    refused("frodobots", ride, "--camera: 'left' is neither front nor rear", ReadOptions(camera="left"))
    for file in (ride / "recordings").glob("*uid_s_1001*"):
        file.unlink()
    refused("frodobots", ride, r"recordings: no part of the rear video", ReadOptions(camera="rear"))
    (ride / "gps_data_20699.csv").unlink()
    refused("frodobots", ride, r"no file\(s\) gps_data_\*\.csv; a folder holds one ride")


def test_a_sequence_of_flooded_roads(tmp_path: Path, write_pictures: Callable[[Path, list[str]], None]) -> None:
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
