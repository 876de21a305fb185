"""Videos that hold their own positions, in containers that are written here as their makers document them."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from edge.feed import FeedImages, read_feed
from sim.datasets import ReadOptions, open_dataset
from sim.datasets.found import find_kind, open_recording
from sim.traverse import driven_m
from tests.sim.datasets.conftest import HEIGHT, WIDTH, picture

COUNT, FPS = 30, 10
Degrees = Callable[[float, float], tuple[float, float]]
IndexOf = Callable[[Any], int]


def box(kind: bytes, *content: bytes) -> bytes:
    data = b"".join(content)
    return struct.pack(">I", 8 + len(data)) + kind + data


def full_box(kind: bytes, *content: bytes) -> bytes:
    return box(kind, bytes(4), *content)


def write_mp4(file: Path, codec: str = "libx264") -> None:
    """Pictures of `picture`, the first darkest."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(file), "w") as video:
        stream: Any = video.add_stream(codec, rate=FPS, options={"x264-params": "bframes=2:keyint=10"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.time_base = Fraction(1, FPS)
        for index in range(COUNT):
            frame = av.VideoFrame.from_ndarray(picture(index), format="bgr24")
            frame.pts = index
            video.mux(stream.encode(frame))
        video.mux(stream.encode(None))


def add_track(file: Path, samples: Sequence[bytes]) -> None:
    """A track of kind gpmd, a sample a second (ISO/IEC 14496-12, chapter 8)."""
    data = file.read_bytes()
    at = data.rindex(b"moov") - 4
    media, moov = data[:at], data[at:]
    first = len(media) + 8
    offsets = np.cumsum([first, *map(len, samples)])[:-1].tolist()
    matrix = struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)
    count = len(samples)
    table = box(
        b"stbl",
        full_box(b"stsd", struct.pack(">I", 1), box(b"gpmd", bytes(6), struct.pack(">H", 1))),
        full_box(b"stts", struct.pack(">III", 1, count, 1000)),
        full_box(b"stsc", struct.pack(">IIII", 1, 1, 1, 1)),
        full_box(b"stsz", struct.pack(">II", 0, count), *(struct.pack(">I", len(one)) for one in samples)),
        full_box(b"stco", struct.pack(">I", count), *(struct.pack(">I", one) for one in offsets)),
    )
    track = box(
        b"trak",
        full_box(b"tkhd", struct.pack(">IIIII", 0, 0, 9, 0, 1000 * count), bytes(16), matrix, bytes(8)),
        box(
            b"mdia",
            full_box(b"mdhd", struct.pack(">IIIIHH", 0, 0, 1000, 1000 * count, 0x55C4, 0)),
            full_box(b"hdlr", bytes(4), b"meta", bytes(12), b"GoPro MET\0"),
            box(
                b"minf",
                full_box(b"nmhd"),
                box(b"dinf", full_box(b"dref", struct.pack(">I", 1), box(b"url ", b"\0\0\0\1"))),
                table,
            ),
        ),
    )
    file.write_bytes(media + box(b"mdat", *samples) + box(b"moov", moov[8:], track))


def klv(key: bytes, kind: bytes, size: int, data: bytes) -> bytes:
    """A GPMF element (github.com/gopro/gpmf-parser): key, type, bytes of a structure, their number; padded to 4."""
    return key + kind + struct.pack(">BH", size, len(data) // size) + data + bytes(-len(data) % 4)


def gps5(points: Sequence[tuple[float, float]], fix: int) -> bytes:
    """One second of a HERO5 to HERO10."""
    rows = [(round(lat * 1e7), round(lon * 1e7), 100_000, 2_000, 200) for lat, lon in points]
    stream = [
        klv(b"GPSF", b"L", 4, struct.pack(">I", fix)),
        klv(b"GPSU", b"U", 16, b"240504123000.000"),
        klv(b"GPSP", b"S", 2, struct.pack(">H", 200)),
        klv(b"SCAL", b"l", 4, struct.pack(">5i", 10_000_000, 10_000_000, 1000, 1000, 100)),
        klv(b"GPS5", b"l", 20, b"".join(struct.pack(">5i", *row) for row in rows)),
    ]
    device = klv(b"DVID", b"L", 4, struct.pack(">I", 1)) + klv(b"DVNM", b"c", 1, b"Hero9 Black")
    return klv(b"DEVC", b"\0", 1, device + klv(b"STRM", b"\0", 1, b"".join(stream)))


def north_m(file: Path, degrees_at: Degrees, **options: Any) -> np.ndarray[Any, Any]:
    """How far north of the start each frame was taken, NaN where that is not known."""
    rows = open_dataset("video", file, ReadOptions(**options)).rows
    start, end = degrees_at(0, 0)[0], degrees_at(0, 100)[0]
    lats = np.array([np.nan if row.lat_deg is None else row.lat_deg for row in rows])
    return (lats - start) / (end - start) * 100


def gopro(file: Path, degrees_at: Degrees, *, from_m: float = 0.0, fix: int = 3) -> None:
    write_mp4(file)
    seconds = [
        gps5([degrees_at(0, from_m + 10 * second + step) for step in range(0, 10, 2)], fix) for second in range(3)
    ]
    add_track(file, seconds)


def test_a_gopro_places_its_own_pictures(tmp_path: Path, degrees_at: Degrees) -> None:
    gopro(tmp_path / "GX010042.MP4", degrees_at)
    assert find_kind(tmp_path / "GX010042.MP4") == "video"
    # 10 m a second, 10 pictures a second; after the last position there is none.
    assert north_m(tmp_path / "GX010042.MP4", degrees_at)[:28] == pytest.approx(np.arange(28.0), abs=0.05)


def test_a_video_is_read_in_place_of_a_feed_with_its_positions(tmp_path: Path, degrees_at: Degrees) -> None:
    gopro(tmp_path / "GX010042.MP4", degrees_at)
    feed = open_recording(tmp_path / "GX010042.MP4")
    assert (driven_m(feed) or [])[:28] == pytest.approx(np.arange(28.0), abs=0.05)
    images = FeedImages(feed)
    seen = images.read(20)
    images.close()
    np.testing.assert_array_equal(images.read(20), seen, "what is closed opens again")


def test_chapters_of_a_gopro_are_one_drive(
    tmp_path: Path, degrees_at: Degrees, sim_import: Callable[..., int], index_of: IndexOf
) -> None:
    gopro(tmp_path / "drive/GX010042.MP4", degrees_at)
    gopro(tmp_path / "drive/GX020042.MP4", degrees_at, from_m=30.0)
    sim_import(tmp_path / "drive", "-o", tmp_path / "feed")
    feed = read_feed(tmp_path / "feed")
    assert np.array([row.distance_m for row in feed.rows]) == pytest.approx(np.arange(0.0, 60.0, 2.0), abs=0.2)
    assert [index_of(FeedImages(feed).read(row)) for row in (1, 14, 15, 16)] == pytest.approx([2, 28, 0, 2], abs=1)
    assert feed.rows[16].extra["source_file"] == "GX020042.MP4 2"


def test_a_gopro_without_a_fix_has_no_positions_and_says_so(
    tmp_path: Path, degrees_at: Degrees, caplog: pytest.LogCaptureFixture
) -> None:
    gopro(tmp_path / "indoors.MP4", degrees_at, fix=0)
    assert np.isnan(north_m(tmp_path / "indoors.MP4", degrees_at)).all()
    assert "GPS is too noisy" in caplog.text
    assert "indoors.MP4: no positions are found in it" in caplog.text


def nmea(text: str) -> str:
    total = 0
    for letter in text:
        total ^= ord(letter)
    return f"${text}*{total:02X}"


def minutes(degrees: float, width: int) -> str:
    return f"{int(abs(degrees)):0{width}}{abs(degrees) % 1 * 60:09.6f}"


def test_a_blackvue_places_its_own_pictures(tmp_path: Path, degrees_at: Degrees) -> None:
    """As mapillary_tools and ExifTool read it: NMEA lines, each with the camera's clock, in a box gps of a box free."""
    file = tmp_path / "20240504_123000_NR.mp4"
    write_mp4(file)
    lines = []
    for second in range(4):
        lat, lon = degrees_at(0, 10 * second)
        at = f"{minutes(lat, 2)},N,{minutes(lon, 3)},W"
        lines.append(f"[{1714825800000 + 1000 * second}]{nmea(f'GPRMC,12300{second}.00,A,{at},19.4,0.0,040524,,,A')}\n")
    # FFmpeg's own empty box free comes first, which a BlackVue does not write; a box skip means the same.
    video = file.read_bytes().replace(b"\x00\x00\x00\x08free", b"\x00\x00\x00\x08skip", 1)
    file.write_bytes(video + box(b"free", box(b"gps ", "".join(lines).encode())))
    assert find_kind(file) == "video"
    assert north_m(file, degrees_at) == pytest.approx(np.arange(30.0), abs=0.05)
    assert open_dataset("video", file).view == "rear"


def test_a_folder_of_two_cameras_asks_for_one(
    tmp_path: Path, degrees_at: Degrees, refused: Callable[..., None]
) -> None:
    for name in ("20240504_123000_NF", "20240504_123000_NR", "20240504_123100_NR"):
        gopro(tmp_path / f"{name}.MP4", degrees_at, from_m=30.0 * ("3100" in name))
    assert find_kind(tmp_path) == "video"
    refused("video", tmp_path, "several cameras; choose one with `lookback import --camera`, as in --camera front")
    assert north_m(tmp_path, degrees_at, camera="R")[:58] == pytest.approx(np.arange(58.0), abs=0.2)


@pytest.mark.skipif(shutil.which("exiftool") is None, reason="needs ExifTool: apt-get install libimage-exiftool-perl")
def test_another_dashcam_is_read_by_exiftool(tmp_path: Path, degrees_at: Degrees) -> None:
    """Novatek, as ExifTool documents it: a box gps in moov lists blocks freeGPS of one position each."""
    file = tmp_path / "2024_0504_123000_0001F.MP4"
    write_mp4(file)
    data = file.read_bytes()
    at = data.rindex(b"moov") - 4
    media, moov = data[:at], data[at:]
    blocks = []
    for second in range(4):
        lat, lon = (float(minutes(one, 0)) for one in degrees_at(0, 10 * second))
        head = struct.pack("<6I", 12, 30, second, 24, 5, 4) + b"ANW\0" + struct.pack("<4f", lat, lon, 19.4, 0.0)
        blocks.append(box(b"free", b"GPS ", struct.pack("<I", 76), head).ljust(0x8000, b"\0"))
    blocks = [struct.pack(">I", len(one)) + one[4:] for one in blocks]
    table = b"".join(struct.pack(">II", len(media) + 0x8000 * number, 0x8000) for number in range(4))
    gps = box(b"gps ", struct.pack(">II", 0x101, 4), table)
    after_header = 8 + int.from_bytes(moov[8:12], "big")
    file.write_bytes(media + b"".join(blocks) + box(b"moov", moov[8:after_header], gps, moov[after_header:]))
    assert find_kind(file) == "video"
    assert north_m(file, degrees_at) == pytest.approx(np.arange(30.0), abs=1.0)


def test_a_plain_video_is_used_as_it_is(tmp_path: Path) -> None:
    write_mp4(tmp_path / "plain.mp4", codec="mpeg4")
    assert find_kind(tmp_path / "plain.mp4") is None
    assert {row.lat_deg for row in open_dataset("video", tmp_path / "plain.mp4").rows} == {None}
