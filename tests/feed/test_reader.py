from __future__ import annotations

import re
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from edge.errors import FeedError, FrameError
from edge.feed import FeedHeader, FeedImages, FeedRow, read_feed
from edge.feed.writer import FeedWriter
from tests.files_written import full_disk

HEADER = FeedHeader("Gardens Point", "rear", 64, 48, source="test", notes="nachts, 夜")


def level(image: np.ndarray) -> float:
    return float(image.mean())


def replace_in(file: Path, old: str, new: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    image = np.full((48, 64, 3), 90, np.uint8)
    with FeedWriter(tmp_path / "feed", HEADER, extra_columns=("weather",)) as writer:
        writer.write(image, FeedRow("", 5, -27.4772, 153.0283, heading_deg=0.1, extra={"weather": "Schnee, 雪"}))
        writer.write(image + 50, FeedRow("", 7, alt_m=20.0, speed_mps=1 / 3, distance_m=np.float64(2.5)))
        writer.write(image, FeedRow("", 9, 1.0, 2.0, position_sigma_m=0.02, position_source="rtk_fixed"))
    feed = read_feed(tmp_path / "feed")
    assert feed.header == HEADER
    assert feed.rows == (
        FeedRow("frames/000000.jpg", 5, -27.4772, 153.0283, None, 0.1, extra={"weather": "Schnee, 雪"}),
        FeedRow("frames/000001.jpg", 7, alt_m=20.0, speed_mps=1 / 3, distance_m=2.5, extra={"weather": ""}),
        FeedRow(
            "frames/000002.jpg",
            9,
            1.0,
            2.0,
            position_sigma_m=0.02,
            position_source="rtk_fixed",
            extra={"weather": ""},
        ),
    )
    images = FeedImages(feed)
    assert [level(images.read(index)) for index in (1, 0)] == pytest.approx([140, 90], abs=1)
    images.close()


def test_the_recorded_corridor_is_read(shared: Path) -> None:
    feed = read_feed(shared / "feeds/corridor_query")
    assert len(feed.rows) == 111
    assert feed.rows[110].distance_m == 110.0
    assert FeedImages(feed).read(110).shape == (120, 160, 3)


def test_further_columns_of_a_recording_are_kept(shared: Path) -> None:
    assert read_feed(shared / "feeds/track_lap_a").rows[0].extra == {"steering": "0.0", "throttle": "0.4"}


def test_a_second_feed_in_the_same_folder_is_refused(feed_path: Path) -> None:
    with pytest.raises(FeedError, match=f"{re.escape(str(feed_path))}: a feed already exists here"):
        FeedWriter(feed_path, HEADER)


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FeedError, match=r"file/feed: cannot write a feed here: Not a directory"):
        FeedWriter(tmp_path / "file/feed", HEADER)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("feed.toml", 'view = "front"', 'view = "side"', r'feed\.toml: view: "side" is none of'),
        ("feed.toml", "width = 64", "width = 0", r"feed\.toml: width: .*>= 1"),
        ("feed.toml", "width = 64", "width = ", r"feed\.toml: .*line 3"),
        ("feed.toml", "width = 64", "", r"feed\.toml: the key `width` is missing"),
        ("feed.toml", 'video = ""', 'video = "none.mp4"', r"none\.mp4: the video that feed.toml names is missing"),
        ("feed.toml", 'video = ""', 'video = "../x.mp4"', r"feed\.toml: video: '\.\./x\.mp4' is outside"),
        ("feed.toml", 'video = ""', 'video = "/x.mp4"', r"feed\.toml: video: '/x\.mp4' is outside"),
        ("feed.toml", 'video = ""', 'video = "feed.toml"', r"feed\.toml: neither a feed folder nor a video"),
        ("frames.csv", "stamp_ns", "time", r"frames\.csv: no column stamp_ns in its first line"),
        ("frames.csv", "000001.jpg,1050000000", "000001.jpg,soon", r"frames\.csv: line 3: stamp_ns: 'soon' is not"),
        ("frames.csv", "000001.jpg,1050000000", "000001.jpg,", r"frames\.csv: line 3: stamp_ns: '' is not"),
        ("frames.csv", "1050000000", "1000000000", r"line 3: stamp_ns 1000000000 is not after 1000000000"),
        ("frames.csv", "1050000000", "1150000000", r"line 4: stamp_ns 1100000000 is not after 1150000000"),
        ("frames.csv", "0,,,,,,2.0", "0,,,,,,two", r"frames\.csv: line 4: distance_m: 'two' is not a number"),
        ("frames.csv", "0,,,,,,2.0,", "0,,,,,,2.0,0", r"line 4: position_sigma_m: 0 is not above 0"),
        ("frames.csv", "0,,,,,,2.0,,", "0,,,,,,2.0,,sun", r"line 4: position_source: 'sun' is none of unknown, gps"),
        ("frames.csv", "0,,,,,,2.0", "0,nan,,,,,2.0", r"frames\.csv: line 4: lat_deg: 'nan' is not a number"),
        (
            "frames.csv",
            "0,,,,,,2.0",
            "0,91,,,,,2.0",
            r"frames\.csv: line 4: lat_deg: 91 is not between -90 and 90 degrees",
        ),
        (
            "frames.csv",
            "0,,,,,,2.0",
            "0,,1e308,,,,2.0",
            r"line 4: lon_deg: 1e\+308 is not between -180 and 180 degrees",
        ),
        ("frames.csv", "1050000000", "9" * 20, r"line 3: stamp_ns: 9+ is more than 64 bits hold"),
        (
            "frames.csv",
            "0,,,,,,2.0",
            "0,,,,,,0.5",
            r"frames\.csv: line 4: distance_m 0\.5 is less than 1 of an earlier",
        ),
        ("frames.csv", "0,,,,,,2.0", "0,,,,,,2.0,7", r"frames\.csv: line 4: more values than"),
        ("frames.csv", "frames/000002.jpg", "", r"frames\.csv: line 4: file is empty"),
        ("frames.csv", "frames/000002.jpg", "../../etc/passwd", r"line 4: file: '\.\./\.\./etc/passwd' is outside"),
        ("frames.csv", "frames/000002.jpg", "/etc/passwd", r"line 4: file: '/etc/passwd' is outside"),
        ("frames.csv", "frames/000002.jpg", "frames/../../x", r"line 4: file: 'frames/\.\./\.\./x' is outside"),
    ],
)
def test_a_malformed_feed_is_one_line_that_names_the_place(
    feed_path: Path, file: str, old: str, new: str, message: str
) -> None:
    replace_in(feed_path / file, old, new)
    with pytest.raises(FeedError, match=message) as raised:
        feed = read_feed(feed_path)
        FeedImages(feed)
    assert str(raised.value).startswith(str(feed_path))
    assert "\n" not in str(raised.value)


