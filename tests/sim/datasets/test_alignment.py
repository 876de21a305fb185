"""Videos as phones write them, laid over tracks of other clocks: found to a stated sigma, or refused."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av")
pytest.importorskip("gpxpy")
pytest.importorskip("panda3d")

import av

from edge.errors import FeedError
from edge.feed import Feed, FeedImages, read_feed
from edge.geodesy import east_north_of, moved
from sim.datasets import ReadOptions, Traverse, open_dataset
from sim.datasets.alignment import Alignment
from sim.datasets.commands import add_arguments
from sim.traverse import driven_m, whole_sigma_m
from sim.world.recording import record_drive
from sim.world.scenario import Scenario

MakeOnce = Callable[[str, Callable[[Path], object]], Path]
BEGUN = datetime(2026, 5, 4, 12, 30, 20, tzinfo=timezone.utc)
"""When the first picture was taken, by the satellites' time."""
LEAD_S = 6.0
"""By so much the track was switched on earlier."""


@pytest.fixture(scope="session")
def drive_path(make_once: MakeOnce) -> Path:
    """A drive of 83 s with turns, at 10 pictures a second."""

    def fill(folder: Path) -> None:
        scenario = Scenario(seed=306, length_m=500.0, speed_mps=7.0, drive_seed=6, shaking=1.0, width=160, height=120)
        record_drive(scenario, folder / "feed", fps=10.0)

    return make_once("alignment-drive", fill) / "feed"


