"""A drive is a list of events, which the daemon writes; that a bare estimator answers it alike is in tests/golden."""

from __future__ import annotations

import dataclasses
import gzip
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from edge.config import Config
from edge.errors import FeedError
from edge.localization.drive_file import LENGTH, DriveFile, read_drive, replay
from edge.localization.events import ImageProcessed
from edge.sequence import KeyframeMatch, PlaceMatch
from tests.golden.harness import cases

CASE = cases("run")[0]


@pytest.fixture
def path(golden_run: Callable[[Path], Path]) -> Path:
    """The list of one drive."""
    return golden_run(CASE) / "list.drive"


def test_another_configuration_gives_other_answers(path: Path) -> None:
    """What the goldens' test compares can differ."""
    config, entries = read_drive(path)
    strict = replace(config, gates=replace(config.gates, risk=1e-12))
    assert any(now != asked.answer for _, asked, now in replay(strict, entries))


def test_the_list_of_a_computer_that_lost_its_power_ends_with_its_last_whole_entry(path: Path, tmp_path: Path) -> None:
    cut, data = tmp_path / "cut.drive", path.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    _, entries = read_drive(path)
    _, read = read_drive(cut)
    assert len(entries) // 4 < len(read) < len(entries)
    assert [t_ns for t_ns, _ in read] == [t_ns for t_ns, _ in entries[: len(read)]]


def test_a_list_with_keys_of_an_earlier_version_is_read(path: Path, tmp_path: Path) -> None:
    data = gzip.decompress(path.read_bytes())
    (size,) = LENGTH.unpack(data[: LENGTH.size])
    end = LENGTH.size + size
    header = msgspec.msgpack.decode(data[LENGTH.size : end])
    header["sequence"]["slopes"] = 21
    earlier = msgspec.msgpack.encode(header)
    (tmp_path / "list.drive").write_bytes(gzip.compress(LENGTH.pack(len(earlier)) + earlier + data[end:]))
    (config, entries), (expected, others) = read_drive(tmp_path / "list.drive"), read_drive(path)
    assert config == expected
    assert [t_ns for t_ns, _ in entries] == [t_ns for t_ns, _ in others]


@pytest.mark.parametrize("data", [b"", b"drive", b"\x1f\x8b\x08\x00"], ids=["empty", "text", "cut off"])
def test_what_is_no_list_of_a_drive_is_rejected_with_its_name(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "list.drive"
    path.write_bytes(data)
    with pytest.raises(FeedError, match=r"list\.drive"):
        read_drive(path)


def test_the_list_of_a_drive_keeps_what_keypoints_saw(tmp_path: Path) -> None:
    seen = KeyframeMatch(3, 0.5, -1.0, 0.01, np.diag([0.1, 0.2, 0.01]), 60, 0.9)
    alone = PlaceMatch(3, 3, "forward", "same", 0.0, 0.0, 1.0, seen=seen, has_line=False)
    frames = [ImageProcessed(1), ImageProcessed(2, alone), ImageProcessed(3, dataclasses.replace(alone, seen=None))]
    with closing(DriveFile(tmp_path / "list.drive", Config())) as file:
        for frame in frames:
            file.write(frame.stamp_ns, frame)
    assert [entry for _, entry in read_drive(tmp_path / "list.drive")[1]] == frames
    assert seen != dataclasses.replace(seen, covariance=np.eye(3))
