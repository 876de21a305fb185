"""A folder of pictures with a CSV file: columns by their usual names or by options, and what it lacks in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.__main__ import main
from edge.feed import FeedImages, read_feed
from sim.datasets import ReadOptions, open_dataset
from sim.datasets.found import find_kind

WritePictures = Callable[[Path, list[str]], None]
IndexOf = Callable[[NDArray[np.uint8]], int]
Refused = Callable[..., None]
UNIX_S = 1_777_000_000
NAMES = [f"{index}.jpg" for index in range(8)]


def table(header: str, *lines: str) -> str:
    return "\n".join([header, *lines]) + "\n"


@pytest.fixture
def drive(tmp_path: Path, write_pictures: WritePictures) -> Path:
    """Eight pictures, one a second, 5.5 m apart; those of 3 and 4 s without a position."""
    write_pictures(tmp_path / "drive", NAMES)
    lines = [
        f"{name},{UNIX_S + index}.5,{'' if index in (3, 4) else f'{-27 + index * 5e-5:.7f}'},153.0,350"
        for index, name in enumerate(NAMES)
    ]
    (tmp_path / "drive/log.csv").write_text(table("Image,Timestamp,Latitude,Lng,Heading (deg)", *lines))
    return tmp_path / "drive"


def test_usual_names_are_understood_and_shown(
    drive: Path, tmp_path: Path, index_of: IndexOf, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", str(drive), "-o", str(tmp_path / "feed"), "--spacing-frames", "2"]) == 0
    feed = read_feed(tmp_path / "feed")
    assert [index_of(FeedImages(feed).read(row)) for row in range(4)] == [0, 2, 4, 6]
    assert [row.stamp_ns for row in feed.rows] == [(UNIX_S + second) * 10**9 + 500_000_000 for second in (0, 2, 4, 6)]
    assert [row.lat_deg for row in feed.rows] == pytest.approx([-27 + index * 5e-5 for index in (0, 2, 4, 6)])
    assert feed.rows[2].heading_deg == pytest.approx(350)
    printed = capsys.readouterr().out
    for text in ("4 of 64 x 48 pixels, 0.5 a second; front camera", "33 m", "UTC", "0.jpg to 6.jpg", "Lng (lon)"):
        assert text in printed, printed
    assert "assumed to look ahead; --view rear" in printed


def test_a_table_that_excel_saved_is_read(drive: Path, tmp_path: Path) -> None:
    log = drive / "log.csv"
    log.write_bytes(b"\xef\xbb\xbf" + log.read_bytes())
    assert main(["import", str(drive), "-o", str(tmp_path / "feed")]) == 0
    assert read_feed(tmp_path / "feed").rows[0].lat_deg is not None


def test_a_view_that_is_stated_is_not_called_assumed(drive: Path, tmp_path: Path) -> None:
    assert main(["import", str(drive), "-o", str(tmp_path / "feed"), "--view", "front"]) == 0
    assert "assumed" not in read_feed(tmp_path / "feed").header.notes


@pytest.mark.parametrize(
    ("header", "line", "stamp_ns"),
    [
        ("#timestamp [ns],filename", "{0}500000000,{1}", 1_777_000_000_500_000_000),
        ("time_us,file", "{0}500000,{1}", 1_777_000_000_500_000_000),
        ("unix_time,name", "{0}500,{1}", 1_777_000_000_500_000_000),
        ("t,picture", "{2}.25,{1}", 250_000_000),
        ("utc,file", "2026-04-24T03:06:{2:02}.5Z,{1}", 1_776_999_960_500_000_000),
    ],
)
def test_times_of_each_unit(
    tmp_path: Path, write_pictures: WritePictures, header: str, line: str, stamp_ns: int
) -> None:
    """Also pictures that are named without their suffix, and no position."""
    write_pictures(tmp_path / "drive", NAMES)
    lines = [line.format(UNIX_S + index, Path(name).stem, index) for index, name in enumerate(NAMES)]
    (tmp_path / "drive.csv").write_text(table(header, *lines))
    rows = open_dataset("pictures", tmp_path / "drive").rows
    assert [row.stamp_ns for row in rows] == [stamp_ns + index * 10**9 for index in range(8)]
    assert {row.lat_deg for row in rows} == {None}


def test_pictures_that_are_named_by_their_times_lie_between_the_positions(
    tmp_path: Path, write_pictures: WritePictures
) -> None:
    write_pictures(tmp_path / "drive", [f"{UNIX_S + index}500.png" for index in range(4)])
    lines = [f"{UNIX_S + index},{-27 + index * 1e-4},153" for index in range(5)]
    (tmp_path / "drive/gps.csv").write_text(table("time,lat,lon", *lines))
    rows = open_dataset("pictures", tmp_path / "drive").rows
    assert [row.lat_deg for row in rows] == pytest.approx([-27 + (index + 0.5) * 1e-4 for index in range(4)])


def test_columns_are_named_by_an_option(drive: Path) -> None:
    text = (drive / "log.csv").read_text()
    (drive / "log.csv").write_text(text.replace("Image,Timestamp,Latitude,Lng", "a,b,c,d"))
    options = ReadOptions(columns="file=a,time=b,lat=c,lon=d")
    assert open_dataset("pictures", drive, options).rows[7].lat_deg == pytest.approx(-27 + 7 * 5e-5)


def test_all_that_is_missing_is_named_at_once(drive: Path, refused: Refused) -> None:
    file, text = drive / "log.csv", (drive / "log.csv").read_text()
    file.write_text(text.replace("Image,Timestamp,Latitude,Lng", "a,b,c,d"))
    refused("pictures", drive, r"log\.csv: no column for time, lat, lon, file among a, b, c, d, Heading \(deg\); name")
    refused("pictures", drive, r"--columns: time=z, speed: not KIND=COLUMN", ReadOptions(columns="time=z,speed"))
    file.write_text(text.replace("7.jpg", "9.jpg"))
    refused("pictures", drive, r"log\.csv: line 9: Image: no picture '9\.jpg' in .*drive")
    file.write_text(text.replace(f"{UNIX_S + 7}.5", "noon"))
    refused("pictures", drive, r"log\.csv: line 9: Timestamp: 'noon' is not a number")
    file.write_text(text.replace("Timestamp", "x"))
    refused("pictures", drive, r"log\.csv: no column for time; name it with --columns time=COLUMN, or say --fps")
    (drive / "more.csv").touch()
    refused("pictures", drive, r"--positions: name the CSV file .*; in it: log\.csv, more\.csv")


def test_each_recording_is_known_by_what_lies_there(
    drive: Path, tmp_path: Path, write_pictures: WritePictures, feed_path: Path, video_path: Path
) -> None:
    assert find_kind(drive) == "pictures"
    (drive / "log.csv").unlink()
    assert find_kind(drive) == "geotagged"
    assert find_kind(drive, "elsewhere.csv") == "pictures"
    assert find_kind(feed_path) is None
    assert find_kind(video_path) is None
    video_path.with_suffix(".gpx").touch()
    assert find_kind(video_path) == "video-log"
    (tmp_path / "night.bag").touch()
    assert find_kind(tmp_path / "night.bag") == "rosbag"
    (tmp_path / "kitti").mkdir()
    (tmp_path / "kitti/times.txt").touch()
    assert find_kind(tmp_path / "kitti") == "kitti"


def test_the_sheet_shows_what_was_understood(
    tmp_path: Path, sim_import: Callable[..., int], write_pictures: WritePictures, capsys: pytest.CaptureFixture[str]
) -> None:
    write_pictures(tmp_path / "walk", ["a.png", "b.png", "c.png"])
    (tmp_path / "walk.csv").write_text("file,t,lat,lon\na,0,51.76,-1.26\nb,1,51.7601,-1.26\nc,4,51.7602,-1.26\n")
    sim_import(tmp_path / "walk", "-o", tmp_path / "feed")
    page = (tmp_path / "feed/sheet.html").read_text()
    for what in (
        "3 of 64 x 48 pixels",
        "22 m, a frame every 11 m",
        "3.0 s, 11.1 m, before frame 2",
        "The track from above",
    ):
        assert what in page
    assert page.count("data:image/jpeg") == 2
    assert f"sheet         {tmp_path / 'feed/sheet.html'}" in capsys.readouterr().out
