"""Recordings that carry their own positions: geotagged pictures, and video beside an autopilot's log."""

from __future__ import annotations

import json
import math
import shutil
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pynmea2
import pytest
from fitdecode.utils import compute_crc
from PIL import ExifTags, Image
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.__main__ import main
from edge.errors import FeedError
from edge.feed import FeedImages, FeedOptions, read_feed
from edge.geodesy import east_north
from sim.datasets import ReadOptions, open_dataset
from sim.datasets.flight_logs import read_log
from sim.datasets.found import find_kind, read_drive

WriteVideo = Callable[[Path, int, float], None]
Degrees = Callable[[float, float], tuple[float, float]]
Refused = Callable[..., None]

SPEED_MPS = 5.0


# Geotagged pictures


def sexagesimal(degrees: float) -> tuple[float, float, float]:
    minutes = abs(degrees) % 1 * 60
    return float(int(abs(degrees))), float(int(minutes)), minutes % 1 * 60


def geotag(file: Path, taken: str | None, position: tuple[float, float] | None, **gps: Any) -> None:
    """A small JPEG as cameras write it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    if taken:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] = taken.partition(".")[0]
        if "." in taken:
            exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.SubsecTimeOriginal] = taken.partition(".")[2]
    tags = exif.get_ifd(ExifTags.IFD.GPSInfo)
    if position:
        lat_deg, lon_deg = position
        tags[ExifTags.GPS.GPSLatitudeRef], tags[ExifTags.GPS.GPSLatitude] = "NS"[lat_deg < 0], sexagesimal(lat_deg)
        tags[ExifTags.GPS.GPSLongitudeRef], tags[ExifTags.GPS.GPSLongitude] = "EW"[lon_deg < 0], sexagesimal(lon_deg)
    for name, value in gps.items():
        tags[ExifTags.GPS[name]] = value
    Image.new("RGB", (64, 48), (90, 90, 90)).save(file, exif=exif)


def test_geotagged_pictures_are_put_in_the_order_of_their_times(tmp_path: Path) -> None:
    below_sea = {"GPSAltitude": 3.5, "GPSAltitudeRef": b"\x01", "GPSTrack": 270.5, "GPSTrackRef": "T"}
    geotag(tmp_path / "b.jpg", "2024:05:01 10:00:00.25", (-27.4772, 153.0283), **below_sea)
    geotag(tmp_path / "a.jpg", "2024:05:01 10:00:00.5", (51.76, -1.26), GPSTrack=10.0, GPSTrackRef="M")
    geotag(tmp_path / "c.jpg", "2024:05:01 09:59:59", None)
    rows = open_dataset("geotagged", tmp_path).rows
    assert [row.file for row in rows] == ["c.jpg", "b.jpg", "a.jpg"]
    start_ns = 1_714_557_600_000_000_000  # 2024-05-01T10:00:00Z
    assert [row.stamp_ns - start_ns for row in rows] == [-1_000_000_000, 250_000_000, 500_000_000]
    assert (rows[0].lat_deg, rows[0].lon_deg) == (None, None)
    assert (rows[1].lat_deg, rows[1].lon_deg) == pytest.approx((-27.4772, 153.0283), abs=1e-7)
    assert (rows[1].alt_m, rows[1].heading_deg) == (-3.5, 270.5)
    assert (rows[2].lat_deg, rows[2].lon_deg) == pytest.approx((51.76, -1.26), abs=1e-7)
    assert (rows[2].alt_m, rows[2].heading_deg) == (None, None)  # a magnetic heading is another thing


def test_what_mapillary_wrote_replaces_time_and_position(tmp_path: Path, refused: Refused) -> None:
    told = {"MAPLatitude": 51.76, "MAPLongitude": -1.26, "MAPCaptureTime": "2024_05_01_10_00_00_250"}
    for name, tags in (("a.jpg", told), ("b.jpg", {**told, "MAPCaptureTime": "2024_05_01_10_00_01_500"})):
        exif = Image.Exif()
        exif[ExifTags.Base.ImageDescription] = json.dumps(tags)
        Image.new("RGB", (64, 48), (90, 90, 90)).save(tmp_path / name, exif=exif)
    rows = open_dataset("geotagged", tmp_path).rows
    assert [row.stamp_ns - 1_714_557_600_000_000_000 for row in rows] == [250_000_000, 1_500_000_000]
    assert (rows[0].lat_deg, rows[0].lon_deg) == (51.76, -1.26)
    exif[ExifTags.Base.ImageDescription] = '{"MAPLatitude": 51.76}'
    Image.new("RGB", (64, 48), (90, 90, 90)).save(tmp_path / "b.jpg", exif=exif)
    refused("geotagged", tmp_path, r"b\.jpg: its EXIF data are damaged")


def test_geotagged_pictures_become_a_feed(tmp_path: Path, degrees_at: Degrees, sim_import: Callable[..., int]) -> None:
    for index in range(10):  # two a second, whose clock has no fractions
        geotag(tmp_path / f"drive/{index}.jpg", f"2024:05:01 10:00:{index // 2:02d}", degrees_at(0.0, 1.5 * index))
    geotag(tmp_path / "drive/tunnel.jpg", "2024:05:01 10:00:04", None)
    stamps_ns = [row.stamp_ns for row in open_dataset("geotagged", tmp_path / "drive").rows]
    assert np.diff(stamps_ns).tolist() == [1, 999_999_999] * 4 + [1, 1]
    sim_import("geotagged", tmp_path / "drive", "-o", tmp_path / "feed", "--spacing-m", 3, "--view", "rear")
    feed = read_feed(tmp_path / "feed")
    assert [row.extra["source_file"] for row in feed.rows] == ["0.jpg", "2.jpg", "4.jpg", "6.jpg", "8.jpg"]
    assert [row.distance_m for row in feed.rows] == pytest.approx([0, 3, 6, 9, 12], abs=1e-3)
    assert feed.header.view == "rear"


def test_pictures_without_positions_or_times_and_broken_ones_are_named(tmp_path: Path, refused: Refused) -> None:
    geotag(tmp_path / "0.jpg", "2024:05:01 10:00:00", None)
    (row,) = open_dataset("geotagged", tmp_path).rows
    assert (row.stamp_ns, row.lat_deg) == (1_714_557_600_000_000_000, None)
    geotag(tmp_path / "1.jpg", None, (51.0, -1.0))
    refused("geotagged", tmp_path, r"1\.jpg: no DateTimeOriginal in its EXIF data")
    geotag(tmp_path / "1.jpg", "yesterday", (51.0, -1.0))
    refused("geotagged", tmp_path, r"1\.jpg: its EXIF data are damaged")
    (tmp_path / "1.jpg").write_bytes(b"\xff\xd8\xff\xe1 no picture")
    refused("geotagged", tmp_path, r"1\.jpg: cannot read this picture: ")


PHONE = Path(__file__).with_name("phone.heic")
"""64 x 48 pixels, red left and blue right, at 51.76, -1.26 at 12:30 on 2026-05-04: written by pillow-heif 1.8.1."""


def test_pictures_of_phones_are_pictures(tmp_path: Path) -> None:
    """Beside others and alone; a folder of them is described as well."""
    geotag(tmp_path / "a.jpg", "2026:05:04 12:29:00", (51.76, -1.26))
    shutil.copy(PHONE, tmp_path / "IMG_1.HEIC")
    traverse = open_dataset(str(find_kind(tmp_path)), tmp_path)
    assert [row.file for row in traverse.rows] == ["a.jpg", "IMG_1.HEIC"]
    assert (traverse.rows[1].lat_deg, traverse.rows[1].lon_deg) == pytest.approx((51.76, -1.26), abs=1e-6)
    image = traverse.pictures.read(1)
    assert image.shape == (48, 64, 3) and np.allclose(image[20, [10, 50]], [[30, 30, 200], [200, 30, 30]], atol=9)
    (tmp_path / "a.jpg").unlink()
    assert read_drive(tmp_path).header.width == 64


def test_without_its_package_a_phones_picture_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    shutil.copy(PHONE, tmp_path / "IMG_1.HEIC")
    monkeypatch.setitem(sys.modules, "pi_heif", None)  # as where it is not installed
    refused("geotagged", tmp_path, r"IMG_1\.HEIC needs the package pi_heif: .*\[import\]")


def test_a_plain_folder_is_a_recording_in_the_order_of_its_names(
    tmp_path: Path, write_pictures: Callable[[Path, list[str]], None]
) -> None:
    write_pictures(tmp_path / "walk", [f"shot{number}.png" for number in (10, 9, 1)])
    assert find_kind(tmp_path / "walk") == "geotagged"
    rows = open_dataset("geotagged", tmp_path / "walk", ReadOptions(fps=2.0)).rows
    assert [(row.file, row.stamp_ns, row.lat_deg) for row in rows] == [
        ("shot1.png", 0, None),
        ("shot9.png", 500_000_000, None),
        ("shot10.png", 1_000_000_000, None),
    ]


# Video and a log


def positions(degrees_at: Degrees, count: int, speed_mps: float = SPEED_MPS) -> list[tuple[int, float, float]]:
    """Microseconds and degrees, at 5 Hz, driving north."""
    return [(i * 200_000, *degrees_at(0.0, speed_mps * i / 5)) for i in range(count)]


def write_tlog(file: Path, degrees_at: Degrees, count: int, speed_mps: float = SPEED_MPS) -> None:
    """What a ground station keeps: its own heartbeats too, MAVLink 1 and 2 and signed frames, and a torn last one."""
    vehicle, station = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None, 255, 190)
    log = bytearray()
    for number, (after_us, lat_deg, lon_deg) in enumerate(positions(degrees_at, count, speed_mps)):
        vehicle.signing.secret_key, vehicle.signing.sign_outgoing = b"k" * 32, number % 3 == 2
        message = mavlink.MAVLink_global_position_int_message(
            after_us // 1000, round(lat_deg * 1e7), round(lon_deg * 1e7), 110_500, 0, round(100 * speed_mps), 0, 0, 0
        )
        heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
        for sender, sent in ((station, heartbeat), (vehicle, message)):
            packed = sent.pack(sender, force_mavlink1=number % 3 == 1)
            log += struct.pack(">Q", 1_714_557_600_000_000 + after_us) + packed
    file.write_bytes(bytes(log) + struct.pack(">Q", 1_714_557_700_000_000) + b"\xfd\x1c\x00")


def test_positions_in_a_log_have_the_accuracy_of_the_receiver(tmp_path: Path) -> None:
    """An RTK fix, then none: what the autopilot then estimates may rest on anything."""
    vehicle, log = mavlink.MAVLink(None, 1, 1), bytearray()
    for number, fix_type in enumerate([None, 6, 6, 0, 0, 3]):
        own = mavlink.MAVLink_global_position_int_message(number * 200, 10_000_000 + number, 1, 0, 0, 0, 0, 0, 0)
        sent = [own]
        if fix_type is not None:
            sent.insert(0, mavlink.MAVLink_gps_raw_int_message(0, fix_type, 1, 1, 0, 0, 0, 0, 0, 9, h_acc=140))
        for message in sent:
            log += struct.pack(">Q", 1_714_557_600_000_000 + number * 200_000) + message.pack(vehicle)
    (tmp_path / "a.tlog").write_bytes(bytes(log))
    track = read_log(tmp_path / "a.tlog")
    found = [(fix.source, fix.sigma_m) for fix in track.fixes]
    rtk, lost = ("rtk_fixed", 0.14), ("dead_reckoning", pytest.approx(math.nan, nan_ok=True))
    assert found == [("unknown", lost[1]), rtk, rtk, lost, lost, ("gps", 0.14)]
    between = track.fixes[2].stamp_ns + np.array([-100_000_000, 100_000_000])
    assert [fix.source for fix in track.at(between)] == ["rtk_fixed", "dead_reckoning"]


def write_dataflash(file: Path, degrees_at: Degrees, count: int) -> None:
    """ArduPilot's format messages first (FMT describes itself), then POS at 5 Hz."""
    layouts = {
        128: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", struct.Struct("<BB4s16s64s")),
        130: ("GPS", "QBIHLL", "TimeUS,Status,GMS,GWk,Lat,Lng", struct.Struct("<QBIHii")),
        131: ("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", struct.Struct("<Qiifff")),
    }

    def packed(kind: int, *values: Any) -> bytes:
        return b"\xa3\x95" + bytes([kind]) + layouts[kind][3].pack(*values)

    log = b"".join(
        packed(128, kind, layout.size + 3, name.encode(), form.encode(), columns.encode())
        for kind, (name, form, columns, layout) in layouts.items()
    )
    for after_us, lat_deg, lon_deg in positions(degrees_at, count):
        log += packed(130, 90_000_000 + after_us, 3, 295_218_000 + after_us // 1000, 2312, 0, 0)
        place = round(lat_deg * 1e7), round(lon_deg * 1e7)
        log += packed(131, 90_000_000 + after_us, *place, 110.5, 0.0, 0.0)
    file.write_bytes(log)


def write_ulog(file: Path, degrees_at: Degrees, count: int, topic: str = "vehicle_global_position") -> None:
    """PX4's header, flags, format, subscription and data messages."""

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    log = b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", 90_000_000) + message("B", bytes(40))
    log += message("F", f"{topic}:uint64_t timestamp;double lat;double lon;float alt;".encode())
    log += message("A", struct.pack("<BH", 0, 7) + topic.encode())
    for after_us, lat_deg, lon_deg in positions(degrees_at, count):
        log += message("D", struct.pack("<HQddf", 7, 90_000_000 + after_us, lat_deg, lon_deg, 110.5))
    file.write_bytes(log)


def write_gpx(file: Path, degrees_at: Degrees, count: int) -> None:
    """A phone's track."""
    points = "".join(
        f'<trkpt lat="{lat_deg:.8f}" lon="{lon_deg:.8f}"><ele>110.5</ele>'
        f"<time>2024-05-01T10:00:{after_us / 1e6:09.6f}Z</time></trkpt>"
        for after_us, lat_deg, lon_deg in positions(degrees_at, count)
    )
    begin = '<gpx version="1.1" creator="phone" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
    file.write_text(f"{begin}{points}</trkseg></trk></gpx>")


def moment(after_us: int) -> datetime:
    return datetime(2024, 5, 1, 10, tzinfo=timezone.utc) + timedelta(microseconds=after_us)


def write_nmea(file: Path, degrees_at: Degrees, count: int) -> None:
    """A receiver's GGA and RMC, by another program's writer."""
    lines = []
    for after_us, *degrees in positions(degrees_at, count):
        (lat, north), (lon, east) = (
            (f"{int(abs(value)):0{width}}{abs(value) % 1 * 60:010.7f}", ends[value < 0])
            for value, width, ends in zip(degrees, (2, 3), ("NS", "EW"), strict=True)
        )
        at, time = (lat, north, lon, east), f"{moment(after_us):%H%M%S}.{after_us // 10000 % 100:02}"
        lines.append(str(pynmea2.GGA("GN", "GGA", (time, *at, "1", "9", "0.8", "110.5", "M", "47.0", "M", "", ""))))
        lines.append(str(pynmea2.RMC("GN", "RMC", (time, "A", *at, "9.719", "0.0", "010524", "", "", "A"))))
    file.write_text("\n".join([*lines, lines[-1][:-8], "$GNRMC,noise*00"]))


def write_geojson(file: Path, degrees_at: Degrees, count: int) -> None:
    driven = positions(degrees_at, count)
    line = {"type": "LineString", "coordinates": [[lon_deg, lat_deg, 110.5] for _, lat_deg, lon_deg in driven]}
    times = {"coordTimes": [moment(after_us).isoformat() for after_us, *_ in driven]}
    feature = {"type": "Feature", "properties": times, "geometry": line}
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))


