"""What `lookback import` makes of any traverse, and what it refuses."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.commands.parser import build_parser
from edge.config import SamplingConfig
from edge.errors import ConfigError, FeedError
from edge.feed import FeedImages, FeedRow, read_feed
from sim.datasets import KINDS, ReadOptions, Traverse, open_dataset
from sim.datasets.importing import choose_rows, write_feed
from sim.datasets.pictures import PictureFiles
from tests.files_written import full_disk

WritePictures = Callable[[Path, list[str]], None]
IndexOf = Callable[[NDArray[np.uint8]], int]
Import = Callable[..., int]


@pytest.fixture
def walk(tmp_path: Path, write_pictures: WritePictures) -> Path:
    write_pictures(tmp_path / "walk", [f"{i}.png" for i in range(30)])
    return tmp_path / "walk"


def traverse_of(*rows: FeedRow) -> Traverse:
    return Traverse("test", "here", rows, PictureFiles([]))


def chosen(traverse: Traverse, **sampling: object) -> list[int]:
    return [row.index for row in choose_rows(traverse, SamplingConfig(**sampling))]  # type: ignore[arg-type]


def test_frames_without_places_are_all_taken_unless_a_spacing_says_otherwise(
    walk: Path, sim_import: Import, index_of: IndexOf
) -> None:
    spacings = {"all": (), "third": ("--spacing-frames", 3), "slow": ("--interval-s", 4)}
    indices = {}
    for name, spacing in spacings.items():
        sim_import("gardens-point", walk, "-o", walk.parent / name, *spacing)
        feed = read_feed(walk.parent / name)
        indices[name] = [index_of(FeedImages(feed).read(row)) for row in range(len(feed.rows))]
    assert indices == {
        "all": list(range(30)),
        "third": list(range(0, 30, 3)),
        "slow": list(range(0, 30, 4)),
    }


def test_meters_cannot_be_asked_of_frames_without_places(walk: Path, sim_import: Import) -> None:
    for option in ("--spacing-m", "--length-m"):
        with pytest.raises(FeedError, match=r"walk: no positions or distances in it, so pictures cannot be chosen by"):
            sim_import("gardens-point", walk, "-o", walk.parent / "feed", option, 2)
    assert not (walk.parent / "feed").exists()


def test_only_the_first_meters_of_a_drive(walk: Path, sim_import: Import) -> None:
    names = sorted(file.name for file in walk.iterdir())
    lines = (f"{name},{number},{2.0 * number},0.0" for number, name in enumerate(names))
    (walk.parent / "places.csv").write_text("\n".join(["file,time,x,y", *lines]))
    positions = "--positions", walk.parent / "places.csv"
    sim_import("pictures", walk, "-o", walk.parent / "feed", "--length-m", 21, *positions)
    distances_m = [row.distance_m for row in read_feed(walk.parent / "feed").rows]
    assert distances_m == pytest.approx(list(range(0, 22, 2)), rel=1e-3)


def test_pictures_that_go_back_in_time_are_left_out(caplog: pytest.LogCaptureFixture) -> None:
    rows = [FeedRow(f"{i}.png", stamp_ns) for i, stamp_ns in enumerate([5, 7, 7, 6, 9])]
    assert chosen(traverse_of(*rows), by="frames") == [0, 1, 4]
    assert "here: 2 of 5 pictures are not later than the one before; skipped" in caplog.text


def test_the_distance_driven_is_kept_as_it_was_between_the_chosen_rows() -> None:
    # Two meters east and two back a frame: a car that turns drives further than its places are apart.
    rows = [FeedRow(f"{i}.png", i, lat_deg=0.0, lon_deg=2e-5 * (i % 2)) for i in range(9)]
    taken = choose_rows(traverse_of(*rows), SamplingConfig(by="distance", spacing_m=4.4))
    assert [row.index for row in taken] == [0, 2, 4, 6, 8]
    assert [row.distance_m for row in taken] == pytest.approx(4.4528 * np.arange(5), rel=1e-3)


def test_a_position_that_is_not_on_the_earth_is_named_and_leaves_nothing(walk: Path, tmp_path: Path) -> None:
    rows = tuple(FeedRow(f"{at}.png", at, lat_deg=95.0 if at == 2 else 10.0, lon_deg=20.0) for at in range(4))
    traverse = Traverse("test", "here", rows, PictureFiles([walk / row.file for row in rows]))
    taken = choose_rows(traverse, SamplingConfig(by="frames"))
    with pytest.raises(FeedError, match=r"here: 2\.png: lat_deg: 95 is not between -90 and 90 degrees"):
        write_feed(traverse, tmp_path / "feed", taken)
    assert not (tmp_path / "feed").exists()


def test_pictures_are_made_smaller(walk: Path, sim_import: Import) -> None:
    sim_import("gardens-point", walk, "-o", walk.parent / "feed", "--width", 20)
    feed = read_feed(walk.parent / "feed")
    assert FeedImages(feed).read(29).shape == (15, 20, 3)


def test_a_picture_of_another_size_is_named(walk: Path, sim_import: Import) -> None:
    import cv2

    cv2.imwrite(str(walk / "7.png"), np.zeros((64, 48, 3), np.uint8))
    with pytest.raises(FeedError, match=r"walk: 7\.png: 48 x 64, and the first has 64 x 48 pixels"):
        sim_import("gardens-point", walk, "-o", walk.parent / "feed")
    assert [path.name for path in walk.parent.iterdir()] == ["walk"]


def test_the_field_of_view_is_asked_for_or_kept(
    walk: Path, sim_import: Import, capsys: pytest.CaptureFixture[str]
) -> None:
    sim_import("gardens-point", walk, "-o", walk.parent / "unknown")
    assert "field of view not known, and taken as 75 ± 10 degrees by keypoints; --fov-deg DEG says it (a phone 65," in (
        capsys.readouterr().out
    )
    assert read_feed(walk.parent / "unknown").header.fov_deg is None
    sim_import("gardens-point", walk, "-o", walk.parent / "known", "--fov-deg", "65")
    assert "field of view 65.0 degrees\n" in capsys.readouterr().out
    assert read_feed(walk.parent / "known").header.fov_deg == 65.0


def test_what_is_there_already_is_not_touched(walk: Path, sim_import: Import) -> None:
    (walk.parent / "feed").mkdir()
    with pytest.raises(FeedError, match=r"feed: exists already; name another folder"):
        sim_import("gardens-point", walk, "-o", walk.parent / "feed")
    assert not list((walk.parent / "feed").iterdir())


def test_a_place_that_cannot_be_written_to_and_a_full_disk_are_one_line_and_leave_nothing(walk: Path) -> None:
    traverse = open_dataset("gardens-point", walk)
    rows = choose_rows(traverse, SamplingConfig(by="frames"))
    (walk.parent / "file").write_text("")
    with pytest.raises(FeedError, match=r"file/feed: cannot write a feed here: File exists"):
        write_feed(traverse, walk.parent / "file/feed", rows)
    with full_disk(300), pytest.raises(FeedError, match=r"full: cannot write a feed here: File too large"):
        write_feed(traverse, walk.parent / "full", rows)
    assert sorted(path.name for path in walk.parent.iterdir()) == ["file", "walk"]


def test_if_no_picture_can_be_read_there_is_no_feed(walk: Path, sim_import: Import) -> None:
    for picture in walk.iterdir():
        picture.write_bytes(b"")
    with pytest.raises(FeedError, match=r"walk: no picture in it can be used"):
        sim_import("gardens-point", walk, "-o", walk.parent / "feed", "--skip-unreadable")
    assert not (walk.parent / "feed").exists()


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--width", "0", "--width: 0 is not above 0"),
        ("--fps", "nan", "--fps: nan is not above 0"),
        ("--length-m", "-3", "--length-m: -3 is not above 0"),
        ("--crop-bottom", "-1", "--crop-bottom: -1 is not 0 or more"),
        ("--offset-s", "inf", "--offset-s: inf is not a number of seconds"),
        ("--spacing-m", "0", "--spacing-m: "),
        ("--fov-deg", "170", "--fov-deg: expected `float` <= 120"),
    ],
)
def test_an_option_out_of_range_is_named(walk: Path, sim_import: Import, option: str, value: str, message: str) -> None:
    with pytest.raises(ConfigError, match=f"^{message}"):
        sim_import("gardens-point", walk, "-o", walk.parent / "feed", f"{option}={value}")


def test_an_unknown_kind_and_an_option_that_means_nothing_are_named(walk: Path) -> None:
    with pytest.raises(FeedError, match="pittsburgh: no such kind of data set; it is one of comma2k19, fred"):
        open_dataset("pittsburgh", walk)
    with pytest.raises(FeedError, match=r"^--crop-bottom: is no option of nordland$"):
        open_dataset("nordland", walk, ReadOptions(crop_bottom=3))


def test_a_package_that_is_not_installed_is_named(walk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    monkeypatch.delitem(sys.modules, "sim.datasets.rosbag", raising=False)
    with pytest.raises(FeedError, match=r"^rosbag: needs the package rosbags: .* pip install .*\[import\]'$"):
        open_dataset("rosbag", walk)


def test_every_kind_has_a_reader_and_takes_options_that_there_are() -> None:
    options = {option.name for option in fields(ReadOptions)}
    for kind in KINDS.values():
        assert callable(import_module(kind.module).open_traverse)
        assert kind.options <= options
    assert set.union(*(set(kind.options) for kind in KINDS.values())) == options


def test_the_command_lists_every_kind(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["import", "--help"]
    with pytest.raises(SystemExit):
        build_parser(words).parse_args(words)
    said = capsys.readouterr().out
    for name, kind in KINDS.items():
        assert name in said
        assert kind.what in said
