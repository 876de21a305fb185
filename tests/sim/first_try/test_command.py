"""`lookback try` on small recordings of one street: the verdict, the page, and what is wrong with a recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("gpxpy")

from edge.__main__ import main
from edge.config import load_config
from edge.feed import FeedImages, read_feed

WriteTraverse = Callable[..., Path]
FPS, HERE_S = 5.0, 1_777_000_000
"""Of the videos, and the Unix time at which their tracks begin."""


@pytest.fixture(scope="module")
def out(write_traverse: WriteTraverse, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_traverse(tmp_path_factory.mktemp("try") / "out", range(65))


def as_video(feed_path: Path, file: Path, track_starts_s: float = 0.0) -> Path:
    """The pictures of a feed as a video, with the track of its positions beside it; the track may begin later."""
    feed = read_feed(feed_path)
    images = FeedImages(feed)
    size = (feed.header.width, feed.header.height)
    video = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), FPS, size)
    points = []
    for index, row in enumerate(feed.rows):
        video.write(images.read(index))
        at_s = index / FPS - track_starts_s
        if at_s >= 0:
            minutes, seconds = divmod(at_s, 60)
            time = f"2026-05-04T12:{int(minutes):02}:{seconds:06.3f}Z"
            points.append(f'<trkpt lat="{row.lat_deg}" lon="{row.lon_deg}"><time>{time}</time></trkpt>')
    video.release()
    file.with_suffix(".gpx").write_text(
        '<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1">'
        f"<trk><trkseg>{''.join(points)}</trkseg></trk></gpx>"
    )
    return file


def test_two_feeds_give_a_verdict_a_page_and_a_config(
    out: Path, write_traverse: WriteTraverse, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the 80 frames of the query, 65 are mapped."""
    again, folder = write_traverse(tmp_path / "again", noise=8.0), tmp_path / "tried"
    assert main(["try", str(out), str(again), "-o", str(folder), "--tolerance-m", "5"]) == 0
    printed = capsys.readouterr().out
    assert "m (forward, same): measured on this query, and used" in printed
    assert "of 67 frames on the mapped road" in printed
    page = (folder / "report.html").read_text()
    assert "warming up: a place is searched from 16 frames on" in page
    assert "not on the mapped road: no place of the map within 5 m" in page
    assert "http" not in page.replace("http://www.w3.org", "")
    lines = [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]
    assert len(lines) == 80
    assert page.count("<figcaption>query, frame ") == page.count(" inliers<") == 4
    assert load_config(folder / "lookback.toml").rig.sigma_forward_same_m > 0
    # What was tried once may be tried again; another folder is kept.
    (folder / "old").touch()
    assert main(["try", str(out), str(tmp_path / "nothing"), "-o", str(folder)]) == 78
    assert (folder / "old").exists(), "a wrong path clears nothing"