def write_kml(file: Path, degrees_at: Degrees, count: int) -> None:
    driven = positions(degrees_at, count)
    whens = "".join(f"<when>{moment(after_us).isoformat()}</when>" for after_us, *_ in driven)
    coords = "".join(f"<gx:coord>{lon_deg} {lat_deg} 110.5</gx:coord>" for _, lat_deg, lon_deg in driven)
    spaces = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
    file.write_text(f"<kml {spaces}><Placemark><gx:Track>{whens}{coords}</gx:Track></Placemark></kml>")


def write_csv(file: Path, degrees_at: Degrees, count: int) -> None:
    """As GPSLogger for Android names the columns."""
    rows = [f"{moment(us).isoformat()},{lat},{lon},110.5" for us, lat, lon in positions(degrees_at, count)]
    file.write_text("\n".join(["time,lat,lon,elevation", *rows]))


def write_fit(file: Path, degrees_at: Degrees, count: int) -> None:
    """A header, the layout of a record, records a second apart, and a checksum (FIT protocol, D00001275)."""
    layout = b"\x40\0\0" + struct.pack("<HB", 20, 4)
    body = layout + bytes([253, 4, 0x86, 0, 4, 0x85, 1, 4, 0x85, 2, 2, 0x84])
    for after_us, lat_deg, lon_deg in positions(degrees_at, count, SPEED_MPS / 5):
        seconds = int(moment(5 * after_us).timestamp()) - 631_065_600  # since 1989-12-31
        at = round(lat_deg * 2**31 / 180), round(lon_deg * 2**31 / 180)
        body += struct.pack("<BIiiH", 0, seconds, *at, round((110.6 + 500) * 5))
    data = struct.pack("<BBHI4s", 14, 0x20, 2132, len(body), b".FIT")
    data += struct.pack("<H", compute_crc(data)) + body
    file.write_bytes(data + struct.pack("<H", compute_crc(data)))


