"""Oxford RobotCar, written as its downloads unpack."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.errors import FeedError, FrameError
from edge.feed import FeedImages, read_feed
from sim.compare.truth import errors_between, points_of
from sim.datasets import ReadOptions, open_dataset

Degrees = Callable[[float, float], tuple[float, float]]

START_US = 1_418_133_669_281_193  # a frame of 2014-12-09-13-21-02
PICTURE_US, INS_US, GPS_US = 62_500, 20_000, 200_000  # 16, 50 and 5 Hz
SPEED_MPS = 8.0
INS_HEADER = (
    "timestamp,ins_status,latitude,longitude,altitude,northing,easting,down,utm_zone,"
    "velocity_north,velocity_east,velocity_down,roll,pitch,yaw"
)
GPS_HEADER = (
    "timestamp,num_satellites,latitude,longitude,altitude,latitude_sigma,longitude_sigma,altitude_sigma,"
    "northing,easting,down,utm_zone"
)
PATTERNS = {"stereo/left": "gbrg", "mono_rear": "rggb"}  # BAYER_STEREO and BAYER_MONO of the SDK's image.py


def mosaic(rgb: tuple[int, int, int], pattern: str, height: int, width: int) -> NDArray[np.uint8]:
    """What a sensor with this color filter sees of an even color: the pattern's letters, row by row, 2 x 2."""
    level = dict(zip("rgb", rgb, strict=True))
    raw = np.empty((height, width), np.uint8)
    for row in range(height):
        for column in range(width):
            raw[row, column] = level[pattern[2 * (row % 2) + column % 2]]
    return raw


@pytest.fixture
def traverse_path(tmp_path: Path, degrees_at: Degrees) -> Path:
    """Two seconds of driving north-east at 8 m/s, seen by two cameras; picture i has red 40 + 4 i."""
    path = tmp_path / "2014-12-09-13-21-02"
    for camera, pattern in PATTERNS.items():
        (path / camera).mkdir(parents=True)
        stamps = [START_US + i * PICTURE_US for i in range(33)]
        times = "".join(f"{stamp_us} 1\n" for stamp_us in stamps)
        (path / f"{camera.split('/', maxsplit=1)[0]}.timestamps").write_text(times)
        for index, stamp_us in enumerate(stamps):
            raw = mosaic((40 + 4 * index, 110, 70), pattern, 24, 32)
            assert cv2.imwrite(str(path / camera / f"{stamp_us}.png"), raw)
    (path / "gps").mkdir()
    write_ins(path, degrees_at, START_US, 101)
    lines = []
    for i in range(11):
        lat_deg, lon_deg = where(degrees_at, i * GPS_US)
        lines.append(f"{START_US + i * GPS_US},7,{lat_deg:.15f},{lon_deg:.15f},110.2,1,1,2,0,0,-110.2,30U")
    (path / "gps/gps.csv").write_text("\n".join([GPS_HEADER, *lines, ""]))
    return path


def where(degrees_at: Degrees, after_us: int) -> tuple[float, float]:
    along_m = SPEED_MPS * after_us / 1e6
    return degrees_at(along_m * math.sqrt(0.5), along_m * math.sqrt(0.5))


def write_ins(path: Path, degrees_at: Degrees, start_us: int, count: int) -> None:
    lines = [f"{start_us + PICTURE_US},INS_ALIGNING,51.9,-1.3,0.0,0,0,0,30U,0,0,0,0,0,0"]
    each_mps = SPEED_MPS * math.sqrt(0.5)
    for i in range(count):
        lat_deg, lon_deg = where(degrees_at, i * INS_US)
        lines.append(
            f"{start_us + i * INS_US},INS_SOLUTION_GOOD,{lat_deg:.15f},{lon_deg:.15f},110.5,5735000.1,620000.2,-110.5,"
            f"30U,{each_mps},{each_mps},0,0.01,0.02,{math.pi / 4}"
        )
    (path / "gps/ins.csv").write_text("\n".join([INS_HEADER, *lines, ""]))


@pytest.mark.parametrize(("camera", "view", "crop_rows"), [("stereo/left", "front", 160), ("mono_rear", "rear", 170)])
def test_pictures_are_in_color_by_the_pattern_of_their_camera(
    traverse_path: Path, camera: str, view: str, crop_rows: int
) -> None:
    traverse = open_dataset("robotcar", traverse_path, ReadOptions(camera=camera, crop_bottom=4))
    image = traverse.pictures.read(5)
    assert image.shape == (20, 32, 3)
    assert image[2:-2, 2:-2].reshape(-1, 3).tolist() == [[70, 110, 60]] * (16 * 28)
    assert traverse.view == view
    with pytest.raises(FeedError, match=f"--crop-bottom: {crop_rows} rows of 24 leave nothing"):
        open_dataset("robotcar", traverse_path, ReadOptions(camera=camera)).pictures.read(0)


@pytest.mark.parametrize("positions", ["ins", "gps"])
def test_each_picture_is_at_the_position_of_its_time(traverse_path: Path, degrees_at: Degrees, positions: str) -> None:
    rows = open_dataset("robotcar", traverse_path, ReadOptions(positions=positions)).rows
    assert len(rows) == 33
    for index, row in enumerate(rows):
        assert row.stamp_ns == (START_US + index * PICTURE_US) * 1000
        # A meter is 9e-6 degrees of latitude: this is a millimeter.
        assert (row.lat_deg, row.lon_deg) == pytest.approx(where(degrees_at, index * PICTURE_US), abs=1e-8)
    known = rows[7].alt_m, rows[7].heading_deg, rows[7].speed_mps
    assert known == (pytest.approx((110.5, 45.0, SPEED_MPS)) if positions == "ins" else (110.2, None, None))


