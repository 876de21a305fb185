from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap")

from mcap.reader import make_reader

from edge.__main__ import main
from edge.camera.feed import FeedImages, read_feed


@pytest.fixture
def recorded(write_traverse: Callable[..., Path], tmp_path: Path) -> tuple[Path, Path]:
    """A feed, and the file made of it."""
    feed = write_traverse(tmp_path / "feed", range(12))
    assert main(["mcap", "write", str(feed), "-o", str(tmp_path / "feed.mcap")]) == 0
    return feed, tmp_path / "feed.mcap"


def test_other_programs_find_pictures_and_positions(recorded: tuple[Path, Path]) -> None:
    with recorded[1].open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        names = {summary.schemas[one.schema_id].name: one.topic for one in summary.channels.values()}
        assert names["foxglove.CompressedImage"] == "/camera"
        assert names["foxglove.LocationFix"] == "/position"
        assert len(list(reader.iter_messages("/camera"))) == 12


def test_there_and_back(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    before = read_feed(recorded[0])
    assert main(["mcap", "read", str(recorded[1]), "-o", str(tmp_path / "again")]) == 0
    after = read_feed(tmp_path / "again")
    assert after.header == before.header
    assert [(row.stamp_ns, row.lat_deg, row.distance_m, row.heading_deg) for row in after.rows] == [
        (row.stamp_ns, row.lat_deg, row.distance_m, row.heading_deg) for row in before.rows
    ]
    difference = FeedImages(before).read(3).astype(int) - FeedImages(after).read(3)
    assert np.abs(difference).mean() < 6  # a JPEG of a JPEG


def test_a_file_that_was_cut_short_gives_what_it_has(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    data = recorded[1].read_bytes()
    (tmp_path / "short.mcap").write_bytes(data[: len(data) - 2000])  # without its index
    assert main(["mcap", "read", str(tmp_path / "short.mcap"), "-o", str(tmp_path / "again")]) == 0
    assert len(read_feed(tmp_path / "again").rows) == 12


def test_mistakes_are_one_line(recorded: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "noise.mcap").write_bytes(b"noise" * 100)
    for arguments, told in (
        (["read", str(tmp_path / "noise.mcap")], "noise.mcap: not an MCAP file"),
        (["read", str(tmp_path / "none.mcap")], "none.mcap: cannot read it: No such file"),
        (["write", str(recorded[0])], "x.mcap: cannot write it: File exists"),
    ):
        (tmp_path / "x.mcap").touch()
        assert main(["mcap", *arguments, "-o", str(tmp_path / "x.mcap")]) == 78
        assert told in capsys.readouterr().err
