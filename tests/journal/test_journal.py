"""The journal on a real disk, torn by hand, and on /dev/full."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Annotated

import msgspec
import pytest
from msgspec.inspect import Metadata, StructType, UnionType, type_info

import edge
from edge.errors import ConfigError
from edge.journal.journal import Journal, QueuedJournal, earlier_files, rotate
from edge.journal.records import (
    KINDS,
    RENAMED,
    SCHEMA,
    CameraDiffers,
    FixAnswered,
    FixChecked,
    FixSent,
    FixWithheld,
    FrameUsed,
    GpsJudged,
    JournalOpened,
    JournalResumed,
    LinkChanged,
    MapExcluded,
    PlaceFix,
    PluginFailed,
    PositionMessageChosen,
    PositionStated,
    Record,
    SourceSetAnswered,
    StateChanged,
    SteeringChanged,
    Stopped,
    VehicleMisled,
)
from edge.telemetry.shadow import ShadowPosition
from edge_plugins.home.home_requests import HomeAnswered
from edge_plugins.mapping.status import MappingChanged
from edge_plugins.motion.camera_motion import MotionMeasured
from edge_plugins.motion.velocity_sender import VelocityChanged
from sim.evaluation.replay import as_line
from sim.journal import JournalLine, UnknownRecord, read_journal, records_of
from tests.files_written import full_disk


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "new folder" / "events.jsonl"


def write(path: Path, *texts: str) -> None:
    journal = Journal(path, unix_time_s=lambda: 1_700_000_000.1234)
    assert all(journal.write(StateChanged(text)) for text in texts)
    journal.close()


def texts(path: Path) -> list[str]:
    return [record.state for record in records_of(path, StateChanged)]


def test_each_record_is_a_line_and_openings_append(path: Path) -> None:
    write(path, "one", "two\nlines")
    write(path, "three")
    assert path.read_text().splitlines()[:2] == [
        f'{{"unix_s":1700000000.123,"event":"journal_opened","schema":{SCHEMA},"lookback":"{edge.__version__}",'
        f'"renamed":{json.dumps(RENAMED, separators=(",", ":"))}}}',
        '{"unix_s":1700000000.123,"event":"state","state":"one","why":""}',
    ]
    assert path.read_text().count("\n") == 2 + 3
    assert texts(path) == ["one", "two\nlines", "three"]


def test_a_crash_at_any_byte_of_the_last_line_costs_that_line_only(path: Path) -> None:
    write(path, "one", "two")
    whole = path.read_bytes()
    first = whole.rindex(b"\n", 0, -1) + 1
    for size in range(first, len(whole)):
        path.write_bytes(whole[:size])
        assert texts(path) == (["one"] if size < len(whole) - 1 else ["one", "two"])
        write(path, "three")
        assert texts(path) == (["one", "three"] if size < len(whole) - 1 else ["one", "two", "three"])
        assert path.read_bytes().startswith(whole[:size])


def test_a_full_disk_is_reported_once_and_is_not_fatal(caplog: pytest.LogCaptureFixture) -> None:
    journal = Journal(Path("/dev/full"))
    assert not journal.write(StateChanged("one"))
    assert not journal.write(StateChanged("two"))
    assert journal.lost == 3, "with journal_opened"
    assert [record.getMessage() for record in caplog.records] == [
        "/dev/full: cannot write the journal: No space left on device"
    ]
    journal.close()


def test_a_disk_that_fills_inside_a_line_leaves_the_next_line_whole(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    journal = Journal(path)
    opened = path.stat().st_size
    with full_disk(opened + 20):  # the kernel then writes 20 bytes
        assert not journal.write(StateChanged("one"))
    assert path.stat().st_size == opened + 20
    assert journal.write(StateChanged("two"))
    assert texts(path) == ["two"]
    assert "1 lines were lost" in caplog.text
    journal.close()


def test_a_disk_that_hangs_keeps_nobody_waiting_and_what_is_dropped_is_counted(tmp_path: Path) -> None:
    """A pipe that nobody reads stands for the disk: a write to a full one blocks."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    size = fcntl.fcntl(reader, fcntl.F_SETPIPE_SZ, 4096)
    journal = QueuedJournal(Journal(path, unix_time_s=lambda: 1_700_000_000.0), room=10)
    written = [journal.write(StateChanged(f"{number:03}", "x" * 1000)) for number in range(50)]
    assert not written[-1] and journal.why_lost == "the disk hangs"
    assert journal.lost == written.count(False) and journal.lost >= 50 - 10 - size // 1000 - 2
    os.set_blocking(reader, True)
    lines = b""
    while not journal.write(JournalResumed(journal.lost)):
        lines += os.read(reader, 4096)
    drain = threading.Thread(target=lambda: [None for _ in iter(lambda: keep(os.read(reader, 4096)), b"")])
    kept: list[bytes] = [lines]

    def keep(data: bytes) -> bytes:
        kept.append(data)
        return data

    drain.start()
    assert not journal.lost
    journal.close()
    drain.join()
    os.close(reader)
    *states, resumed = [msgspec.json.decode(line) for line in b"".join(kept).splitlines()[1:]]
    assert [one["state"] for one in states] == [f"{number:03}" for number in range(50) if written[number]], "in order"
    assert (resumed["event"], resumed["lost"]) == ("journal", written.count(False))


