from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap")

from mcap.reader import make_reader
from mcap.writer import Writer

from edge.__main__ import main
from edge.camera import open_camera
from edge.config import CameraConfig
from edge.errors import FeedError
from edge.extras import install_command
from edge.feed import FeedImages, read_feed
from edge.reference_map.store import open_map


@pytest.fixture
def recorded(write_traverse: Callable[..., Path], tmp_path: Path) -> tuple[Path, Path]:
    """A feed, and the file made of it."""
    feed = write_traverse(tmp_path / "feed", range(12))
    assert main(["dev", "mcap", "write", str(feed), "-o", str(tmp_path / "feed.mcap")]) == 0
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
    assert main(["dev", "mcap", "read", str(recorded[1]), "-o", str(tmp_path / "again")]) == 0
    after = read_feed(tmp_path / "again")
    assert after.header == before.header
    assert [(row.stamp_ns, row.lat_deg, row.distance_m, row.heading_deg) for row in after.rows] == [
        (row.stamp_ns, row.lat_deg, row.distance_m, row.heading_deg) for row in before.rows
    ]
    assert np.array_equal(FeedImages(before).read(3), FeedImages(after).read(3)), "the picture files are as they were"


def test_a_file_that_was_cut_short_gives_what_it_has(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    data = recorded[1].read_bytes()
    (tmp_path / "short.mcap").write_bytes(data[: len(data) - 2000])  # without its index
    assert main(["dev", "mcap", "read", str(tmp_path / "short.mcap"), "-o", str(tmp_path / "again")]) == 0
    assert len(read_feed(tmp_path / "again").rows) == 12


def test_it_is_replayed_and_made_a_map_of_as_the_feed_itself(
    write_traverse: Callable[..., Path], recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    write_traverse(tmp_path / "street", range(30))
    assert main(["dev", "mcap", "write", str(tmp_path / "street"), "-o", str(tmp_path / "street.mcap")]) == 0
    query, query_mcap = (str(path) for path in recorded)
    assert main(["dev", "mcap", "read", query_mcap, "-o", str(tmp_path / "unpacked")]) == 0
    lines: list[bytes] = []
    for reference, replayed in (("street", query), ("street.mcap", query_mcap), ("street", tmp_path / "unpacked")):
        a_map = str(tmp_path / f"{len(lines)}.map")
        assert main(["map", "build", str(tmp_path / reference), "-o", a_map]) == 0
        output = tmp_path / f"{len(lines)}.jsonl"
        options = ["--map", a_map, "--sequence-length", "5", "--all", "-o", str(output)]
        assert main(["replay", str(replayed), *options]) == 0
        lines.append(output.read_bytes())
    assert lines[0].count(b'"direction":"forward"') >= 5
    assert lines[0] == lines[1] == lines[2]
    assert open_map(tmp_path / "0.map").header.files == open_map(tmp_path / "1.map").header.files


def test_it_plays_as_a_camera(recorded: tuple[Path, Path]) -> None:
    camera = open_camera(CameraConfig(kind="feed", device=str(recorded[1])))
    with contextlib.closing(camera):
        frame = camera.read()
    assert frame is not None
    assert np.array_equal(frame.image, FeedImages(read_feed(recorded[0])).read(0))


def test_without_the_library_it_is_said_what_to_install(
    recorded: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "mcap"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mcap", None)  # as where it is not installed
    assert main(["replay", str(recorded[1]), "--map", "a.map"]) == 78
    assert capsys.readouterr().err == f"lookback: MCAP needs the package mcap: {install_command('desk')}\n"


def test_messages_of_somebody_else_are_one_line(tmp_path: Path) -> None:
    for topic, encoding, data, told in (
        ("/camera", "json", b'{"picture": 1}', r"/camera: .*`data`"),
        ("/camera", "cdr", b"\0\1", "no feed in it; a recording of ROS 2 is read by `lookback import`"),
    ):
        with (tmp_path / "other.mcap").open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="", library="other")
            schema = writer.register_schema("schema", "jsonschema", b"{}")
            writer.add_message(writer.register_channel(topic, encoding, schema), 1, data, 1)
            writer.finish()  # type: ignore[no-untyped-call]
        with pytest.raises(FeedError, match=told):
            read_feed(tmp_path / "other.mcap")


def test_a_damaged_file_is_one_line_or_gives_what_it_has(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    whole, random, refused = recorded[1].read_bytes(), np.random.default_rng(84), 0
    lengths = [at for at in range(len(whole) - 8) if whole[at + 4 : at + 8] == bytes(4)]  # of records and of texts
    for number in range(150):
        data = bytearray(whole)
        where = lengths if number % 2 else range(len(data))
        for at in random.choice(where, 1 + number % 3):
            data[at] = random.integers(256)
        damaged = tmp_path / f"{number}.mcap"
        damaged.write_bytes(data)
        try:
            read_feed(damaged)
        except FeedError as error:
            refused += 1
            assert str(error).startswith(f"{damaged}: ") and "\n" not in str(error)
    assert refused >= 30


def test_mistakes_are_one_line(recorded: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "noise.mcap").write_bytes(b"noise" * 100)
    for arguments, told in (
        (["read", str(tmp_path / "noise.mcap")], "noise.mcap: not an MCAP file"),
        (["read", str(tmp_path / "none.mcap")], "none.mcap: cannot read it: No such file"),
        (["write", str(recorded[0])], "x.mcap: cannot write it: File exists"),
    ):
        (tmp_path / "x.mcap").touch()
        assert main(["dev", "mcap", *arguments, "-o", str(tmp_path / "x.mcap")]) == 78
        assert told in capsys.readouterr().err
