"""Recorded drives on real autopilots, driven once more. What comes out of two is in the goldens of `drives/`."""

from __future__ import annotations

import csv
import gzip
import json
import math
import shutil
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.commands.parser import build_parser
from edge.errors import FeedError
from edge.journal.records import FixSent
from edge.localization import PlaceFix
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE, MessageContext, vision_position
from edge.telemetry.session import Origin
from sim import geodetic
from sim.datasets.flight_logs import tlog_frames
from sim.research.trial.flight_camera import FlightCamera, Scenes
from sim.research.trial.flight_score import Score, SentPosition, score
from sim.research.trial.flights_command import RESETS, Flight, ReplayFailure, page, publish, replay_all
from sim.research.trial.recorded_drive import JOURNAL, LINK, RecordedDrive, first_boot, read_drive
from tests.golden.harness import HERE

EXCERPT = HERE / "drives" / "ardupilot_night"


@pytest.fixture(scope="module")
def drive() -> RecordedDrive:
    """40 s of a drive home at night."""
    return read_drive(EXCERPT)


def position(drive: RecordedDrive, at_s: float, ahead_m: float, right_m: float) -> mavlink.MAVLink_command_int_message:
    """A position of half a second before, so far from the truth."""
    heading_rad = np.radians(drive.heading_deg(at_s - 0.5))
    ahead = np.array([np.sin(heading_rad), np.cos(heading_rad)])
    east_m, north_m = drive.true_m(at_s - 0.5) + ahead_m * ahead + right_m * np.array([ahead[1], -ahead[0]])
    lat_deg, lon_deg = geodetic(east_m, north_m)
    at = round(lat_deg * 1e7), round(lon_deg * 1e7)
    return mavlink.MAVLink_command_int_message(1, 1, 0, EXTERNAL_POSITION_ESTIMATE, 0, 0, 0.0, 0.5, 3.0, 0.0, *at, 0.0)


def sent(message: mavlink.MAVLink_command_int_message, along_m: float | None) -> FixSent:
    """What the journal has of it."""
    at = message.x / 1e7, message.y / 1e7
    return FixSent(0, "external_position", *at, 2.0, 0.0, 0.5, 1.0, level_along_m=along_m, level_cross_track_m=along_m)


def test_positions_are_judged_by_the_truth_at_their_own_moment(drive: RecordedDrive) -> None:
    lost_s = drive.gps_lost_s
    messages = [position(drive, lost_s + 5.0, 7.0, 0.0), position(drive, lost_s + 20.0, 0.0, -1.0)]
    times_s = lost_s + 5.0, lost_s + 20.0
    found = score(
        drive, list(zip(times_s, messages, strict=True)), [sent(messages[0], 6.0), sent(messages[1], None)], drive.used
    )
    assert [one.along_m for one in found.positions] == pytest.approx([7.0, 0.0], abs=0.02)
    assert [one.cross_track_m for one in found.positions] == pytest.approx([0.0, -1.0], abs=0.02)
    row = found.row()
    assert (row["sent"], row["beyond_3"], row["beyond_4"], row["levels"]) == (2, 1, 0, 1)
    assert (row["over_along"], row["over_cross_track"]) == (1, 0)
    assert row["max_m"] == pytest.approx(7.0, abs=0.02)
    assert row["silent_s"] == pytest.approx(15.0, abs=0.05)
    driven_m = drive.driven_m(lost_s + 5.0) - drive.driven_m(lost_s)
    assert driven_m > 5.0 and row["first_m"] == pytest.approx(driven_m, abs=0.01)


def test_a_reset_that_is_further_from_the_truth_than_the_autopilot_was_is_counted(drive: RecordedDrive) -> None:
    at_s = drive.gps_lost_s + 20.0
    east_m, north_m = drive.own_m(at_s - 0.5) - drive.true_m(at_s - 0.5)
    own_m = math.hypot(east_m, north_m)
    assert own_m > 0.1
    heading_rad = np.radians(drive.heading_deg(at_s - 0.5))
    ahead_m = east_m * np.sin(heading_rad) + north_m * np.cos(heading_rad)
    right_m = east_m * np.cos(heading_rad) - north_m * np.sin(heading_rad)
    share = 2.5 / own_m  # of the autopilot's own error: 2.5 m further, twice by a pose and once by a sequence
    offsets = [(1.0 + share, 7), (1.0 + share, 7), (1.0 + share, 0), (1.0, 0)]
    messages = [
        position(drive, at_s, by * ahead_m, by * right_m + 0.01 * number) for number, (by, _) in enumerate(offsets)
    ]
    journal = [
        msgspec.structs.replace(sent(message, None), points=points)
        for message, (_, points) in zip(messages, offsets, strict=True)
    ]
    row = score(drive, [(at_s, message) for message in messages], journal, drive.used).row()
    assert [row[key] for key in RESETS] == [0, 2, 0, 1], "the last one moves nothing"
    flown = Flight(
        "night", "", score(drive, [], [], []), score(drive, [(at_s, messages[0])], journal, []), [], [], [], 0.0
    )
    assert (
        "by keypoint poses 0 brought the autopilot nearer to the truth, 1 did not; by sequence matches 0, 0 did not"
        in page([flown])
    )


