"""The file of a drive's places: whole after a crash at any byte, and never in the way of anything else."""

from __future__ import annotations

import os
import random
import shutil
import sqlite3
import zlib
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from edge.config import SamplingConfig
from edge.errors import MapError
from edge.reference_map import ModelKey, RegionsKey
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.place_log import OpenLog, PlaceLog, create_log, files_of
from edge_plugins.mapping.place_log_records import LogHeader

HEADER = LogHeader(ModelKey("test", "0" * 64, "fc6", 512), RegionsKey("left-right", 0.4), SamplingConfig(), "test")
PICTURE = random.Random(0).randbytes(6000)


def raw_of(row: int) -> np.ndarray:
    return np.arange(1024, dtype=np.float32).reshape(2, 512) + row


def place_of(row: int) -> Place:
    return Place(row, 47.0, 8.0, 400.0, 90.0, 2.0 * row, PICTURE + b"%d" % row, 1.5, "gps")


def add(file: PlaceLog, rows: range) -> None:
    for row in rows:
        while not file.add(raw_of(row), place_of(row), 1000.0 + row):
            assert not file.stopped


def written(path: Path, places: int) -> None:
    """A file of a drive of so many places."""
    file = PlaceLog(create_log(path, HEADER))
    assert file.begin_drive("rear")
    add(file, range(places))
    file.close(timeout_s=30)


def kept_in(path: Path) -> list[int]:
    """Which places are read from it; each is as it was handed over."""
    with closing(OpenLog(path)) as found:
        places = [found.place(row) for row in range(len(found.rows))]
        for passed in places:
            assert passed.place == place_of(passed.place.row)
            np.testing.assert_array_equal(found.raw_of(passed), raw_of(passed.place.row))
        assert {view for _, view in found.drives} <= {"rear"}
        lost = [row for row in range(1, len(places)) if found.rows[row] > found.rows[row - 1] + 1]
        assert [first for first, _ in found.drives] == [0, *lost][: len(found.drives)], "no line runs over what is lost"
        return [passed.place.row for passed in places]


def test_raw_rows_are_there_before_and_after_they_are_written(tmp_path: Path) -> None:
    file = PlaceLog(create_log(tmp_path / "log", HEADER))
    for row in range(200):
        add(file, range(row, row + 1))
        rows = sorted({row, max(0, row - 40), row // 2})
        if row >= 150 or rows[0] > row - 60:
            np.testing.assert_array_equal(file.raw_rows(rows), np.stack([raw_of(one) for one in rows]))
    file.close(timeout_s=30)


def test_what_was_flushed_is_in_the_file_itself_and_what_followed_is_there_up_to_the_byte_of_a_cut(
    tmp_path: Path,
) -> None:
    """A power cut leaves SQLite's log at any length."""
    path, cut = tmp_path / "log", tmp_path / "cut"
    file = PlaceLog(create_log(path, HEADER))
    file.begin_drive("rear")
    add(file, range(5))
    wal = files_of(path)[0]
    while file.waiting or wal.stat().st_size:
        os.sched_yield()
    shutil.copy(path, cut)
    assert kept_in(cut) == [*range(5)]
    with closing(sqlite3.connect(path)) as holds:  # so that nothing more is flushed
        holds.execute("BEGIN")
        holds.execute("SELECT * FROM places").fetchone()
        add(file, range(5, 9))
        while file.waiting:
            os.sched_yield()
        whole = wal.read_bytes()
        shutil.copy(path, cut)
    file.close(timeout_s=30)
    counts = []
    for length in (*range(0, len(whole), 509), len(whole)):
        for one in files_of(cut)[:2]:
            one.unlink(missing_ok=True)
        shutil.copy(path, tmp_path / "all")
        files_of(cut)[0].write_bytes(whole[:length])
        counts.append(kept_in(cut))
        assert counts[-1] == [*range(len(counts[-1]))]
    sizes = [len(one) for one in counts]
    assert sizes == sorted(sizes) and sizes[0] == 5 and sizes[-1] == 9 and set(sizes) == {5, 6, 7, 8, 9}


def test_a_flipped_bit_costs_its_place_and_not_the_file(tmp_path: Path) -> None:
    path, places = tmp_path / "log", 40
    written(path, places)
    whole, rng = path.read_bytes(), random.Random(1)
    lost, refused = [], 0
    for start in range(4096, len(whole), 512):
        at = start + rng.randrange(512)
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << rng.randrange(8)]) + whole[at + 1 :])
        try:
            lost.append(places - len(kept_in(path)))
        except MapError:
            refused += 1
    assert refused < 0.01 * len(lost), "only of the header, and of the page that finds all others"
    assert np.mean(np.array(lost) <= 1) > 0.99 and np.mean(np.array(lost) == 1) > 0.8