def test_two_videos_with_their_tracks(
    out: Path, write_traverse: WriteTraverse, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second track begins 2 s late, in the middle of the road; the first is of another name."""
    reference = as_video(out, tmp_path / "out.avi")
    reference.with_suffix(".gpx").rename(tmp_path / "track.gpx")
    query = as_video(write_traverse(tmp_path / "again", range(65), noise=8.0), tmp_path / "query.avi", 2.0)
    options = ["--reference-offset-s", "0", "--query-offset-s", "-2", "--fov-deg", "70", "--reference-positions"]
    options.append(str(tmp_path / "track.gpx"))
    assert main(["try", str(reference), str(query), "-o", str(tmp_path / "tried"), *options]) == 0
    printed = capsys.readouterr().out
    assert "\nRecognized" in printed, printed
    assert "precision 1.000" in printed
    feed = read_feed(tmp_path / "tried/query")
    assert feed.header.fov_deg == 70
    assert len(feed.rows) == 55, "those before the track have no position"
    assert feed.rows[0].lat_deg == pytest.approx(-27.0 + 20 / 110_800)
    # A map has the positions of the track beside a video as well; before, it had no keypoints.
    assert main(["map", "build", str(query), "-o", str(tmp_path / "map"), "--offset-s", "-2"]) == 0
    assert "keyframes have map points" in capsys.readouterr().out


@pytest.mark.long  # a whole try more, for one line of the verdict
def test_where_gps_had_a_gap_nothing_is_right_or_wrong(
    write_traverse: WriteTraverse, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the map, 15 places in the middle have no position, and of the query the last 5 frames."""
    for name, gap in (("out", range(30, 45)), ("again", range(75, 80))):
        path = write_traverse(tmp_path / name, noise=8.0 * (name == "again")) / "frames.csv"
        names, *rows = [line.split(",") for line in path.read_text().splitlines()]
        for row, column in product(gap, ("lat_deg", "lon_deg")):
            rows[row][names.index(column)] = ""
        path.write_text("".join(",".join(row) + "\n" for row in (names, *rows)))
    assert main(["try", *(str(tmp_path / name) for name in ("out", "again")), "-o", str(tmp_path / "tried")]) == 0
    printed = capsys.readouterr().out
    assert "\nRecognized" in printed and "precision 1.000" in printed and "nan" not in printed, printed
    assert "m (forward, same): measured on this query, and used" in printed, "where both have positions"
    assert "20 more accepted places are neither right nor wrong: the frame or the place has no position" in printed


@pytest.mark.parametrize("is_located", [False, True])
def test_without_positions_the_pace_is_found_and_nothing_is_claimed(
    write_traverse: WriteTraverse, tmp_path: Path, capsys: pytest.CaptureFixture[str], *, is_located: bool
) -> None:
    """Both drives without, or the second alone, which is 3.4 times as slow."""
    frames = range(80 if is_located else 45)
    out = write_traverse(tmp_path / "out", frames, is_located=is_located, period_ms=500)
    again = write_traverse(tmp_path / "again", frames, is_located=False, period_ms=1700, noise=8.0)
    with (again / "feed.toml").open("a", encoding="utf-8") as header:
        header.write("\ndistortion = [-0.1, 0.0, 0.0, 0.0]\n")
    assert main(["try", str(out), str(again), "-o", str(tmp_path / "tried")]) == 0
    printed = capsys.readouterr().out
    assert "\nRecognized" in printed, printed
    assert "whether they are right is not known: it needs positions in both recordings" in printed
    assert "the camera's offset is not known" in printed
    assert read_feed(tmp_path / "tried/query").header.distortion == (-0.1, 0.0, 0.0, 0.0)
    assert f"no positions in {'again' if is_located else 'out and again'}:" in printed
    assert ("no keypoints: without positions or distances of out" in printed) != is_located


def test_an_error_names_no_temporary_folder(
    out: Path, write_traverse: WriteTraverse, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both are read, and the pictures of neither: they are black."""
    video = tmp_path / "again.avi"
    as_video(write_traverse(tmp_path / "again"), video)
    black = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), FPS, (160, 120))
    for _ in range(80):
        black.write(np.zeros((120, 160, 3), np.uint8))
    black.release()
    words = ["try", str(out), str(video), "--query-offset-s", "0", "-o", str(tmp_path / "tried")]
    assert main(words) == 78
    error = capsys.readouterr().err
    assert str(tmp_path / "tried") in error and ".tried-" not in error


def test_each_mistake_is_one_line(out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").touch()
    folder = ["-o", str(tmp_path / "tried")]
    for words, message in (
        ([out, tmp_path / "none", *folder], "none: no such file or folder"),
        ([out, tmp_path / "empty", *folder], "empty: neither a feed (feed.toml), nor pictures, nor a layout of"),
        ([out, out, "-o", tmp_path / "mine"], "--output: "),
        ([out, out, *folder, "--tolerance-m", "0"], "--tolerance-m: 0 is not above 0"),
        ([out, out, *folder, "--query-view", "rear"], "--query-view: "),
        ([out, out, *folder, "--fov-deg", "170"], "--fov-deg: expected `float` <= 120"),
    ):
        assert main(["try", *map(str, words)]) == 78
        error = capsys.readouterr().err.strip()
        assert message in error
        assert "\n" not in error
    assert (tmp_path / "mine/notes.txt").exists()