def test_a_pose_that_would_be_fused_is_found_in_the_journal_by_when_it_was_sent(drive: RecordedDrive) -> None:
    """Its own sigma lacks the error of the map."""
    at_s, boot_s = drive.gps_lost_s + 5.0, 123.4567
    east_m, north_m = drive.true_m(at_s)
    origin, (lat_deg, lon_deg) = drive.origin_deg, geodetic(east_m, north_m + 0.5)
    assert origin is not None
    fix = PlaceFix(1, 0, lat_deg, lon_deg, 0.0, 0.1, 0.1, "reverse", "same", 1.0)
    sending = MessageContext(1, boot_s, 0.0, origin=Origin(*origin, 0.0))
    known = msgspec.structs.replace(sent(position(drive, at_s, 0.0, 0.0), None), send_boot_s=boot_s, points=9)
    known = msgspec.structs.replace(known, way="vision_position", sigma_m=0.25)
    found = score(drive, [(at_s, vision_position(fix, sending))], [known], drive.used)
    (pose,) = found.positions
    assert pose.is_fused and pose.error_m == pytest.approx(0.5, abs=0.01) and pose.sigmas == pytest.approx(2.0, abs=0.1)
    assert found.row()["fused"] == 1


def test_a_drive_without_positions_is_silent_to_its_end(drive: RecordedDrive) -> None:
    row = score(drive, [], [], drive.used).row()
    assert row["sent"] == 0 and np.isnan([row["median_m"], row["first_m"]]).all()
    assert row["silent_s"] == pytest.approx(drive.moves_s[1] - drive.gps_lost_s, abs=0.01)
    assert row["used"] == len(drive.used)
    assert row["used"] > row["believed"] > 0 and row["false"] == 0


def test_pictures_come_when_they_did_and_are_rendered_once(drive: RecordedDrive, tmp_path: Path) -> None:
    def taken(renders: int) -> list[NDArray[np.uint8]]:
        stamps_s, now_s = drive.runs[0].exposures_s[[300, 301]], [0.0]
        with closing(Scenes(tmp_path / "scenes.sqlite")) as scenes:
            camera = FlightCamera(drive, drive.runs[0].exposures_s, "front", scenes, lambda: round(now_s[0] * 1e9))
            assert camera.take(0.0) is None
            pictures = []
            for index, stamp_s in enumerate(stamps_s, start=300):
                now_s[0] = stamp_s + drive.latency_s + 0.01
                frame = camera.take(0.0)
                assert frame is not None and (frame.index, frame.stamp_ns) == (index, round(stamp_s * 1e9))
                assert camera.take(0.0) is None
                pictures.append(frame.image)
            assert camera.health.delivered == 302
            assert scenes.rendered == renders
            return pictures

    first, second = taken(renders=2)
    assert first.shape == (240, 320, 3) and (first != second).any()
    again, _ = taken(renders=0)
    assert (again == first).all()


def test_exposures_are_those_of_the_journal_or_of_the_config_without_one(drive: RecordedDrive, tmp_path: Path) -> None:
    (run,) = drive.runs
    assert np.diff(run.exposures_s) == pytest.approx(0.1, abs=0.02)
    assert run.from_s <= run.exposures_s[0] < run.from_s + 0.2 and run.to_s - 0.2 < run.exposures_s[-1] < run.to_s
    folder = tmp_path / "no_daemon"
    shutil.copytree(EXCERPT, folder, ignore=shutil.ignore_patterns("*.jsonl*"))
    (alone,) = read_drive(folder).runs
    assert (alone.from_s, alone.to_s) == pytest.approx((run.from_s, run.to_s), abs=0.3)
    assert len(alone.exposures_s) == pytest.approx(len(run.exposures_s), abs=4)