def write_srt(file: Path, degrees_at: Degrees, count: int) -> None:
    """Of a DJI drone, by the older and the newer firmware; the first subtitle is from before its fix."""
    lines = ["1\n00:00:00,000 --> 00:00:00,040\n[latitude: 0.0] [longitude: 0.0]\n"]
    for number, (after_us, lat_deg, lon_deg) in enumerate(positions(degrees_at, count)):
        seconds, part_us = divmod(after_us, 1_000_000)
        at = f"[latitude: {lat_deg:.9f}] [longtitude: {lon_deg:.9f}] [rel_alt: 1.200 abs_alt: 110.500]"
        at = f"GPS({lon_deg:.9f},{lat_deg:.9f},19) abs_alt: 110.5" if number % 2 else at
        lines.append(f"{number + 2}\n00:00:{seconds:02d},{part_us // 1000:03d} --> 00:01:00,000\n{at}\n")
    file.write_text("\n".join(lines), encoding="utf-8")


LOGS = {
    ".tlog": write_tlog, ".bin": write_dataflash, ".ulg": write_ulog, ".gpx": write_gpx, ".nmea": write_nmea,
    ".geojson": write_geojson, ".kml": write_kml, ".csv": write_csv, ".srt": write_srt,
}  # fmt: skip


@pytest.mark.parametrize("suffix", LOGS)
def test_each_log_gives_the_positions_that_were_driven(tmp_path: Path, degrees_at: Degrees, suffix: str) -> None:
    LOGS[suffix](tmp_path / f"flight{suffix}", degrees_at, 12)
    fixes = read_log(tmp_path / f"flight{suffix}").fixes
    start_ns = fixes[0].stamp_ns
    assert len(fixes) == 12
    for fix, (after_us, *degrees) in zip(fixes, positions(degrees_at, 12), strict=True):
        assert fix.stamp_ns - start_ns == pytest.approx(after_us * 1000, abs=1000)
        assert [fix.lat_deg, fix.lon_deg] == pytest.approx(degrees, abs=1e-7)
        assert fix.alt_m == pytest.approx(110.5)
    assert {fix.source for fix in fixes} == {"unknown" if suffix in {".tlog", ".ulg", ".csv"} else "gps"}
    if suffix == ".srt":
        assert start_ns == 0, "the times of the video"
    elif suffix not in {".bin", ".ulg"}:
        assert start_ns == 1_714_557_600_000_000_000
    if suffix == ".tlog":
        assert (start_ns, fixes[3].heading_deg, fixes[3].speed_mps) == (1_714_557_600_000_000_000, 0.0, 5.0)


