"""Videos as phones write them, laid over tracks of other clocks: found to a stated sigma, or refused."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av")
pytest.importorskip("gpxpy")
pytest.importorskip("panda3d")

from edge.errors import FeedError
from edge.feed import read_feed
from sim.datasets import ReadOptions, Traverse, open_dataset
from sim.datasets.alignment import STEP_S, Alignment, MotionSignal, likelihoods
from sim.datasets.commands import add_arguments
from sim.traverse import driven_m, whole_sigma_m
from sim.world.drive import plan_drive
from sim.world.recording import record_drive
from sim.world.route import generate_route
from sim.world.scenario import Scenario
from tests.sim.datasets.phone_video import LEAD_S, errors_m, of_android, write_phone_video, write_track

MakeOnce = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def drive_path(make_once: MakeOnce) -> Path:
    """A drive of 83 s with turns, at 10 pictures a second."""

    def fill(folder: Path) -> None:
        scenario = Scenario(seed=306, length_m=500.0, speed_mps=7.0, drive_seed=6, shaking=1.0, width=160, height=120)
        record_drive(scenario, folder / "feed", fps=10.0)

    return make_once("alignment-drive", fill) / "feed"


def opened(video: Path) -> tuple[Traverse, Alignment]:
    found = open_dataset("video-log", video)
    found.pictures.close()
    assert found.alignment is not None
    return found, found.alignment


STARTED = {"creation_time": "2026-05-04T12:30:20Z"}
ANDROID = {"com.android.version": "14"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("metadata", "shift_s", "how"),
    [
        ({}, 0.0, "by turns and speed alone, since it has no creation time"),
        (STARTED, 0.0, "by its creation time and by turns and speed"),
        (STARTED, 3.0, "by turns and speed"),
        (STARTED, 6.0, "by turns and speed, and not by its creation time, -6 s off"),
        (STARTED, 3600.0, r"by turns and speed, and not by its creation time, which is -1\.00 h off"),
        # Android writes when the recording ended, an iPhone when it began, with its zone.
        (ANDROID, 0.0, "by its creation time and by turns and speed"),
        ({"com.apple.quicktime.creationdate": "2026-05-04T22:30:20+1000"}, 0.0, "by its creation time and by turns"),
    ],
)
def test_positions_are_right_whatever_the_clocks(
    drive_path: Path, tmp_path: Path, metadata: dict[str, str], shift_s: float, how: str
) -> None:
    truth = read_feed(drive_path)
    write_phone_video(truth, tmp_path / "out.mp4", of_android(truth) if metadata == ANDROID else metadata)
    write_track(truth, tmp_path / "out.gpx", shift_s)
    traverse, alignment = opened(tmp_path / "out.mp4")
    assert np.median(errors_m(traverse, truth)) < 3.0
    assert alignment.sigma_s is not None
    assert abs(alignment.offset_s - LEAD_S) < 3 * alignment.sigma_s < 1.5
    assert re.search(how, alignment.how), alignment.how


@pytest.mark.long
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
    write_track(truth, tmp_path / "fog.gpx", lead_s=0.0, more_s=0.5)
    traverse, alignment = opened(tmp_path / "fog.mp4")
    assert "since it is as long as the track and has no creation time" in alignment.how
    assert (alignment.offset_s, alignment.sigma_s) == pytest.approx((0.0, 1.0), abs=0.1)
    assert np.median(errors_m(traverse, truth)) < 3.0


@pytest.mark.long
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


def test_a_camera_that_turns_elsewhere_than_the_antenna_is_within_the_stated_sigma() -> None:
    """As of a bus, 6 m ahead: its turns alone would be 0.9 s early. Both lines are those of a planned drive."""
    drive = plan_drive(generate_route(306, 700.0), seed=6, speed_mps=7.0, stops=2)
    at_s = np.arange(0.0, drive.duration_s, STEP_S)

    def motion(ahead_m: float) -> MotionSignal:
        poses = [drive.pose(time_s, ahead_m) for time_s in at_s]
        turn = np.gradient(np.unwrap([np.radians(pose.heading_deg) for pose in poses]), STEP_S)
        return MotionSignal(0.0, turn, np.log1p([pose.speed_mps for pose in poses]))

    for ahead_m in (-2.0, 0.0, 6.0):
        tried_s, likelihood = likelihoods(motion(ahead_m), motion(0.0))
        share = np.exp(likelihood - likelihood.max())
        off_s = float(share @ tried_s / share.sum())
        sigma_s = float(np.sqrt(share @ (tried_s - off_s) ** 2 / share.sum()))
        assert abs(off_s) < sigma_s < 0.5, (ahead_m, off_s, sigma_s)