def test_a_link_on_which_nobody_asked_for_streams_has_the_autopilots_motion(
    tmp_path: Path, drive: RecordedDrive
) -> None:
    """Flown without Lookback, ArduPilot sends one position a second."""
    folder, kinds = copied(tmp_path / "off", "*.jsonl*"), ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE")
    thinned, left = bytearray(), dict.fromkeys(kinds, 0)
    for stamp_us, _, data in tlog_frames(gzip.decompress((folder / LINK).read_bytes())):
        message = MavlinkCodec(1, 1).decode(data)
        kind = message[0].get_type() if message else ""
        left[kind] = left.get(kind, 0) + 1
        if kind not in (*kinds, "AUTOPILOT_VERSION", "PARAM_VALUE") or (kind in kinds and left[kind] % 10 == 1):
            thinned += struct.pack(">Q", stamp_us) + data
    (folder / LINK).write_bytes(gzip.compress(bytes(thinned)))
    alone = read_drive(folder)
    assert alone.gps_lost_s == pytest.approx(drive.gps_lost_s, abs=0.1)
    for kind in kinds:
        found = [one for one in alone.link if one.message.get_type() == kind]
        assert len(found) == len(drive.own["mono_s"])
    before = [one.message.get_type() for one in alone.link if one.time_s < drive.runs[0].from_s]
    assert {"AUTOPILOT_VERSION", "PARAM_VALUE"} <= set(before)
    one = next(
        one.message
        for one in alone.link
        if one.message.get_type() == "GLOBAL_POSITION_INT" and one.time_s > alone.gps_lost_s
    )
    real = min(
        (one.message for one in drive.link if one.message.get_type() == "GLOBAL_POSITION_INT"),
        key=lambda other: abs(other.time_boot_ms - one.time_boot_ms),
    )
    assert (one.lat, one.lon, one.hdg) == pytest.approx((real.lat, real.lon, real.hdg), abs=120)
    assert (one.vx, one.vy) == pytest.approx((real.vx, real.vy), abs=15)


def test_the_page_has_what_the_pilot_read(drive: RecordedDrive) -> None:
    text = mavlink.MAVLink_statustext_message(4, b"Lookback: GPS faulty")
    now = score(drive, [(drive.gps_lost_s + 1.5, text)], [], drive.used)
    found = page([Flight("night", "ArduPilot, night", score(drive, [], [], []), now, [], [1.0, 2.0, 3.0], [], 1234.0)])
    assert "| 1 ArduPilot, night | 0 | - |" in found
    assert "1.5 s  Lookback: GPS faulty" in found
    assert "All 1 drives together, 1.2 km since GPS was lost:" in found


def test_docs_have_a_line_for_each_kind_and_a_file_of_all_drives(drive: RecordedDrive, tmp_path: Path) -> None:
    empty, sent = score(drive, [], [], []), [SentPosition(1.0, 5.0, 0, error, 0.0, error, 2.0) for error in (1.0, 3.0)]
    flown = msgspec.structs.replace(empty, positions=sent)
    flights: list[Flight | ReplayFailure] = [
        Flight("ardupilot_a", "ArduPilot, night", empty, flown, [2.0, 2.5, 3.0], [1.0, 2.0, 3.0], [], 1234.0),
        Flight("ardupilot_b", "ArduPilot, night", empty, empty, [4.0, 4.5, 5.0], [1.0, 2.0, 3.0], [], 1000.0),
        ReplayFailure("px4_c", "it has no truth"),
    ]
    page_ = tmp_path / "flights.md"
    page_.write_text("<!-- flights: begin -->\n<!-- flights: end -->\n")
    publish(flights, "FOLDER", page_)
    text = page_.read_text()
    assert "| 2 ArduPilot, night | 2 | 2.0 / 2.9 / 3.0 m | 1.12 / 1.5 | 0, 0 |" in text
    assert text.count("| 3.0 m |") == 1  # the median of both drives' dead reckoning
    assert "All 2 drives together" in text
    with (tmp_path / "flights.csv").open(newline="") as file:
        named = list(csv.DictReader(file))
    assert [(one["drive"], one["when"]) for one in named][2:4] == [("ardupilot_b", "then"), ("ardupilot_b", "now")]
    assert (named[1]["sent"], named[1]["max_m"], named[0]["max_m"], named[1]["reckoned_m_p95"]) == ("2", "3", "", "2.5")
    assert named[4]["kind"] == "not replayed: it has no truth"


def copied(folder: Path, *without: str) -> Path:
    """The drive at `folder`, without some of its files."""
    shutil.copytree(EXCERPT, folder, ignore=shutil.ignore_patterns(*without))
    return folder