def test_the_mark_that_some_editors_put_before_a_text_is_no_part_of_it(feed_path: Path) -> None:
    before = read_feed(feed_path)
    for name in ("feed.toml", "frames.csv"):
        (feed_path / name).write_bytes(b"\xef\xbb\xbf" + (feed_path / name).read_bytes().replace(b"\n", b"\r\n"))
    assert read_feed(feed_path) == before


def test_a_last_line_that_is_cut_short_is_named(feed_path: Path) -> None:
    file = feed_path / "frames.csv"
    whole = file.read_bytes()
    for cut in range(len(whole) - len(b"frames/000011.jpg,1550000000,,,,,,11.0,,\n") + 1, len(whole) - len(b",,\n")):
        file.write_bytes(whole[:cut])
        with pytest.raises(FeedError, match=r"frames\.csv: line 13: only . of 10 values; if the file is cut short"):
            read_feed(feed_path)


def test_files_that_are_missing_empty_or_not_text_are_named(feed_path: Path) -> None:
    rows, header = feed_path / "frames.csv", feed_path / "feed.toml"
    good = rows.read_bytes()
    for content, message in (
        (b"", "no column file"),
        (b"file,stamp_ns\n", "no frames"),
        (good + b"\xff\xfe", "not UTF-8"),
    ):
        rows.write_bytes(content)
        with pytest.raises(FeedError, match=rf"frames\.csv: .*{message}"):
            read_feed(feed_path)
    rows.unlink()
    with pytest.raises(FeedError, match=r"frames\.csv: cannot read it: No such file"):
        read_feed(feed_path)
    header.write_bytes(b"\xff")
    with pytest.raises(FeedError, match=r"feed\.toml: not UTF-8"):
        read_feed(feed_path)
    header.unlink()
    with pytest.raises(FeedError, match=r"feed\.toml: no such file; it needs name = .*view = .*width and height"):
        read_feed(feed_path)
    header.write_text('name = "mine"\n')
    with pytest.raises(FeedError, match=r"feed\.toml: the keys `view`, `width`, `height` are missing"):
        read_feed(feed_path)
    with pytest.raises(FeedError, match="nowhere: no such feed"):
        read_feed(feed_path / "nowhere")


