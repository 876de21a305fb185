"""The file of a drive's places: whole after a crash at every byte, and never in the way of anything else."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from edge.config import SamplingConfig
from edge.errors import MapError
from edge.reference_map import ModelKey, RegionsKey
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.place_log import OpenLog, PlaceLog, create_log
from edge_plugins.mapping.place_log_records import DriveBegun, LogHeader

HEADER = LogHeader(ModelKey("test", "0" * 64, "fc6", 4), RegionsKey("left-right", 0.4, "set"), SamplingConfig(), "test")


def raw_of(row: int) -> np.ndarray:
    return np.arange(8, dtype=np.float32).reshape(2, 4) + row


def place_of(row: int) -> Place:
    return Place(row, 47.0, 8.0, 400.0, 90.0, 2.0 * row, b"jpeg %d" % row, 1.5, "gps")


def written(path: Path, places: int) -> None:
    """A file of a drive of so many places."""
    file = PlaceLog(create_log(path, HEADER))
    assert file.begin_drive(DriveBegun("rear"))
    for row in range(places):
        while not file.add(raw_of(row), place_of(row)):
            assert not file.stopped
    file.close(timeout_s=30)


def test_raw_rows_are_there_before_and_after_they_are_written(tmp_path: Path) -> None:
    file = PlaceLog(create_log(tmp_path / "log", HEADER))
    for row in range(200):
        while not file.add(raw_of(row), place_of(row)):
            assert not file.stopped
        rows = sorted({row, max(0, row - 40), row // 2})
        if row >= 150 or rows[0] > row - 60:
            np.testing.assert_array_equal(file.raw_rows(rows), np.stack([raw_of(one) for one in rows]))
    file.close(timeout_s=30)


def test_a_file_cut_off_at_any_byte_has_every_place_that_was_written_whole(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "log"
    written(path, 4)
    whole = path.read_bytes()
    found = OpenLog(path)
    ends = [*found.places_at[1:], found.end]
    found.close()
    header_ends = whole.index(b"LBPL", 1)
    for length in range(len(whole) + 1):
        path.write_bytes(whole[:length])
        if length < header_ends:  # which is put in place whole
            with pytest.raises(MapError, match="not a file of places"):
                OpenLog(path)
            continue
        caplog.clear()
        found = OpenLog(path)
        count = sum(end <= length for end in ends)
        assert len(found.places_at) == count
        assert [found.place(row).place for row in range(count)] == [place_of(row) for row in range(count)]
        found.close()
        assert path.stat().st_size <= length
        assert bool(caplog.records) == (path.stat().st_size < length), "what is cut off is said"


def test_a_flipped_bit_costs_one_place_and_no_later_one(tmp_path: Path) -> None:
    path = tmp_path / "log"
    written(path, 3)
    found = OpenLog(path)
    begins = [*found.places_at, found.end]
    found.close()
    whole = path.read_bytes()
    for at in range(len(whole)):
        damaged = whole[:at] + bytes([whole[at] ^ 1 << at % 8]) + whole[at + 1 :]
        path.write_bytes(damaged)
        if at < whole.index(b"LBPL", 1):
            with pytest.raises(MapError, match="not a file of places"):
                OpenLog(path)
            assert path.read_bytes() == damaged, "what may be another's is left as it is"
            continue
        found = OpenLog(path)
        kept = [found.place(row).place for row in range(len(found.places_at))]
        assert kept == [place_of(row) for row in range(3) if not begins[row] <= at < begins[row + 1]]
        assert {drive.view for _, drive in found.drives} == {"rear"}
        assert [first for first, _ in found.drives] == ([0, 1] if begins[1] <= at < begins[2] else [0])
        found.close()


def test_places_after_a_damaged_byte_stay_and_are_appended_to(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "log"
    written(path, 400)
    found = OpenLog(path)
    at = found.places_at[10] + 40
    found.close()
    whole = path.read_bytes()
    path.write_bytes(whole[:at] + b"\xff" + whole[at + 1 :])
    file = PlaceLog(OpenLog(path))
    assert file.count == 399
    assert "399 places kept" in caplog.text
    assert file.add(raw_of(400), place_of(400))
    file.close(timeout_s=30)
    found = OpenLog(path)
    assert [found.place(row).place.row for row in range(400)] == [*range(10), *range(11, 401)]
    found.close()


def test_the_time_of_the_last_place_is_in_the_file(tmp_path: Path) -> None:
    """Neither a cut nor a copy makes a drive of ten days ago the drive of today."""
    path = tmp_path / "log"
    file = PlaceLog(create_log(path, HEADER))
    assert file.begin_drive(DriveBegun("rear"))
    for row in range(3):
        while not file.add(raw_of(row), place_of(row), unix_s=1000.0 + row):
            assert not file.stopped
    file.close(timeout_s=30)
    os.truncate(path, path.stat().st_size - 5)
    found = OpenLog(path)
    assert found.written_unix_s == 1001.0
    found.close()
    written(path, 3)
    os.utime(path, (2000.0, 2000.0))
    found = OpenLog(path)
    assert found.written_unix_s == 2000.0, "of an earlier version: the time of the file"
    found.close()


def test_a_file_of_another_process_or_of_nothing(tmp_path: Path) -> None:
    written(tmp_path / "log", 1)
    mine = OpenLog(tmp_path / "log")
    with pytest.raises(MapError, match="another process is writing it"):
        OpenLog(tmp_path / "log")
    mine.close()
    with pytest.raises(MapError, match="cannot open it: No such file"):
        OpenLog(tmp_path / "missing")
    (tmp_path / "other").write_bytes(b"something else")
    with pytest.raises(MapError, match="not a file of places"):
        OpenLog(tmp_path / "other")


def test_too_little_free_space_stops_the_writing(tmp_path: Path) -> None:
    file = PlaceLog(create_log(tmp_path / "log", HEADER), min_free_bytes=1e18)
    assert file.add(raw_of(0), place_of(0))
    file.close(timeout_s=30)
    assert file.stopped == "the disk is nearly full"
    found = OpenLog(tmp_path / "log")
    assert not found.places_at
    found.close()