def test_what_waits_is_written_at_the_end(path: Path) -> None:
    journal = QueuedJournal(Journal(path))
    assert all(journal.write(StateChanged(str(number))) for number in range(500))
    journal.close()
    journal.close()
    assert not journal.write(StateChanged("too late"))
    assert texts(path) == [str(number) for number in range(500)]


def test_a_journal_that_cannot_be_opened_is_a_config_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=rf"\[telemetry\] journal: {tmp_path}: cannot append to it: Is a directory"):
        Journal(tmp_path)


READ_ONLY = """
import subprocess, sys
from pathlib import Path
from edge.journal.journal import Journal
from sim.journal import records_of
from edge.journal.records import StateChanged
disk = Path(sys.argv[1])
mount = lambda *options: subprocess.run(["mount", *options], check=True)
mount("-t", "tmpfs", "-o", "ro", "none", disk)
journal = Journal(disk / "folder" / "events.jsonl")
assert not journal.write(StateChanged("lost")) and journal.why_lost == "Read-only file system", journal.why_lost
mount("-o", "remount,rw", disk)
assert journal.write(StateChanged("kept")) and not journal.lost
journal.close()
print([record.state for record in records_of(disk / "folder" / "events.jsonl", StateChanged)])
"""


def test_a_disk_that_is_read_only_at_the_start_is_written_when_it_can_be(tmp_path: Path) -> None:
    """Navigation comes before the log: an error of the disk ends no daemon."""
    if subprocess.run(["unshare", "-rm", "true"], check=False, capture_output=True).returncode:
        pytest.skip("this user may not make a mount namespace")
    command = ["unshare", "-rm", sys.executable, "-c", READ_ONLY, str(tmp_path)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.stdout == "['kept']\n", done.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, who may give files away")
def test_what_root_begins_in_a_services_folder_is_the_services(path: Path) -> None:
    path.parent.mkdir()
    os.chown(path.parent, 4242, 4343)
    for _ in range(2):
        journal = Journal(path)
        journal.write(StateChanged("one"))
        journal.close()
    assert (path.stat().st_uid, path.stat().st_gid) == (4242, 4343)
    assert texts(path) == ["one", "one"]


EVERY_KIND: tuple[Record, ...] = (
    JournalOpened(SCHEMA, "1.2.3"),
    JournalResumed(7),
    StateChanged("degraded", "camera: it is gone"),
    MapExcluded("tile-3", "damaged"),
    PluginFailed("page", "KeyError: 7"),
    MappingChanged("waiting", "no GPS", "20260101T120000Z", 12),
    LinkChanged("up", "", "udp:127.0.0.1:14550"),
    CameraDiffers(80.0, 88.1, 0.4, -0.01, 0.005),
    MotionMeasured(9_000_000_000, 7.1, 0.14, -0.02, 0.1, 7.0, 1.39, ""),
    VelocityChanged(is_sent=False, why="too old"),
    FrameUsed(5, 9_000_000_000),
    FrameUsed(
        6,
        9_100_000_000,
        True,
        True,
        2,
        "tile-3",
        4,
        8,
        1.25,
        0.75,
        0.5,
        "reverse",
        "swapped",
        -27.0,
        153.0,
        90.0,
    ),
    PlaceFix(9, 4, None, None, None, 2.0, 1.0, "forward", "same", 1.3),
    PlaceFix(9, 4, -27.0, 153.0, 90.0, 2.0, 1.0, "forward", "same", 1.3, 5, "tile-3"),
    PositionMessageChosen("report", "[telemetry] emit = report"),
    FixWithheld(4, "standing"),
    VehicleMisled("faulty", True),
    FixSent(4, "external_position", -27.0, 153.0, 2.0, 12.5, 0.25, None, "tile-3"),
    FixAnswered(4, "ACCEPTED"),
    FixChecked(4, True, 0.5),
    GpsJudged("faulty", -3.5, 12.0, 1.0),
    SteeringChanged("lost", "dead reckoning"),
    PositionStated(-27.0, 153.0, 30.0, "page", "GPS is in use"),
    HomeAnswered(True, "uploaded and verified: 300 m back along drive 1 (out), 12 waypoints for 151 places", 13),
    SourceSetAnswered(2, "ACCEPTED"),
    ShadowPosition(5, 8.5, 12.0, "standing", 48.1, 11.5, 0.5, "rtk_fixed"),
    Stopped(120, 7, {"network": 8.5}, {"delivered": 130, "overwritten": 10, "bad": 0}),
)


OTHERS = ShadowPosition, MotionMeasured, VelocityChanged, MappingChanged, HomeAnswered


def test_every_kind_of_record_is_read_as_it_was_written(path: Path) -> None:
    assert {type(record) for record in EVERY_KIND} == {*KINDS, *OTHERS}
    journal = Journal(path, unix_time_s=lambda: 1.5)
    assert all(journal.write(record) for record in EVERY_KIND)
    journal.close()
    opened, *lines = read_journal(path, *OTHERS)
    assert opened.record == JournalOpened(SCHEMA, edge.__version__, RENAMED)
    assert lines == [JournalLine(1.5, record) for record in EVERY_KIND]
    others = [line.record for line in read_journal(path) if isinstance(line.record, UnknownRecord)]
    assert [one.fields["event"] for one in others] == ["mapping", "motion", "velocity", "home", "shadow"], (
        "not asked for"
    )
    assert list(records_of(path, VelocityChanged)) == [VelocityChanged(is_sent=False, why="too old")]
    assert list(records_of(path, FixAnswered)) == [FixAnswered(4, "ACCEPTED")]


def test_the_journal_rounds_what_rules_decide_by_as_it_is(path: Path) -> None:
    journal = Journal(path)
    journal.write(PlaceFix(9, 4, -27.12345678949, None, 89.996, 2.004999, 1.5, "forward", "same", 1.23456))
    journal.close()
    (written,) = records_of(path, PlaceFix)
    assert written == PlaceFix(9, 4, -27.123456789, None, 90.0, 2.0, 1.5, "forward", "same", 1.2346)


class Guest(Record, frozen=True, tag="guest_measured"):
    """Of a plug-in that says nothing of digits."""

    share: Annotated[float, msgspec.Meta(ge=0)]
    count: int = 0


def test_a_number_without_digits_is_written_as_it_is(path: Path) -> None:
    journal = Journal(path)
    journal.write(Guest(1 / 3))
    journal.close()
    (line,) = [line.record for line in read_journal(path, Guest) if isinstance(line.record, Guest)]
    assert line == Guest(1 / 3)


def test_what_is_not_known_is_passed_on_as_it_is(path: Path) -> None:
    write(path, "one")
    with path.open("ab") as file:
        file.write(b'{"unix_s":2.0,"event":"horn","loud":true}\n{"unix_s":3.0,"event":"state"}\n\xff\n[1]\n')
    write(path, "two")
    unknown = [line for line in read_journal(path) if isinstance(line.record, UnknownRecord)]
    assert [line.unix_s for line in unknown] == [2.0, 3.0]
    assert unknown[0].record == UnknownRecord({"unix_s": 2.0, "event": "horn", "loud": True})
    assert texts(path) == ["one", "two"]


def test_keys_that_are_not_known_are_ignored(path: Path) -> None:
    path.parent.mkdir()
    path.write_text('{"unix_s":1.0,"event":"state","state":"one","why":"","since_s":4}\n')
    assert texts(path) == ["one"]


def test_a_newer_schema_may_mean_something_else(path: Path) -> None:
    """Its records are not read as ours; those of the next run of this version are."""
    path.parent.mkdir()
    newer = JournalOpened(SCHEMA + 1, "9.0")
    path.write_bytes(msgspec.json.encode(newer) + b"\n" + msgspec.json.encode(StateChanged("one")) + b"\n")
    write(path, "two")
    assert texts(path) == ["two"]
    assert [type(line.record) for line in read_journal(path)] == [
        JournalOpened,
        UnknownRecord,
        JournalOpened,
        StateChanged,
    ]


def test_the_names_of_an_older_schema_are_read_as_those_of_today(path: Path) -> None:
    """Each key and each word that schema 3 has renamed."""
    sent = FixSent(3, "external_position", -27.0, 153.0, 1.5, 12.0, 0.1, 2.0, level_cross_track_m=4.0)
    path.parent.mkdir()
    old = f"{msgspec.json.encode(sent).decode()}\n".replace("cross_track_m", "across_m")
    words = "agrees", "doubtful", "disagrees", "wrong", "map wrong", "cannot say", "not recognized"
    judged = [f'{{"event":"gps_judged","state":"{word}"}}\n' for word in words]
    path.write_text("".join([old, *judged]))
    states = "consistent", "suspect", "inconsistent", "faulty", "map faulty", "cannot say", "not recognized"
    assert [line.record for line in read_journal(path)] == [sent, *map(GpsJudged, states)]


def test_the_output_of_replay_is_read_as_frames(path: Path) -> None:
    path.parent.mkdir()
    used = FrameUsed(5, 9_000_000_000, place=3)
    path.write_text(as_line(used))
    assert list(read_journal(path)) == [JournalLine(None, used)]


def files(path: Path) -> list[str]:
    return sorted(file.name.removeprefix(path.name) for file in path.parent.iterdir())


def write_numbers(path: Path, count: int, max_bytes: float) -> None:
    journal = Journal(path, max_bytes=max_bytes)
    assert all(journal.write(StateChanged(str(number))) for number in range(count))
    journal.close()


def test_a_full_file_is_renamed_and_no_record_is_lost(path: Path) -> None:
    write_numbers(path, 60, max_bytes=10_000)
    assert len(files(path)) > 3
    assert texts(path) == [str(number) for number in range(60)]
    assert all(file.read_bytes().startswith(b'{"unix_s":') for file in path.parent.iterdir())
    assert all("journal_opened" in file.read_text().splitlines()[0] for file in path.parent.iterdir())


def test_the_oldest_file_goes_when_the_space_is_used(path: Path) -> None:
    write_numbers(path, 600, max_bytes=10_000)
    assert files(path) == ["", *(f".{number}" for number in range(1, 10))]
    assert sum(file.stat().st_size for file in path.parent.iterdir()) < 12_000
    kept = texts(path)
    assert kept == [str(number) for number in range(600 - len(kept), 600)]


def test_a_crash_between_two_renames_loses_nothing(path: Path) -> None:
    write_numbers(path, 60, max_bytes=10_000)
    oldest = len(files(path)) - 1
    path.with_name(f"{path.name}.{oldest}").rename(path.with_name(f"{path.name}.{oldest + 1}"))
    before = texts(path)
    write_numbers(path, 20, max_bytes=10_000)
    assert texts(path) == [*before, *(str(number) for number in range(20))]
    path.unlink()  # the last rename was done, and the new file not begun
    assert texts(path)[: len(before)] == before


def test_a_journal_that_is_renamed_while_it_is_read(path: Path) -> None:
    write_numbers(path, 30, max_bytes=10_000)
    lines = read_journal(path)
    first = next(lines)
    write_numbers(path, 30, max_bytes=2_000)
    assert isinstance(first.record, JournalOpened)
    states = [line.record.state for line in lines if isinstance(line.record, StateChanged)]
    assert states[:30] == [str(number) for number in range(30)]


def test_a_disk_that_is_full_at_the_next_file_loses_nothing(path: Path) -> None:
    journal = Journal(path, max_bytes=10_000)
    while not earlier_files(path):
        journal.write(StateChanged("one"))
    path.unlink()  # as if it could not be created: the lines go on into the renamed file
    before = earlier_files(path)
    rotate(path)
    assert earlier_files(path) == before
    journal.close()


def test_a_pipe_is_not_renamed(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    write_numbers(path, 30, max_bytes=100)
    assert files(path) == [""]
    os.close(reader)


def test_a_folder_that_cannot_be_written_keeps_the_one_file(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    write(path, "one")
    path.parent.chmod(0o500)
    write_numbers(path, 30, max_bytes=1_000)
    path.parent.chmod(0o700)
    assert "cannot begin a new file" in caplog.text
    assert len(texts(path)) == 31


def test_every_key_says_its_unit_and_meaning() -> None:
    """records.py is the reference that docs/journal.md names."""
    for kind in (*KINDS, *OTHERS):
        info = type_info(kind)
        assert kind.__doc__ and isinstance(info, StructType)
        for field in info.fields:
            kinds = field.type.types if isinstance(field.type, UnionType) else (field.type,)
            told = [one for one in kinds if isinstance(one, Metadata)]
            assert any("unit" in (one.extra or {}) and one.extra_json_schema for one in told), field.name
