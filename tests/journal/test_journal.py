"""The journal on a real disk, torn by hand, and on /dev/full."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest

from edge.errors import ConfigError
from edge.journal.journal import Journal, read_journal


class Note(msgspec.Struct, tag_field="event", tag="note"):
    text: str


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "new folder" / "events.jsonl"


def write(path: Path, *texts: str, sync: bool = False) -> None:
    journal = Journal(path, sync=sync, unix_time_s=lambda: 1_700_000_000.1234)
    assert all(journal.write(Note(text)) for text in texts)
    journal.close()


def texts(path: Path) -> list[str]:
    return [record["text"] for record in read_journal(path)]


@pytest.mark.parametrize("sync", [False, True])
def test_each_record_is_a_line_and_openings_append(path: Path, sync: bool) -> None:
    write(path, "one", "two\nlines", sync=sync)
    write(path, "three")
    assert path.read_text().splitlines()[0] == '{"unix_s":1700000000.123,"event":"note","text":"one"}'
    assert path.read_text().count("\n") == 3
    assert texts(path) == ["one", "two\nlines", "three"]


def test_a_crash_at_any_byte_of_the_last_line_costs_that_line_only(path: Path) -> None:
    write(path, "one", "two")
    whole = path.read_bytes()
    first = whole.index(b"\n") + 1
    for size in range(first, len(whole)):
        path.write_bytes(whole[:size])
        assert texts(path) == (["one"] if size < len(whole) - 1 else ["one", "two"])
        write(path, "three")
        assert texts(path) == (["one", "three"] if size < len(whole) - 1 else ["one", "two", "three"])
        assert path.read_bytes().startswith(whole[:size])


def test_a_full_disk_is_reported_once_and_is_not_fatal(caplog: pytest.LogCaptureFixture) -> None:
    journal = Journal(Path("/dev/full"))
    assert not journal.write(Note("one"))
    assert not journal.write(Note("two"))
    assert journal.lost == 2
    assert [record.getMessage() for record in caplog.records] == [
        "/dev/full: cannot write the journal: No space left on device"
    ]
    journal.close()


def test_a_disk_that_fills_inside_a_line_leaves_the_next_line_whole(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    import resource
    import signal

    journal = Journal(path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, before[0][1]))  # the kernel then writes 20 bytes of the line
        assert not journal.write(Note("one"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before[0])
        signal.signal(signal.SIGXFSZ, before[1])
    assert path.stat().st_size == 20
    assert journal.write(Note("two"))
    assert texts(path) == ["two"]
    assert "1 lines were lost" in caplog.text
    journal.close()


def test_a_journal_that_cannot_be_opened_is_a_config_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=rf"\[telemetry\] journal: {tmp_path}: cannot append to it: Is a directory"):
        Journal(tmp_path)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, who may give files away")
def test_what_root_begins_in_a_services_folder_is_the_services(path: Path) -> None:
    path.parent.mkdir()
    os.chown(path.parent, 4242, 4343)
    for _ in range(2):
        journal = Journal(path)
        journal.write(Note("one"))
        journal.close()
    assert (path.stat().st_uid, path.stat().st_gid) == (4242, 4343)
    assert texts(path) == ["one", "one"]