def write_phone_video(feed: Feed, file: Path, metadata: dict[str, str] | None = None, *, gray: bool = False) -> None:
    """An MP4 at 10 pictures a second, and 3.3 from its middle on; gray: of a camera that shows nothing."""
    images = FeedImages(feed)
    with av.open(str(file), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata.update(metadata or {})
        stream = container.add_stream("libx264", rate=30, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = feed.header.width, feed.header.height, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for index, row in enumerate(feed.rows):
            if index < len(feed.rows) // 2 or index % 3 == 0:
                image = (
                    np.full((feed.header.height, feed.header.width, 3), 90, np.uint8) if gray else images.read(index)
                )
                frame = av.VideoFrame.from_ndarray(image, "bgr24")
                frame.pts, frame.time_base = row.stamp_ns // 1_000_000, Fraction(1, 1000)
                container.mux(stream.encode(frame))
        container.mux(stream.encode())


def write_track(feed: Feed, file: Path, shift_s: float = 0.0, seed: int = 0) -> None:
    """A GPX track of a position a second, as noisy as a receiver's, from LEAD_S before the drive on (standing)."""
    rng = np.random.default_rng(seed)
    stamps_s = np.array([row.stamp_ns for row in feed.rows]) / 1e9
    at_s = np.arange(-LEAD_S, stamps_s[-1] + 5.0)
    wander_m, points = rng.normal(0, 1.5, 2), []
    for time_s in at_s:
        wander_m += rng.normal(0, 0.2, 2) - 0.01 * wander_m
        lat_deg, lon_deg = (
            np.interp(time_s, stamps_s, [getattr(row, name) for row in feed.rows]) for name in ("lat_deg", "lon_deg")
        )
        at = moved(float(lat_deg), float(lon_deg), *(wander_m + rng.normal(0, 0.1, 2)).tolist())
        time = (BEGUN + timedelta(seconds=float(time_s) + shift_s)).isoformat()
        points.append(f'<trkpt lat="{at[0]:.7f}" lon="{at[1]:.7f}"><time>{time}</time></trkpt>')
    track = f"<trk><trkseg>{''.join(points)}</trkseg></trk>"
    file.write_text(f'<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1">{track}</gpx>')


def opened(video: Path) -> tuple[Traverse, Alignment]:
    found = open_dataset("video-log", video)
    found.pictures.close()
    assert found.alignment is not None
    return found, found.alignment


def errors_m(traverse: Traverse, truth: Feed) -> list[float]:
    """How far each picture's position is from where it was taken."""
    video_ns = [row.stamp_ns - traverse.rows[0].stamp_ns for row in traverse.rows]
    known = {row.stamp_ns: row for row in truth.rows}
    found = []
    for row, at_ns in zip(traverse.rows, video_ns, strict=True):
        if row.lat_deg is not None and row.lon_deg is not None:
            true = known[min(known, key=lambda stamp_ns, at_ns=at_ns: abs(stamp_ns - at_ns))]  # type: ignore[misc]
            assert true.lat_deg is not None
            assert true.lon_deg is not None
            found.append(float(np.hypot(*east_north_of(row.lat_deg, row.lon_deg, (true.lat_deg, true.lon_deg), 0.0))))
    return found


STARTED = {"creation_time": "2026-05-04T12:30:20Z"}


@pytest.mark.parametrize(
    ("metadata", "shift_s", "how"),
    [
        ({}, 0.0, "by turns and speed alone, since it has no creation time"),
        (STARTED, 0.0, "by its creation time and by turns and speed"),
        (STARTED, 1.0, "by its creation time and by turns and speed"),
        (STARTED, 40.0, "by turns and speed, and not by its creation time, -40 s off"),
        (STARTED, 3600.0, r"by turns and speed, and not by its creation time, which is -1\.00 h off"),
        # Android writes when the recording ended, an iPhone when it began, with its zone.
        ({"com.android.version": "14"}, 0.0, "by its creation time and by turns and speed"),
        ({"com.apple.quicktime.creationdate": "2026-05-04T22:30:20+1000"}, 0.0, "by its creation time and by turns"),
    ],
)
def test_positions_are_right_whatever_the_clocks(
    drive_path: Path, tmp_path: Path, metadata: dict[str, str], shift_s: float, how: str
) -> None:
    truth = read_feed(drive_path)
    if "com.android.version" in metadata:
        ended = BEGUN + timedelta(seconds=truth.rows[-1].stamp_ns / 1e9)
        metadata = {**metadata, "creation_time": ended.strftime("%Y-%m-%dT%H:%M:%SZ")}
    write_phone_video(truth, tmp_path / "out.mp4", metadata)
    write_track(truth, tmp_path / "out.gpx", shift_s)
    traverse, alignment = opened(tmp_path / "out.mp4")
    assert np.median(errors_m(traverse, truth)) < 3.0
    assert alignment.sigma_s is not None
    assert abs(alignment.offset_s - LEAD_S) < 3 * alignment.sigma_s < 1.5
    assert re.search(how, alignment.how), alignment.how


def test_a_track_of_another_day_and_pictures_that_show_nothing_are_refused(drive_path: Path, tmp_path: Path) -> None:
    truth = read_feed(drive_path)
    write_phone_video(truth, tmp_path / "out.mp4", STARTED)
    write_track(truth, tmp_path / "out.gpx", 86_400.0)
    with pytest.raises(FeedError, match=r"out\.mp4: made at 2026-05-04 12:30:20 UTC .* of 2026-05-05.* another drive"):
        open_dataset("video-log", tmp_path / "out.mp4")
    write_phone_video(truth, tmp_path / "fog.mp4", gray=True)
    write_track(truth, tmp_path / "fog.gpx")
    with pytest.raises(FeedError, match=r"fog\.mp4: where it lies on its track is not known: it has no creation time"):
        open_dataset("video-log", tmp_path / "fog.mp4")
    given = open_dataset("video-log", tmp_path / "fog.mp4", ReadOptions(offset_s=LEAD_S))
    assert np.median(errors_m(given, truth)) < 3.0


def test_a_creation_time_alone_is_as_good_as_its_clock(drive_path: Path, tmp_path: Path) -> None:
    """And it goes into the feed, so that its map can carry it."""
    truth = read_feed(drive_path)
    said = {"com.apple.quicktime.creationdate": "2026-05-04T14:30:20+0200"}
    write_phone_video(truth, tmp_path / "fog.mp4", said, gray=True)
    write_track(truth, tmp_path / "fog.gpx")
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    args = parser.parse_args([str(tmp_path / "fog.mp4"), "-o", str(tmp_path / "feed")])
    assert args.run(args) == 0
    feed = read_feed(tmp_path / "feed")
    assert feed.header.time_sigma_s == pytest.approx(1.0, abs=0.1)
    length_m, seconds = (driven_m(feed) or [])[-1], (feed.rows[-1].stamp_ns - feed.rows[0].stamp_ns) / 1e9
    assert length_m / seconds < (whole_sigma_m(feed) or 0.0) < 2 * length_m / seconds
    assert "by its creation time alone" in feed.header.notes
    assert 'alt="the video began' in (tmp_path / "feed/sheet.html").read_text()


@pytest.mark.soak
def test_the_stated_sigma_holds_on_20_videos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Roads, drives and light that nothing was tuned on. Of a normal distribution 14 of 20 lie within one sigma."""
    lights = ("day", "night", "dusk", "rain")
    off, refused = [], 0
    for number in range(20):
        scenario = Scenario(
            seed=7001 + number,
            length_m=600.0,
            speed_mps=6.0 + number % 5,
            stops=number % 2,
            drive_seed=number + 1,
            light=lights[number % 4],  # type: ignore[arg-type]
            view=("front", "rear")[number // 2 % 2],
            shaking=1.0,
        )
        record_drive(scenario, tmp_path / f"{number}", fps=10.0)
        truth = read_feed(tmp_path / f"{number}")
        write_phone_video(truth, tmp_path / "out.mp4")
        write_track(truth, tmp_path / "out.gpx", seed=number)
        try:
            alignment = opened(tmp_path / "out.mp4")[1]
        except FeedError:
            refused += 1
            continue
        assert alignment.sigma_s is not None
        off.append(((alignment.offset_s - LEAD_S), alignment.sigma_s))
    errors_s, sigmas_s = np.array(off).T
    within = int((np.abs(errors_s) < sigmas_s).sum())
    with capsys.disabled():
        print(
            f"\n{len(off)} of 20 aligned, {refused} refused: {within} within one sigma, largest"
            f" {np.abs(errors_s / sigmas_s).max():.1f} sigma; median {np.median(np.abs(errors_s)):.2f} s,"
            f" largest {np.abs(errors_s).max():.2f} s, median sigma {np.median(sigmas_s):.2f} s"
        )
    assert len(off) >= 15
    assert within >= 0.6 * len(off)
    assert np.abs(errors_s / sigmas_s).max() < 3.0