def test_a_watch_gives_a_position_a_second(tmp_path: Path, degrees_at: Degrees) -> None:
    write_fit(tmp_path / "ride.fit", degrees_at, 12)
    fixes = read_log(tmp_path / "ride.fit").fixes
    assert [fix.stamp_ns - 1_714_557_600_000_000_000 for fix in fixes] == [second * 10**9 for second in range(12)]
    assert (fixes[11].lat_deg, fixes[11].lon_deg, fixes[11].alt_m) == pytest.approx(
        (*degrees_at(0.0, 11 * SPEED_MPS / 25), 110.6), abs=1e-7
    )
    (tmp_path / "ride.fit").write_bytes((tmp_path / "ride.fit").read_bytes()[:-20])
    with pytest.raises(FeedError, match=r"ride\.fit: not a whole FIT file: "):
        read_log(tmp_path / "ride.fit")


def test_the_chapters_of_one_recording_have_one_track(
    tmp_path: Path, write_video: WriteVideo, degrees_at: Degrees, sim_import: Callable[..., int], refused: Refused
) -> None:
    """Of a GoPro as it numbers them, another recording beside them; in a folder, or named by the first."""
    for name in ("GX010042", "GX020042", "GX010043"):
        write_video(tmp_path / f"drive/{name}.AVI", 6, 10.0)
    write_nmea(tmp_path / "drive/GX010042.nmea", degrees_at, 12)
    write_csv(tmp_path / "drive/GX010042.csv", degrees_at, 12)  # the same, as loggers write it
    first = tmp_path / "drive/GX010042.AVI"
    assert find_kind(first) == "video-log"
    rows = open_dataset("video-log", first, ReadOptions(offset_s=0.0)).rows
    assert [row.file for row in rows[4:8]] == [
        "GX010042.AVI 4", "GX010042.AVI 5", "GX020042.AVI 0", "GX020042.AVI 1",
    ]  # fmt: skip
    assert len(rows) == 12 and rows[11].lat_deg == pytest.approx(degrees_at(0.0, 5.5)[0], abs=1e-7)
    (tmp_path / "drive/GX010043.AVI").unlink()
    assert find_kind(tmp_path / "drive") == "video-log"
    assert open_dataset("video-log", tmp_path / "drive", ReadOptions(offset_s=0.0)).rows == rows
    (tmp_path / "drive/GX020042.AVI").rename(tmp_path / "drive/GX030042.AVI")
    refused("video-log", first, r"GX010042\.AVI: chapter 2 of it is missing, and chapter 3 is there")