def test_what_cannot_be_replayed_has_a_row_that_says_why(tmp_path: Path) -> None:
    half, cut = copied(tmp_path / "half", "truth*"), copied(tmp_path / "cut")
    learned, unread = copied(tmp_path / "learned"), copied(tmp_path / "unread", "scenario.toml")
    (cut / LINK).write_bytes((cut / LINK).read_bytes()[:5000])
    journal = gzip.decompress((learned / JOURNAL).read_bytes())
    (learned / JOURNAL).write_bytes(gzip.compress(journal.replace(b'"place":', b'"map":"d3_front_dusk","place":')))
    output = tmp_path / "out"
    output.mkdir()
    replay_all([half, cut, learned, unread], output, tmp_path / "views", 1)
    with (output / "flights.csv").open(newline="") as file:
        said = dict(list(csv.reader(file))[1:])
    assert said["half"] == f"not replayed: {half}: no recorded drive, it has no truth.csv.gz"
    assert said["cut"].startswith(f"not replayed: {cut}: a file of it is damaged: ")
    assert said["learned"].startswith("not replayed: its map was learned from several, and it has no record")
    assert said["unread"].startswith(f"not replayed: {unread}")
    assert [one["name"] for one in json.loads((output / "flights.json").read_bytes())] == [
        *("half", "cut", "learned", "unread")
    ]


def test_a_clock_that_starts_anew_within_its_first_seconds_is_no_reboot() -> None:
    starting = [3052.0, 4041.0, 5042.0, 3042.0, 4041.0, 9941.0]
    assert first_boot(np.array([*starting, 12_000.0, 13_000.0])) == slice(3, 8)
    assert first_boot(np.array([*starting, 12_000.0, 1_000.0, 500_000.0])) == slice(3, 7)
    assert first_boot(np.array([*starting, 12_000.0, 8_000.0, 1_000.0])) == slice(3, 7)


def test_a_folder_without_drives_is_one_line(tmp_path: Path) -> None:
    words = ["dev", "flights", str(tmp_path)]
    args = build_parser(words).parse_args(words)
    with pytest.raises(FeedError, match=r"no recorded drive in it; one has telem2\.tlog\.gz"):
        args.run(args)


@pytest.fixture
def replayed(shared: Path, tmp_path: Path) -> Callable[[str], tuple[Score, Score]]:
    """Replays the recorded drive of that name: how it was recorded, and how it is now."""

    def found(name: str) -> tuple[Score, Score]:
        folder = shared / name
        if not folder.is_dir():
            pytest.skip(f"needs the recorded drive {folder}")
        (flight,) = replay_all([folder], tmp_path, tmp_path / "views", 1, keypoints=True)
        assert isinstance(flight, Flight)
        return flight.then, flight.now

    return found


@pytest.mark.soak
def test_a_replay_repeats_what_was_recorded(replayed: Callable[[str], tuple[Score, Score]]) -> None:
    then, now = (one.row() for one in replayed("flights_eca2e43/ardupilot_a953"))
    assert now["used"] == pytest.approx(then["used"], abs=5)
    assert now["believed"] >= 0.9 * then["believed"]
    assert then["false"] == now["false"] == 0
    assert now["median_m"] == pytest.approx(then["median_m"], abs=0.7)
    assert now["p95_m"] == pytest.approx(then["p95_m"], abs=1.5)
    assert now["sigmas_max"] < 3.0


@pytest.mark.soak
def test_where_nothing_measures_the_velocity_no_position_comes(
    replayed: Callable[[str], tuple[Score, Score]],
) -> None:
    """PX4 without a velocity aid, by which a frame was used every 45 m and more: its velocity ran away."""
    then, now = replayed("flights_b06f79e/px4_no_aid_person_296_w921")
    assert then.row()["false"] > 0 and now.row()["false"] == 0
    assert not now.positions


@pytest.mark.soak
def test_positions_come_again_after_a_reboot_far_from_the_origin(
    replayed: Callable[[str], tuple[Score, Score]],
) -> None:
    """342 m from it; then there was none for 558 m."""
    then, now = replayed("flights_b06f79e/ardupilot_reboot913")
    last_s = max(one.time_s for one in then.positions)
    again = [one for one in now.positions if one.time_s > last_s + 30.0]
    assert len(again) >= 10
    assert max(one.error_m / one.sigma_m for one in again if one.sigma_m) < 3.0


@pytest.mark.soak
def test_a_map_is_made_again_by_the_camera_that_made_it(replayed: Callable[[str], tuple[Score, Score]]) -> None:
    """A front camera's, along which it goes once more; a rear camera's has no keypoints that it could see."""
    then, now = (one.row() for one in replayed("flights_b0903bde/ardupilot_rep974_dusk"))
    assert now["believed"] >= then["believed"] - 5
    assert now["p95_m"] == pytest.approx(then["p95_m"], abs=1.0)
