"""Recordings without headings, as strangers have them, give maps whose places know how far away their points are."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from math import hypot, radians, tan
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from PIL import ExifTags, Image

import lookback
from edge.__main__ import main
from edge.feed import Feed, FeedImages, FeedRow, read_feed
from edge.feed.writer import FeedWriter
from edge.geodesy import east_north
from sim.datasets.field_of_view import APPLE
from sim.traverse import with_course
from sim.world.recording import record_drive
from sim.world.scenario import Scenario
from tests.sim.datasets.phone_video import BEGUN, write_phone_video
from tests.sim.datasets.test_recorded import sexagesimal

MakeOnce = Callable[[str, Callable[[Path], object]], Path]
Printed = pytest.CaptureFixture[str]
SCENARIO = Scenario(seed=31, length_m=60.0)
SIZE = SCENARIO.width, SCENARIO.height
FOCAL_PX = SCENARIO.width / 2 / tan(radians(SCENARIO.fov_deg / 2))
FILM_MM = FOCAL_PX * hypot(36, 24) / hypot(*SIZE)


@pytest.fixture(scope="module")
def drive(make_once: MakeOnce) -> Feed:
    """A picture every 2 m of a simulated street, without heading, distance and field of view."""
    folder = make_once("known-distances", lambda folder: record_drive(SCENARIO, folder / "feed", spacing_m=2.0))
    feed = read_feed(folder / "feed")
    rows = tuple(replace(row, heading_deg=None, distance_m=None, extra={}) for row in feed.rows)
    return replace(feed, rows=rows, header=msgspec.structs.replace(feed.header, odometer=False, fov_deg=None))


def write(feed: Feed, path: Path) -> Path:
    with FeedWriter(path, feed.header) as writer:
        for index, row in enumerate(feed.rows):
            writer.write((feed.path / feed.rows[index].file).read_bytes(), row)
    return path


def as_video(feed: Feed, folder: Path) -> list[str]:
    """Of an iPhone, with a track that has no course."""
    write_phone_video(feed, folder / "drive.mp4", {APPLE: f"{FILM_MM:.3f}"})
    points = []
    for row in feed.rows:
        time = np.datetime64(BEGUN.replace(tzinfo=None), "ms") + np.timedelta64(row.stamp_ns // 10**6, "ms")
        points.append(f'<trkpt lat="{row.lat_deg:.8f}" lon="{row.lon_deg:.8f}"><time>{time}Z</time></trkpt>')
    track = f"<trk><trkseg>{''.join(points)}</trkseg></trk>"
    said = '<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1">'
    (folder / "drive.gpx").write_text(f"{said}{track}</gpx>")
    return [str(folder / "drive.mp4"), "--offset-s", "0"]


def as_kitti(feed: Feed, folder: Path) -> list[str]:
    """With the rotations of poses left out, as some tools write them."""
    sequence = folder / "sequences/04"
    (sequence / "image_2").mkdir(parents=True)
    (folder / "poses").mkdir()
    images, poses = FeedImages(feed), ""
    for index, (east_m, north_m) in enumerate(ground_m(feed)):
        cv2.imwrite(str(sequence / f"image_2/{index:06d}.png"), images.read(index))
        poses += f"1 0 0 {east_m:e} 0 1 0 0 0 0 1 {north_m:e}\n"
    (folder / "poses/04.txt").write_text(poses)
    (sequence / "times.txt").write_text("".join(f"{row.stamp_ns / 1e9:e}\n" for row in feed.rows))
    (sequence / "calib.txt").write_text(f"P2: {FOCAL_PX:e} 0 160 0 0 {FOCAL_PX:e} 120 0 0 0 1 0\n")
    return [str(sequence)]


def as_pictures(feed: Feed, folder: Path) -> list[str]:
    """Of a camera with a receiver."""
    images = FeedImages(feed)
    (folder / "drive").mkdir()
    for index, row in enumerate(feed.rows):
        assert row.lat_deg is not None
        assert row.lon_deg is not None
        exif, gps = Image.Exif(), ExifTags.GPS
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = FILM_MM
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] = (
            f"2026:05:04 12:{index // 60:02}:{index % 60:02}"
        )
        tags: Any = exif.get_ifd(ExifTags.IFD.GPSInfo)
        tags[gps.GPSLatitudeRef], tags[gps.GPSLatitude] = "NS"[row.lat_deg < 0], sexagesimal(row.lat_deg)
        tags[gps.GPSLongitudeRef], tags[gps.GPSLongitude] = "EW"[row.lon_deg < 0], sexagesimal(row.lon_deg)
        shown = Image.fromarray(images.read(index)[..., ::-1])
        shown.save(folder / f"drive/{index:04}.jpg", quality=92, exif=exif)
    return [str(folder / "drive")]


def ground_m(feed: Feed) -> np.ndarray[Any, np.dtype[np.float64]]:
    lat_deg, lon_deg = np.array([(row.lat_deg, row.lon_deg) for row in feed.rows], dtype=float).T
    return east_north(lat_deg, lon_deg)


@pytest.mark.parametrize("recorded", [as_video, as_kitti, as_pictures])
def test_a_recording_without_headings_gives_a_map_with_distances(
    drive: Feed, tmp_path: Path, capsys: Printed, recorded: Callable[[Feed, Path], list[str]]
) -> None:
    """A picture 2 m before a place says so."""
    path = tmp_path / "map"
    assert main(["import", *recorded(drive, tmp_path), "-o", str(tmp_path / "feed"), "--spacing-m", "2"]) == 0
    assert f"field of view {SCENARIO.fov_deg:.1f} degrees" in capsys.readouterr().out
    feed = read_feed(tmp_path / "feed")
    assert {row.heading_deg for row in feed.rows} == {None}, "what was not recorded is not written"
    assert main(["map", "build", str(tmp_path / "feed"), "-o", str(path)]) == 0
    built = capsys.readouterr().out
    places = len(lookback.Map.open(path))
    assert f"no heading for most pictures of {feed.header.name}: the course of the positions is used" in built
    share = re.search(r"(\d+) of (\d+) keyframes have map points \(12 or more, \d+ in the median\)", built)
    assert share is not None
    assert int(share[1]) >= 0.9 * int(share[2]) and int(share[2]) == places
    assert main(["map", "info", str(path)]) == 0
    told = capsys.readouterr().out
    assert f"          {share[0]}\n" in told
    assert f"{feed.header.name}, front view; headings are the course of its positions\n" in told
    reference, middle = lookback.Map.open(path), places // 2
    pose = reference.pose(FeedImages(feed).read(middle), middle + 1)
    assert pose is not None
    step_m = float(np.diff(reference.places["route_m"])[middle])
    assert (pose.right_m, pose.ahead_m) == pytest.approx((0.0, -step_m), abs=0.3)


def test_a_map_without_headings_gets_them_with_its_keypoints(drive: Feed, tmp_path: Path, capsys: Printed) -> None:
    """Where its recording has positions that the map did not use, as maps of earlier versions."""
    rows = [replace(row, lat_deg=None, lon_deg=None, distance_m=2.0 * at) for at, row in enumerate(drive.rows)]
    feed = write(replace(drive, rows=tuple(rows)), tmp_path / "feed")
    assert main(["map", "build", str(feed), "-o", str(tmp_path / "map"), "--no-keypoints"]) == 0
    assert np.isnan(lookback.Map.open(tmp_path / "map").places["heading_deg"]).all()
    capsys.readouterr()
    placed = write(drive, tmp_path / "placed")
    assert main(["map", "keypoints", str(tmp_path / "map"), str(placed), "--fov-deg", "80"]) == 0
    assert f"{len(rows)} of {len(rows)} keyframes have map points" in capsys.readouterr().out
    assert np.isfinite(lookback.Map.open(tmp_path / "map").places["heading_deg"]).all()
    assert main(["map", "info", str(tmp_path / "map")]) == 0
    assert "headings are the course of its positions" in capsys.readouterr().out


def test_few_distances_have_a_reason(drive: Feed, tmp_path: Path, capsys: Printed) -> None:
    still = [replace(row, lat_deg=None, lon_deg=None) for row in drive.rows]
    driven = [replace(row, distance_m=2.0 * index) for index, row in enumerate(still)]
    sides = [replace(row, heading_deg=90.0 * (index % 4)) for index, row in enumerate(driven)]
    for number, (rows, spacing_m, why) in enumerate(
        (
            (still, 2, "the recording has neither positions nor distances for its pictures"),
            (driven, 2, "the recording has no headings, and no positions whose course would be one"),
            (drive.rows, 24, "places are 24 m apart, and a distance needs 3 within 20 m"),
            (sides, 2, "what is seen does not move as positions and a field of view of 80 degrees say"),
        )
    ):
        feed = write(replace(drive, rows=tuple(rows)), tmp_path / f"feed{number}")
        spaced = [] if rows is still else ["--spacing-m", str(spacing_m)]
        assert main(["map", "build", str(feed), "-o", str(tmp_path / f"map{number}"), "--fov-deg", "80", *spaced]) == 0
        assert f": few, since {why}" in capsys.readouterr().out


@pytest.mark.parametrize(("noise_m", "off_m"), [(0.0, 0.5), (3.0, 1.5)])
def test_pictures_at_irregular_spacing_have_distances(
    drive: Feed, tmp_path: Path, capsys: Printed, noise_m: float, off_m: float
) -> None:
    """4 to 12 m apart, as those of a phone each second: none of them has two others within 10 m on each side.

    Where positions are off by some meters, as a phone's, their course turns where the camera does not.
    """
    kept = [0, 5, 8, 13, 15, 20, 23, 28]
    noise_deg = np.random.default_rng(0).normal(0, noise_m / 111_230.0, (2, len(drive.rows)))
    rows = tuple(
        replace(
            drive.rows[at],
            lat_deg=(drive.rows[at].lat_deg or 0.0) + north,
            lon_deg=(drive.rows[at].lon_deg or 0.0) + east,
        )
        for at, north, east in zip(kept, *noise_deg, strict=False)
    )
    with FeedWriter(tmp_path / "feed", drive.header) as writer:
        for row in rows:
            writer.write((drive.path / row.file).read_bytes(), row)
    command = ["map", "build", str(tmp_path / "feed"), "-o", str(tmp_path / "map"), "--fov-deg", "80"]
    assert main([*command, "--spacing-frames", "1"]) == 0
    share = re.search(r"(\d+) of 8 keyframes have map points", capsys.readouterr().out)
    assert share is not None and int(share[1]) >= 6
    reference = lookback.Map.open(tmp_path / "map")
    pose = reference.pose(FeedImages(drive).read(kept[4] - 1), 4)
    assert pose is not None and (pose.right_m, pose.ahead_m) == pytest.approx((0.0, -2.0), abs=off_m)


def test_the_course_is_that_of_some_meters_and_unknown_where_it_stands(drive: Feed) -> None:
    """North, a minute of wandering at a crossing, and on to the east."""
    rng = np.random.default_rng(0)
    north = [(0.0, float(y)) for y in range(0, 60, 2)]
    east = [(float(x), 60.0) for x in range(2, 60, 2)]
    stood = (rng.normal(0, 0.7, (60, 2)) + np.array([0.0, 60.0])).tolist()
    at_m = np.array([*north, *stood, *east])
    rows = tuple(
        FeedRow("", index * 10**9, 50 + y_m / 111_230.0, 8 + x_m / 71_700.0)
        for index, (x_m, y_m) in enumerate(at_m.tolist())
    )
    found = with_course(replace(drive, rows=rows))
    deg = np.array([np.nan if row.heading_deg is None else row.heading_deg for row in found.rows])
    assert found.header.heading_is_course
    off_deg = (deg[[*range(27), *range(-26, 0)]] - np.repeat([0, 90], [27, 26]) + 180) % 360 - 180
    assert off_deg == pytest.approx(0.0, abs=0.5)
    assert np.isnan(deg[34:86]).mean() > 0.9
    some = replace(
        drive, rows=tuple(replace(row, heading_deg=7.0 if at % 3 == 0 else None) for at, row in enumerate(rows))
    )
    assert with_course(some).rows == found.rows, "headings of a few rows are of no use"
    most = replace(drive, rows=tuple(replace(row, heading_deg=7.0 if at % 3 else None) for at, row in enumerate(rows)))
    assert with_course(most) is most
    assert with_course(found) is found, "what has headings keeps them"