def test_a_video_is_put_along_its_log(
    tmp_path: Path, write_video: WriteVideo, degrees_at: Degrees, sim_import: Callable[..., int]
) -> None:
    write_video(tmp_path / "drive.avi", 20, 10.0)
    log, output = tmp_path / "flight.tlog", tmp_path / "feed"
    write_tlog(log, degrees_at, 12)
    sim_import("video-log", tmp_path / "drive.avi", "--positions", log, "--offset-s", "1", "-o", output)
    feed = read_feed(output)
    # The log ends after 2.2 s, which is 1.2 s into the video.
    assert [row.extra["source_frame"] for row in feed.rows] == ["0", "4", "8", "12"]
    for row, north_m in zip(feed.rows, (5, 7, 9, 11), strict=True):
        assert (row.lat_deg, row.lon_deg) == pytest.approx(degrees_at(0.0, north_m), abs=2e-7)


def test_a_video_and_a_log_of_other_times_are_one_line(
    tmp_path: Path, write_video: WriteVideo, degrees_at: Degrees, refused: Refused
) -> None:
    write_video(tmp_path / "drive.avi", 20, 10.0)
    write_tlog(tmp_path / "flight.tlog", degrees_at, 12)
    options = ReadOptions(positions=str(tmp_path / "flight.tlog"), offset_s=60.0)
    message = r"drive\.avi: taken from 1714557660\.000 to 1714557661\.900 s, where .*flight\.tlog has no positions"
    refused("video-log", tmp_path / "drive.avi", message, options)
    begun = ReadOptions(positions=options.positions, start_time="2024-05-01T10:01:00Z")
    refused("video-log", tmp_path / "drive.avi", message, begun)
    begun = ReadOptions(positions=options.positions, start_time="noon")
    refused("video-log", tmp_path / "drive.avi", "--start-time: 'noon' is not a time such as", begun)