@pytest.mark.parametrize("at", [3, 4096 - 30])
def test_a_file_whose_head_is_damaged_is_refused_and_left_as_it_is(tmp_path: Path, at: int) -> None:
    path = tmp_path / "log"
    written(path, 3)
    whole = path.read_bytes()
    damaged = whole[:at] + b"\xff" + whole[at + 1 :]
    path.write_bytes(damaged)
    with pytest.raises(MapError, match=r"log: cannot open it: damaged, or not a file of places; remove it$"):
        OpenLog(path)
    assert path.read_bytes() == damaged


def damage(path: Path, table: str, row: int) -> None:
    """Change a byte of a place, or of its keypoints, as a disk does."""
    with closing(sqlite3.connect(path)) as db, db:
        ((record,),) = db.execute(f"SELECT record FROM {table} WHERE row = ?", (row + 1,))
        record = record[:40] + bytes([record[40] ^ 1]) + record[41:]
        db.execute(f"UPDATE {table} SET record = ? WHERE row = ?", (record, row + 1))


def test_places_after_a_damaged_byte_stay_and_are_appended_to(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "log"
    written(path, 400)
    damage(path, "places", 10)
    file = PlaceLog(OpenLog(path))
    assert file.count == 399
    assert "1 damaged places were skipped, 399 kept" in caplog.text
    assert file.add(raw_of(400), place_of(400), 2000.0)
    file.close(timeout_s=30)
    assert kept_in(path) == [*range(10), *range(11, 401)]


def test_the_time_of_the_last_place_is_in_the_file(tmp_path: Path) -> None:
    """Neither damage nor a copy makes a drive of ten days ago the drive of today."""
    written(tmp_path / "log", 3)
    for row, newest_s in ((3, 1002.0), (2, 1001.0)):
        damage(tmp_path / "log", "places", row) if row < 3 else None
        with closing(OpenLog(tmp_path / "log")) as found:
            assert found.newest is not None and found.newest.unix_s == newest_s


def test_a_file_of_an_earlier_version_or_of_nothing(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="cannot open it: No such file"):
        OpenLog(tmp_path / "missing")
    (tmp_path / "other").write_bytes(b"something else")
    with pytest.raises(MapError, match="not a file of places; remove it"):
        OpenLog(tmp_path / "other")
    (tmp_path / "older").write_bytes(b"LBPL" + bytes(8) + b"\x82")
    with pytest.raises(MapError, match="an earlier version began this drive: start that version once, or remove it"):
        OpenLog(tmp_path / "older")
    assert (tmp_path / "older").read_bytes()[:4] == b"LBPL"


def test_a_record_that_lies_in_the_row_of_another_is_damaged(tmp_path: Path) -> None:
    written(tmp_path / "log", 3)
    with closing(sqlite3.connect(tmp_path / "log")) as db, db:
        ((crc, record),) = db.execute("SELECT crc, record FROM places WHERE row = 1")
        assert crc == zlib.crc32(record, 1)
        db.execute("UPDATE places SET crc = ?, record = ? WHERE row = 2", (crc, record))
    assert kept_in(tmp_path / "log") == [0, 2]


def test_too_little_free_space_stops_the_writing(tmp_path: Path) -> None:
    file = PlaceLog(create_log(tmp_path / "log", HEADER), min_free_bytes=1e18)
    assert file.add(raw_of(0), place_of(0), 1000.0)
    file.close(timeout_s=30)
    assert file.stopped == "the disk is nearly full"
    assert kept_in(tmp_path / "log") == []