def test_an_empty_picture_a_torn_one_and_a_missing_one_are_frame_errors_that_name_the_file(feed_path: Path) -> None:
    images = FeedImages(read_feed(feed_path))
    picture = feed_path / "frames/000002.jpg"
    whole = picture.read_bytes()
    for content in (b"", b"GIF89a", whole[: len(whole) // 2]):
        picture.write_bytes(content)
        with pytest.raises(FrameError, match=r"000002\.jpg: not a complete JPEG or PNG image"):
            images.read(2)
    picture.unlink()
    with pytest.raises(FrameError, match=r"000002\.jpg: cannot read it: No such file"):
        images.read(2)


def test_a_picture_of_another_size_than_the_header_says_is_a_frame_error(feed_path: Path) -> None:
    replace_in(feed_path / "feed.toml", "width = 64", "width = 640")
    with pytest.raises(FrameError, match=r"000000\.jpg: 64 x 48 pixels, and feed\.toml says 640 x 48"):
        FeedImages(read_feed(feed_path)).read(0)


def test_a_feed_may_keep_its_pictures_in_one_video(feed_path: Path, video_path: Path) -> None:
    video_path.rename(feed_path / "drive.avi")
    replace_in(feed_path / "feed.toml", 'video = ""', 'video = "drive.avi"')
    images = FeedImages(read_feed(feed_path))
    indices = [0, 1, 2, 7, 3, 11]  # in order, ahead and back
    assert [round((level(images.read(index)) - 20) / 16) for index in indices] == indices
    with pytest.raises(FrameError, match=r"drive\.avi: no frame 12"):
        images.read(12)
    images.close()


def test_a_bare_video_has_its_frame_rate_as_stamps(video_path: Path) -> None:
    feed = read_feed(video_path)
    assert (feed.header.name, feed.header.width, feed.header.height) == ("drive", 64, 48)
    assert [row.stamp_ns for row in feed.rows] == [index * 50_000_000 for index in range(12)]


PHONE_MS = [*range(0, 3000, 100), *range(3000, 12_000, 300)]
"""When a phone took its pictures: 10 a second, and from dusk on 3.3."""


@pytest.fixture
def phone_video_path(tmp_path: Path) -> Path:
    """A video in the container that phones write, whose pictures are so far apart as PHONE_MS, each of its own gray."""
    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "phone.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for index, time_ms in enumerate(PHONE_MS):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 12 + 4 * index, np.uint8), "bgr24")
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return tmp_path / "phone.mp4"


@pytest.mark.parametrize("package", ["av", None])
def test_each_picture_of_a_video_has_its_own_time(
    phone_video_path: Path, package: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read by the package av, and without it."""
    if package is None:
        monkeypatch.setitem(sys.modules, "av", None)  # as Python itself marks a module that cannot be imported
    feed = read_feed(phone_video_path)
    assert [row.stamp_ns for row in feed.rows] == [time_ms * 1_000_000 for time_ms in PHONE_MS]
    images = FeedImages(feed)
    indices = [0, 5, 45, 59, 2]  # ahead, across the change of the rate, and back
    assert [round((level(images.read(index)) - 10) / 4) for index in indices] == indices
    images.close()


@pytest.mark.parametrize(("kept", "why"), [(0, "it is empty"), (600, "neither a feed folder nor a video .*cut off")])
def test_an_empty_and_a_cut_off_video_are_named(phone_video_path: Path, kept: int, why: str) -> None:
    phone_video_path.write_bytes(phone_video_path.read_bytes()[:kept])
    with pytest.raises(FeedError, match=rf"phone\.mp4: {why}"):
        read_feed(phone_video_path)


def test_a_file_that_is_no_video_is_refused_without_a_word_of_ffmpeg(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "drive.mp4").write_bytes(b"no video" * 500)
    with pytest.raises(FeedError, match=r"drive\.mp4: neither a feed folder nor a video"):
        read_feed(tmp_path / "drive.mp4")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("spare_bytes", [0, 1, 20])
def test_a_full_disk_leaves_whole_rows_and_no_picture_without_a_row(tmp_path: Path, spare_bytes: int) -> None:
    path = tmp_path / "feed"
    image = np.zeros((8, 8, 3), np.uint8)
    with FeedWriter(path, HEADER) as writer:
        for stamp_ns in range(60):  # until the rows are longer than a picture
            writer.write(image, FeedRow("", stamp_ns))
        limit = (path / "frames.csv").stat().st_size + spare_bytes
        with full_disk(limit), pytest.raises(OSError, match=r"too large|No space"):
            writer.write(image, FeedRow("", 60))
        assert len(read_feed(path).rows) == len(list((path / "frames").iterdir())) == 60
        writer.write(image, FeedRow("", 61))
    assert [row.stamp_ns for row in read_feed(path).rows[-2:]] == [59, 61]