def test_the_track_of_the_same_name_is_used_from_when_the_video_began(
    tmp_path: Path, write_video: WriteVideo, degrees_at: Degrees, refused: Refused
) -> None:
    write_video(tmp_path / "drive.avi", 20, 10.0)
    write_gpx(tmp_path / "drive.gpx", degrees_at, 12)
    traverse = open_dataset("video-log", tmp_path / "drive.avi", ReadOptions(start_time="2024-05-01T12:00:01+02:00"))
    assert (traverse.rows[0].lat_deg, traverse.rows[0].lon_deg) == pytest.approx(degrees_at(0.0, 5.0), abs=2e-7)
    write_tlog(tmp_path / "drive.tlog", degrees_at, 12)
    refused("video-log", tmp_path / "drive.avi", r"--positions: name one of drive\.gpx, drive\.tlog for .*drive\.avi")


def test_where_a_log_has_a_gap_nobody_knows_the_position(tmp_path: Path, degrees_at: Degrees) -> None:
    file = tmp_path / "flight.tlog"
    write_tlog(file, degrees_at, 12)
    early = file.read_bytes()
    write_tlog(file, degrees_at, 60)
    late = file.read_bytes()
    frame = late.rfind(struct.pack(">Q", 1_714_557_600_000_000 + 55 * 200_000))
    file.write_bytes(early[:-11] + late[late.rfind(late[frame : frame + 8], 0, frame) :])
    track = read_log(file)
    start_ns = track.fixes[0].stamp_ns
    seconds = np.array([0.0, 1.0, 2.2, 2.3, 10.9, 11.0, 11.5, 12.0, -0.1])
    covered = track.covers(start_ns + (seconds * 1e9).astype(np.int64))
    assert covered.tolist() == [True, True, True, False, False, True, True, False, False]