def test_the_paper_s_sampling_and_tolerance(
    traverse_path: Path, tmp_path: Path, sim_import: Callable[..., int]
) -> None:
    for camera, name in (("stereo/left", "front"), ("mono_rear", "rear")):
        sim_import("robotcar", traverse_path, "-o", tmp_path / name, "--camera", camera, "--crop-bottom", 4)
    front, rear = read_feed(tmp_path / "front"), read_feed(tmp_path / "rear")
    assert (front.header.view, rear.header.view, front.header.height) == ("front", "rear", 20)
    distances_m = [row.distance_m for row in front.rows]
    assert distances_m == pytest.approx(np.arange(0, 16.1, 2), abs=1e-3)
    assert [row.extra["source_frame"] for row in front.rows] == [str(i) for i in range(0, 33, 4)]
    assert FeedImages(front).read(3)[8, 16].tolist() == pytest.approx([70, 110, 40 + 4 * 12], abs=3)
    errors_m = errors_between(*points_of("positions", rear, front))
    assert np.flatnonzero(errors_m[4] <= 5.0).tolist() == [2, 3, 4, 5, 6]


def test_only_the_downloaded_part_of_a_traverse_is_read(traverse_path: Path) -> None:
    for picture in sorted((traverse_path / "stereo/left").iterdir())[10:]:
        picture.unlink()
    assert len(open_dataset("robotcar", traverse_path).rows) == 10


def test_pictures_beyond_the_positions_have_none_and_are_left_out(
    traverse_path: Path,
    tmp_path: Path,
    degrees_at: Degrees,
    sim_import: Callable[..., int],
    caplog: pytest.LogCaptureFixture,
) -> None:
    write_ins(traverse_path, degrees_at, START_US, 52)  # the first 1.02 s
    rows = open_dataset("robotcar", traverse_path).rows
    assert [row.lat_deg is None for row in rows] == [False] * 17 + [True] * 16
    sim_import("robotcar", traverse_path, "-o", tmp_path / "feed", "--crop-bottom", 4)
    assert len(read_feed(tmp_path / "feed").rows) == 5
    assert "16 of 33 pictures have no position; skipped" in caplog.text


def test_positions_of_another_day_are_one_line_that_names_both(traverse_path: Path, degrees_at: Degrees) -> None:
    write_ins(traverse_path, degrees_at, START_US + 86_400_000_000, 101)
    with pytest.raises(FeedError) as raised:
        open_dataset("robotcar", traverse_path)
    assert str(raised.value) == (
        f"{traverse_path}/stereo/left: taken from 1418133669.281 to 1418133671.281 s, where {traverse_path}/gps/ins.csv"
        " has no positions (its first is of 1418220069.281, its last of 1418220071.281 s)"
    )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: (path / "gps/ins.csv").unlink(), r"gps/ins\.csv: cannot read it: No such file.*--positions"),
        (lambda path: (path / "stereo.timestamps").unlink(), r"stereo\.timestamps: cannot read it: No such file"),
        (lambda path: (path / "stereo/left").rename(path / "gone"), r"stereo/left: no such folder"),
        (lambda path: [f.unlink() for f in (path / "stereo/left").iterdir()], r"none of the 33 pictures that stereo\."),
        (
            lambda path: (path / "stereo.timestamps").write_text("141813 1\nnext\n"),
            r"timestamps: line 2: not 2 numbers",
        ),
        (
            lambda path: (path / "gps/ins.csv").write_text(f"{INS_HEADER}\n141813,X,north{',0' * 12}\n"),
            r"ins\.csv: line 2: latitude: 'north' is not a number",
        ),
        (lambda path: (path / "gps/ins.csv").write_text("time,lat\n1,2\n"), r"ins\.csv: no column timestamp"),
        (
            lambda path: (path / "gps/ins.csv").write_text(f"{INS_HEADER}\n1,2\n"),
            r"ins\.csv: line 2: not as many values",
        ),
        (lambda path: (path / "gps/ins.csv").write_text(f"{INS_HEADER}\n"), r"ins\.csv: nothing in it but"),
    ],
)
def test_what_is_missing_or_malformed_is_one_line_that_names_it(
    traverse_path: Path, spoil: Callable[[Path], object], message: str
) -> None:
    spoil(traverse_path)
    with pytest.raises(FeedError, match=message) as raised:
        open_dataset("robotcar", traverse_path)
    assert str(raised.value).startswith(str(traverse_path))
    assert "\n" not in str(raised.value)


def test_a_torn_picture_is_named_and_may_be_left_out(
    traverse_path: Path, tmp_path: Path, sim_import: Callable[..., int]
) -> None:
    torn = traverse_path / f"stereo/left/{START_US + 4 * PICTURE_US}.png"
    torn.write_bytes(torn.read_bytes()[:60])
    with pytest.raises(FrameError, match=rf"{torn.name}: not a complete"):
        open_dataset("robotcar", traverse_path, ReadOptions(crop_bottom=0)).pictures.read(4)
    arguments = ("robotcar", traverse_path, "-o", tmp_path / "feed", "--crop-bottom", 4)
    with pytest.raises(FeedError, match=rf"{torn.name}: not a complete .*; --skip-unreadable skips"):
        sim_import(*arguments)
    assert sorted(path.name for path in tmp_path.iterdir()) == [traverse_path.name]
    sim_import(*arguments, "--skip-unreadable")
    assert [row.extra["source_frame"] for row in read_feed(tmp_path / "feed").rows][:3] == ["0", "8", "12"]


def test_a_camera_that_the_car_does_not_have_is_refused(traverse_path: Path) -> None:
    with pytest.raises(FeedError, match=r"--camera: 'front' is no camera of RobotCar; it is one of stereo/left"):
        open_dataset("robotcar", traverse_path, ReadOptions(camera="front"))
