from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("panda3d")

from edge.commands.parser import build_parser
from edge.errors import ConfigError, FeedError
from edge.feed import FeedImages, read_feed
from edge.geodesy import east_north_of
from sim import ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG
from sim.world.recording import record_drive, times_by_distance
from sim.world.scenario import Scenario

HOME = Scenario(seed=3, length_m=200.0, direction="reverse", light="dusk", view="rear", width=64, height=48)


def run(argv: list[str]) -> int:
    args = build_parser(argv).parse_args(argv)
    return int(args.run(args))


def test_a_feed_has_the_truth_of_every_frame(tmp_path: Path) -> None:
    drive = HOME.drive()
    times_s = times_by_distance(drive, 10.0)
    assert record_drive(HOME, tmp_path / "home", spacing_m=10.0) == 20
    feed = read_feed(tmp_path / "home")
    assert (feed.header.view, feed.header.width, feed.header.height) == ("rear", 64, 48)
    assert [row.distance_m for row in feed.rows] == pytest.approx(np.arange(0, 200, 10).tolist(), abs=1e-6)
    for row, time_s in zip(feed.rows, times_s, strict=True):
        pose = drive.pose(time_s)
        assert float(row.extra["route_m"]) == pytest.approx(200 - row.distance_m, abs=1e-3)  # type: ignore[operator]
        assert row.lat_deg is not None and row.lon_deg is not None
        there_m = east_north_of(row.lat_deg, row.lon_deg, (ORIGIN_LAT_DEG, ORIGIN_LON_DEG), ORIGIN_ALT_M)
        assert there_m == pytest.approx((pose.east_m, pose.north_m), abs=0.01)
        assert row.heading_deg == pose.heading_deg
    assert FeedImages(feed).read(5).shape == (48, 64, 3)


def test_the_same_scenario_is_the_same_bytes(tmp_path: Path) -> None:
    folders = [tmp_path / "a" / "drive", tmp_path / "b" / "drive"]
    for folder in folders:
        record_drive(HOME, folder, spacing_m=50.0)
    files = [sorted(path.relative_to(folder) for path in folder.rglob("*.*")) for folder in folders]
    assert files[0] == files[1]
    assert len(files[0]) == 6
    assert all((folders[0] / name).read_bytes() == (folders[1] / name).read_bytes() for name in files[0])


def test_an_interrupted_drive_goes_on_where_it_was(tmp_path: Path) -> None:
    def interrupted(times_s: list[float]) -> Iterator[float]:
        yield from times_s[:2]
        raise KeyboardInterrupt

    begun, whole = tmp_path / "begun" / "drive", tmp_path / "whole" / "drive"
    with pytest.raises(KeyboardInterrupt):
        record_drive(HOME, begun, spacing_m=50.0, progress=interrupted)
    with (begun / "frames.csv").open("ab") as file:
        file.write(b"frames/000002.jpg,12")  # a crash tore it
    with pytest.raises(FeedError, match="a feed already exists"):
        record_drive(HOME, begun, spacing_m=40.0)
    rest = list[int]()

    def counted(times_s: list[float]) -> list[float]:
        rest.append(len(times_s))
        return times_s

    record_drive(HOME, begun, spacing_m=50.0, progress=counted)
    record_drive(HOME, whole, spacing_m=50.0)
    assert rest == [2]
    names = [path.relative_to(whole) for path in whole.rglob("*.*")]
    assert all((begun / name).read_bytes() == (whole / name).read_bytes() for name in names)
    with pytest.raises(FeedError, match="a feed already exists"):
        record_drive(HOME, begun, spacing_m=50.0)


@pytest.mark.parametrize("has_header", [True, False])
def test_a_drive_that_was_interrupted_before_its_first_frame_begins_anew(tmp_path: Path, has_header: bool) -> None:
    """As where the renderer is not installed: what is named then must work after it is."""

    def interrupted(times_s: list[float]) -> list[float]:
        raise KeyboardInterrupt

    path = tmp_path / "drive"
    with pytest.raises(KeyboardInterrupt):
        record_drive(HOME, path, spacing_m=50.0, progress=interrupted)
    if not has_header:
        (path / "frames.csv").write_bytes(b"")
    assert record_drive(HOME, path, spacing_m=50.0) == len(read_feed(path).rows) == 4


def test_the_command_writes_a_feed_and_refuses_a_folder_that_has_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "drive.toml"
    scenario.write_text("length_m = 200.0\nwidth = 64\nheight = 48\n")
    command = ["dev", "sim", "drive", str(scenario), "-o", str(tmp_path / "feed"), "--spacing-m", "40"]
    assert run(command) == 0
    assert len(read_feed(tmp_path / "feed").rows) == 5
    assert capsys.readouterr().err.endswith("feed: 5 frames over 200 m\n")
    with pytest.raises(FeedError, match="a feed already exists here"):
        run(command)
    with pytest.raises(ConfigError, match="--spacing-m: 0 is not above 0"):
        run([*command[:-1], "0"])