def test_a_real_rover_drove_as_far_as_its_speed_says(shared: Path) -> None:
    fixes = read_log(shared / "autopilot/ardurover-4.6.3-nogps.tlog").fixes
    steps = np.diff(east_north(*np.array([(fix.lat_deg, fix.lon_deg) for fix in fixes]).T), axis=0)
    speed_mps = np.array([fix.speed_mps for fix in fixes])
    seconds = np.array([fix.stamp_ns - fixes[0].stamp_ns for fix in fixes]) / 1e9
    by_speed_m = float((np.diff(seconds) * (speed_mps[1:] + speed_mps[:-1]) / 2).sum())
    assert by_speed_m > 400
    assert np.hypot(*steps.T).sum() == pytest.approx(by_speed_m, rel=0.02)


def test_logs_that_cannot_be_read_are_named(tmp_path: Path, degrees_at: Degrees) -> None:
    def fails(name: str, message: str) -> None:
        with pytest.raises(FeedError, match=f"^{tmp_path}/{name}: {message}") as raised:
            read_log(tmp_path / name)
        assert "\n" not in str(raised.value)

    fails("flight.tlog", "cannot read it: No such file or directory")
    fails("flight.trc", r"not a known kind of log; it is one of \.tlog, .*gpsbabel -i KIND -f flight\.trc -o gpx")
    for suffix in LOGS:
        (tmp_path / f"noise{suffix}").write_bytes(np.random.default_rng(3).bytes(5000))
        (tmp_path / f"empty{suffix}").write_bytes(b"")
        fails(f"empty{suffix}", "empty")
    fails("noise.tlog", r"no position\(s\) in it, and two at least are needed")
    fails("noise.bin", "not a DataFlash log")
    fails("noise.ulg", "not a whole ULog: ")
    fails("noise.gpx", "not a whole GPX file: ")
    fails("noise.nmea", r"no position\(s\) in it, and two at least are needed")
    fails("noise.geojson", "not a GeoJSON track: ")
    fails("noise.kml", "not a whole KML file: ")
    fails("noise.csv", "not UTF-8 text")
    (tmp_path / "plan.kml").write_text("<kml><LineString/></kml>")
    fails("plan.kml", "no gx:Track in it, so its points have no times; export the track as GPX")
    (tmp_path / "line.geojson").write_text(
        '{"type": "Feature", "geometry": {"type": "LineString", "coordinates": [[1, 2]]}}'
    )
    fails("line.geojson", "a LineString without a time for each point")
    (tmp_path / "some.csv").write_text("a,b\n1,2\n")
    fails("some.csv", "a track needs columns of time, lat and lon; its columns: a, b")
    (tmp_path / "plan.gpx").write_text('<gpx><trk><trkseg><trkpt lat="1" lon="2"/></trkseg></trk></gpx>')
    fails("plan.gpx", "a point of its track has no time; export the recorded track")
    write_dataflash(tmp_path / "parked.bin", degrees_at, 1)
    fails("parked.bin", r"1 position\(s\) in it, and two at least are needed")
    write_ulog(tmp_path / "indoors.ulg", degrees_at, 5, topic="vehicle_local_position")
    fails("indoors.ulg", "no vehicle_global_position in it")


def test_a_video_without_its_log_is_told_so(tmp_path: Path, write_video: WriteVideo, refused: Refused) -> None:
    write_video(tmp_path / "drive.avi", 3, 10.0)
    refused("video-log", tmp_path / "drive.avi", r"--positions: name the log or track \(\.tlog, .*\.csv\)")


def test_a_log_is_replayed_with_its_video_as_the_feed_that_is_imported_of_them(
    tmp_path: Path,
    degrees_at: Degrees,
    sim_import: Callable[..., int],
    write_traverse: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    images = FeedImages(read_feed(write_traverse(tmp_path / "street", range(40))))
    video = cv2.VideoWriter(str(tmp_path / "flight.AVI"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (160, 120))
    for index in range(40):
        video.write(images.read(index))
    video.release()
    log = tmp_path / "flight.tlog"
    write_tlog(log, degrees_at, 20, speed_mps=20.0)  # 3.8 s of the video's 4
    (tmp_path / "fc6.toml").write_text('[descriptor]\nmodel = "fc6"\n')
    with_fc6 = ("-o", str(tmp_path / "map"), "--config", str(tmp_path / "fc6.toml"))
    assert main(["map", "build", str(tmp_path / "street"), *with_fc6]) == 0
    options = ["--map", str(tmp_path / "map"), "--sequence-length", "5", "--spacing-frames", "1", "--all"]
    sim_import(
        *("video-log", tmp_path / "flight.AVI", "--positions", log, "--offset-s", "0.5", "--spacing-frames", 1),
        *("--lossless", "--view", "rear", "-o", tmp_path / "imported"),
    )
    capsys.readouterr()
    assert main(["replay", str(tmp_path / "imported"), *options]) == 0
    imported = capsys.readouterr().out
    read = ["--video", str(tmp_path / "flight.AVI"), "--offset-s", "0.5", "--view", "rear"]
    assert main(["replay", str(log), *options, *read]) == 0
    assert capsys.readouterr().out == imported
    assert imported.count("\n") == 34, "frames beyond the log's end are skipped"
    assert imported.count('"direction":"forward"') >= 20
    assert main(["replay", str(log), *options, *read[2:]]) == 0
    assert capsys.readouterr().out == imported, "the video of the same name is found"
    rows = [read_feed(tmp_path / "imported").rows, read_feed(log, FeedOptions("rear", offset_s=0.5)).rows]
    assert [replace(row, file="") for row in rows[0]] == [replace(row, file="") for row in rows[1]]


def test_a_log_that_cannot_be_paired_is_one_line(
    tmp_path: Path, degrees_at: Degrees, write_video: WriteVideo, capsys: pytest.CaptureFixture[str]
) -> None:
    log, there = tmp_path / "flight.tlog", ["--map", "a.map"]
    write_tlog(log, degrees_at, 12)
    assert main(["replay", str(log), *there]) == 78
    assert "name its video with --video; videos of the same name beside it: none" in capsys.readouterr().err
    write_video(tmp_path / "flight.avi", 20, 10.0)
    assert main(["replay", str(tmp_path / "flight.avi"), *there, "--video", str(log)]) == 78
    assert "flight.avi: --video is for a log" in capsys.readouterr().err
    assert main(["replay", str(log), *there, "--offset-s", "nan"]) == 78
    assert "--offset-s: nan is not a number of seconds" in capsys.readouterr().err
    assert main(["map", "build", str(log), str(log), "-o", "a.map", "--video", "a.avi"]) == 78
    assert "--video is for one log; with several, name each video like its log" in capsys.readouterr().err
