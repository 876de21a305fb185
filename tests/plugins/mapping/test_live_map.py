"""The map of this drive: what enters it, what of it is searched, and what the next start makes of it."""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.__main__ import main
from edge.config import SamplingConfig
from edge.errors import ConfigError
from edge.geodesy import VehiclePosition
from edge.reference_map import MapSet, ModelKey, RegionsKey, open_map, open_map_set
from edge.reference_map.map_folder import KEEP, RETIRED
from edge_plugins.home import HomeConfig
from edge_plugins.home.route import plan_route
from edge_plugins.layers.stored import delete_oldest, stored_maps
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.builder import MapBuilder, Place
from edge_plugins.mapping.drive_store import DriveStore
from edge_plugins.mapping.gps_consistency import GpsFreeDistance
from edge_plugins.mapping.live_map import LiveMap
from edge_plugins.mapping.place_log import OpenLog, logs_in
from edge_plugins.mapping.place_log_records import LogHeader
from tests.files_written import full_disk
from tests.plugins.mapping.test_place_log import damage

MODEL, REGIONS = ModelKey("test", "0" * 64, "fc6", 32), RegionsKey("left-right", 0.4)
HEADER = LogHeader(MODEL, REGIONS, SamplingConfig())
IMAGE = np.full((48, 64, 3), 120, np.uint8)
GPS = VehiclePosition(0, 47.0, 8.0, 400.0, 0.0, 10.0, 10.0, 0.0, sigma_m=1.5, source="rtk_fixed")
START_S = 1_790_000_000.0


def raw_of(row: int) -> NDArray[np.float32]:
    return np.maximum(np.random.default_rng(row).normal(size=(2, 32)), 0).astype(np.float32)


def live(folder: Path, unix_s: float = START_S, **changes: object) -> LiveMap:
    config = MappingConfig(folder=str(folder), min_free_mb=0.0, behind_m=50.0)
    for key, value in changes.items():
        config = type(config)(**{**{name: getattr(config, name) for name in config.__struct_fields__}, key: value})
    return LiveMap(config, DriveStore(config, HEADER, "rear", lambda: unix_s))


def drive(mapped: LiveMap, rows: range, position: VehiclePosition | None = GPS) -> None:
    """Places every 2 m, each moved on by its row and counted by the wheels, no faster than the disk takes them."""
    for row in rows:
        at = None if position is None else replace(position, lat_deg=position.lat_deg + row * 2 / 110_800)
        mapped.own.compare(GpsFreeDistance(0, row * 2.0, 0), at)
        mapped.add(raw_of(row), IMAGE, at, row * 2.0)
        while mapped.store.waiting > 8 and not mapped.status.why:
            os.sched_yield()


def test_places_become_searchable_a_fixed_distance_behind(tmp_path: Path) -> None:
    mapped = live(tmp_path)
    drive(mapped, range(40))
    assert mapped.status.state == "mapping"
    assert mapped.newly_searchable(78.0) is None, "only 15 are 50 m behind"
    so_far = mapped.newly_searchable(82.0)
    assert so_far is not None
    assert so_far.header.places == 17
    assert mapped.newly_searchable(90.0) is None
    assert so_far.places["position_sigma_m"].tolist() == [1.5] * 17
    mapped.store.close()


@pytest.mark.parametrize(
    ("position", "keys", "why"),
    [
        (None, {}, "autopilot has no position"),
        (replace(GPS, source="dead_reckoning"), {}, "no GPS"),
        (replace(GPS, source="dead_reckoning", sigma_m=None), {"without_gps": "continue"}, "position error not known"),
        (replace(GPS, source="dead_reckoning", sigma_m=40.0), {"without_gps": "continue"}, ""),
        (replace(GPS, source="place_fixes"), {"without_gps": "continue"}, "position is by places"),
        (replace(GPS, source="unknown"), {"without_gps": "continue"}, "no GPS"),
        (replace(GPS, sigma_m=8.0), {}, "not known to 5 m"),
        (replace(GPS, sigma_m=None), {}, "not known to 5 m"),
    ],
)
def test_what_is_no_truth_enters_no_map(
    tmp_path: Path, position: VehiclePosition | None, keys: dict[str, Any], why: str
) -> None:
    mapped = live(tmp_path, **keys)
    mapped.add(raw_of(0), IMAGE, position, 0.0)
    assert mapped.status.places == (not why)
    assert why in mapped.status.why
    assert len(f"Lookback not mapping: {mapped.status.why}") <= 50, "one line of the pilot's"
    mapped.store.close()
    assert bool(logs_in(tmp_path)) == (not why), "no file without a place"


def test_gps_that_is_spoofed_ends_mapping(tmp_path: Path) -> None:
    """By 2 m/s at 8 m/s to 100 m; also once it stays there, until the odometer begins again."""
    mapped = live(tmp_path)
    states = []
    for row in range(500):
        off_m = min(100.0, max(0.0, (row - 150) * 2.0 / 8.0 * 2.0))
        at = replace(GPS, lat_deg=GPS.lat_deg + row * 2 / 110_800, lon_deg=GPS.lon_deg + off_m / 75_600)
        mapped.add(raw_of(row), IMAGE, at, row * 2.0)
        states.append(mapped.status.state)
        while mapped.store.waiting > 8 and not mapped.status.why:
            os.sched_yield()
    first = states.index("waiting")
    assert 150 < first < 200
    assert states[first + 20 :] == ["waiting"] * (480 - first)
    assert mapped.status.why == "GPS moves otherwise than the vehicle"
    mapped.interrupt()
    mapped.add(raw_of(500), IMAGE, at, 1000.0)
    assert mapped.status.state == "mapping"
    mapped.store.close()


def test_places_without_a_frame_get_the_nearest_one(tmp_path: Path) -> None:
    mapped = live(tmp_path)
    for row, missed in ((0, 0), (1, 0), (5, 3), (6, 0), (48, 41), (49, 0)):
        at = replace(GPS, lat_deg=GPS.lat_deg + row * 1e-5, lon_deg=180.0 - 2e-5 + row * 1e-5)
        at = replace(at, lon_deg=at.lon_deg - 360.0) if at.lon_deg >= 180.0 else at
        mapped.add(raw_of(row), IMAGE, at, row * 2.0, missed=missed)
    whole = mapped.store.whole()
    assert whole.places["route_m"].tolist() == [*np.arange(7) * 2.0, 96.0, 98.0]
    assert whole.places["lat_deg"] == pytest.approx(47.0 + whole.places["route_m"] / 2 * 1e-5)
    east_deg = (whole.places["lon_deg"] - 180.0 + 2e-5 + 180.0) % 360.0 - 180.0
    assert east_deg == pytest.approx(whole.places["route_m"] / 2 * 1e-5, abs=1e-9)
    assert [(segment.start, segment.end) for segment in whole.header.segments] == [(0, 7), (7, 9)]
    mapped.store.close()
    (log,) = logs_in(tmp_path)
    file = OpenLog(log)
    seen = [file.raw_of(file.place(row)).tolist() for row in range(7)]
    file.close()
    assert [row for row in range(7) if seen[row] == seen[1]] == [1, 2, 3]
    assert [row for row in range(7) if seen[row] == seen[5]] == [4, 5]


def test_places_arrive_later_than_the_odometer(tmp_path: Path) -> None:
    """The position of a frame is known some time after its exposure; what is searched is decided by now."""
    mapped = live(tmp_path)
    for row in range(60):
        assert (mapped.newly_searchable(row * 2.0 + 6.5) is None) or row > 20
        drive(mapped, range(row, row + 1))
    assert len(mapped.searched.so_far().header.segments) == 1
    mapped.store.close()


def test_a_gap_begins_another_drive_and_the_odometer_may_start_again(tmp_path: Path) -> None:
    mapped = live(tmp_path)
    drive(mapped, range(10))
    drive(mapped, range(10, 15), replace(GPS, source="dead_reckoning", sigma_m=None))
    drive(mapped, range(15, 20))
    drive(mapped, range(70, 75))
    drive(mapped, range(5))  # the odometer began again
    mapped.newly_searchable(1000.0)
    header = mapped.searched.so_far().header
    assert [(one.start, one.end) for one in header.segments] == [(0, 20), (20, 25), (25, 30)]
    assert (np.diff(mapped.searched.so_far().places["route_m"]) >= 0).all()
    mapped.store.close()


def test_a_restart_on_the_way_goes_on_with_the_same_map(tmp_path: Path) -> None:
    first = live(tmp_path)
    drive(first, range(60))
    first.store.close()
    (file,) = logs_in(tmp_path)
    damage(file, "places", 59)
    again = live(tmp_path, START_S + 600)
    assert again.status.places == again.searched.count == 59
    drive(again, range(30))
    assert again.status.name == first.status.name
    assert again.status.places == 89
    again.store.close()
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]


@pytest.mark.parametrize(
    ("places", "turned_deg", "goes_on", "is_checked"),
    [(0, 0.0, True, True), (20, 10.0, True, False), (39, 0.0, True, False), (45, 0.0, False, True),
     (20, 40.0, False, True)],
    ids=["it stood", "straight", "long", "too long", "turned"],
)  # fmt: skip
def test_a_drive_goes_on_after_a_restart_where_the_vehicle_went_straight(
    tmp_path: Path, places: int, turned_deg: float, goes_on: bool, is_checked: bool
) -> None:
    """Nobody measured that way, so that the drive does not count as one that moved as its odometer said."""
    first = live(tmp_path)
    drive(first, range(60))
    first.store.close()
    again = live(tmp_path, START_S + 600)
    there = GPS.lat_deg + (59 + places) * 2 / 110_800
    drive(again, range(30), replace(GPS, lat_deg=there, heading_deg=turned_deg))
    header, found = again.store.whole().header, again.store.whole().places
    again.store.close()
    assert [one.start for one in header.segments] == ([0] if goes_on else [0, 60])
    assert header.segments[0].moved_as_driven == is_checked
    if goes_on:
        assert header.places == 60 + max(0, places - 1) + 30
        moved_m = (found["lat_deg"] - GPS.lat_deg) * 110_800
        np.testing.assert_allclose(found["route_m"], moved_m, atol=1.0)


def test_how_far_the_vehicle_drove_is_known_from_a_place_on(tmp_path: Path) -> None:
    """Not after a restart of this computer or of the odometer, since nobody knows how far it drove meanwhile."""
    mapped = live(tmp_path)
    assert mapped.driven_m(5.0) is None
    drive(mapped, range(40))
    assert mapped.driven_m(131.0) == 131.0, "GPS was lost at 78 m"
    assert mapped.driven_m(None) is None
    assert mapped.driven_m(3.0) is None, "the odometer began again"
    drive(mapped, range(2, 12))
    assert mapped.driven_m(40.0) == 131.0 + 40.0 - 3.0
    mapped.store.close()
    mapped = live(tmp_path, unix_s=START_S + 60)
    assert mapped.driven_m(4.0) is None
    mapped.store.close()


def test_the_way_home_begins_where_the_vehicle_is(tmp_path: Path) -> None:
    """Not where the map begins to be searched; and over a gap in the map it is one drive."""
    mapped = live(tmp_path)
    drive(mapped, range(30))
    drive(mapped, range(36, 60))
    assert mapped.newly_searchable(118.0) is not None
    maps = MapSet.of([mapped.searched.so_far()], tmp_path).with_newest(mapped.store.whole())
    positions_deg = plan_route(maps, None, HomeConfig()).positions_deg
    assert positions_deg[0] == pytest.approx((47.0 + 59 * 2 / 110_800, 8.0), abs=1e-8)
    assert positions_deg[-1] == pytest.approx((47.0, 8.0), abs=1e-8)
    mapped.store.close()


def test_the_next_start_makes_a_map_as_map_build_would(tmp_path: Path) -> None:
    first = live(tmp_path / "maps")
    drive(first, range(60))
    first.store.close()
    assert len(logs_in(tmp_path / "maps")) == 1
    live(tmp_path / "maps", START_S + 3600).store.close()
    assert not logs_in(tmp_path / "maps")
    made = open_map(tmp_path / "maps" / first.status.name, every_file=True)
    with MapBuilder(tmp_path / "built", MODEL, REGIONS, SamplingConfig()) as builder:
        builder.begin_segment(made.header.segments[0].source, "rear")
        for row in range(60):
            values = {name: made.places[name][row].item() for name in ("lat_deg", "lon_deg", "alt_m", "heading_deg")}
            picture = made.thumbnail(row)
            builder.add(
                raw_of(row),
                Place(row, **values, route_m=2.0 * row, thumbnail=picture, position_sigma_m=1.5,
                      position_source="rtk_fixed"),
            )  # fmt: skip
        builder.finish()
    assert open_map(tmp_path / "built").header.files == made.header.files
    assert made.header.segments[0].moved_as_driven


def test_a_start_that_takes_long_says_so_before(tmp_path: Path) -> None:
    first = live(tmp_path)
    drive(first, range(60))
    first.store.close()
    told: list[float] = []
    config = MappingConfig(folder=str(tmp_path), resume_min=0.0)
    DriveStore(config, HEADER, "rear", before_long=told.append).close()
    assert told == [pytest.approx(0.6)]


def test_too_short_a_drive_leaves_nothing(tmp_path: Path) -> None:
    first = live(tmp_path)
    drive(first, range(5))
    first.store.close()
    live(tmp_path, START_S, resume_min=0.0).store.close()
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_stops_mapping_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    mapped = live(tmp_path / "file" / "maps")
    mapped.add(raw_of(0), IMAGE, GPS, 0.0)
    assert mapped.status.state == "stopped"
    mapped.add(raw_of(1), IMAGE, GPS, 2.0)
    assert mapped.searched.so_far().header.places == 0
    mapped.store.close()


def hold_up(mapped: LiveMap, folder: Path) -> None:
    """Map until the disk takes no more."""
    while mapped.store.waiting:
        os.sched_yield()
    (file,) = logs_in(folder)
    with full_disk(file.stat().st_size):
        while not mapped.status.why:
            drive(mapped, range(40, 41))


def test_a_full_disk_holds_mapping_up_until_there_is_room_again(tmp_path: Path) -> None:
    config = MappingConfig(folder=str(tmp_path))
    mapped = LiveMap(config, DriveStore(config, HEADER, "rear", lambda: START_S, retry_s=0.01))
    drive(mapped, range(40))
    hold_up(mapped, tmp_path)
    assert (mapped.status.state, mapped.status.why) == ("waiting", "disk I/O error")
    newest = mapped.newly_searchable(1000.0)
    assert newest is not None and newest.header.places >= 40, "what is mapped is still searched"
    while mapped.status.why:
        drive(mapped, range(45, 46))
    drive(mapped, range(46, 70))
    mapped.store.close()
    again = live(tmp_path)
    assert again.status.places == mapped.status.places and mapped.status.places > 60
    starts = [one.start for one in again.store.whole().header.segments]
    assert starts[0] == 0
    assert len(starts) > 1, "no line runs over what was not mapped"
    again.store.close()


def test_a_full_disk_at_the_first_place_is_tried_again(tmp_path: Path) -> None:
    mapped = live(tmp_path)
    with full_disk():
        drive(mapped, range(5))
    assert (mapped.status.state, mapped.status.why) == ("waiting", "disk I/O error")
    drive(mapped, range(5, 30))
    assert (mapped.status.state, mapped.status.places) == ("mapping", 25)
    mapped.store.close()


FULL = """
import os, subprocess, sys
from pathlib import Path
from tests.plugins.mapping.test_live_map import drive, live
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=400k", "disk", sys.argv[1]], check=True)
mapped = live(Path(sys.argv[1]), min_free_mb=0.0)
with open(sys.argv[1] + "/other", "wb", buffering=0) as other:
    while other.write(bytes(4096)) == 4096 and os.statvfs(sys.argv[1]).f_bavail:
        pass
drive(mapped, range(1))
print(mapped.status.state, mapped.status.why)
"""
READ_ONLY = """
import subprocess, sys
from pathlib import Path
from tests.plugins.mapping.test_live_map import live
subprocess.run(["mount", "--bind", "-o", "ro", sys.argv[1], sys.argv[1]], check=True)
subprocess.run(["mount", "-o", "remount,bind,ro", sys.argv[1]], check=True)
mapped = live(Path(sys.argv[1]))
print(mapped.searched.count, mapped.status.state, mapped.status.why)
"""


def in_own_mounts(code: str, folder: Path) -> str:
    """What code prints that mounts something at a folder."""
    if subprocess.run(["unshare", "-rm", "true"], check=False, capture_output=True).returncode:
        pytest.skip("this user may not make a mount namespace")
    command = ["unshare", "-rm", sys.executable, "-c", code, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[3])
    assert "Errno" not in done.stderr and "Traceback" not in done.stderr, done.stderr
    return done.stdout


def test_a_disk_that_is_full_is_said_in_the_words_of_the_system(tmp_path: Path) -> None:
    assert in_own_mounts(FULL, tmp_path) == "waiting No space left on device\n"


@pytest.mark.parametrize("is_killed", [False, True])
def test_a_drive_on_a_disk_that_became_read_only_is_searched(tmp_path: Path, is_killed: bool) -> None:
    first = live(tmp_path / "maps")
    drive(first, range(30))
    while first.store.waiting:
        os.sched_yield()
    shutil.copytree(tmp_path / "maps", tmp_path / "killed")
    first.store.close()
    folder = tmp_path / ("killed" if is_killed else "maps")
    assert len(list(folder.iterdir())) == (3 if is_killed else 1), "what SQLite keeps beside it"
    assert in_own_mounts(READ_ONLY, folder) == "30 waiting Read-only file system\n"


def test_the_drive_of_an_earlier_version_is_left_for_that_with_a_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    older = tmp_path / ".20260101T000000Z.growing"
    older.write_bytes(b"LBPL" + bytes(100))
    mapped = live(tmp_path)
    drive(mapped, range(30))
    mapped.store.close()
    why = "cannot open it: an earlier version began this drive: start that version once, or remove it"
    assert [one.message for one in caplog.records] == [f"{older}: {why}"]
    assert older.stat().st_size == 104 and mapped.status.places == 30


def test_of_two_daemons_only_one_maps_in_a_folder(tmp_path: Path) -> None:
    first = live(tmp_path)
    with pytest.raises(ConfigError, match=r"^\[mapping\] folder: .*: another daemon maps there; stop it first$"):
        live(tmp_path)
    first.store.close()
    live(tmp_path).store.close()


def make_drive(folder: Path, unix_s: float) -> Path:
    mapped = live(folder, unix_s, resume_min=0.0, quota_mb=1e6)
    drive(mapped, range(30))
    mapped.store.close()
    live(folder, unix_s, resume_min=0.0, quota_mb=1e6).store.close()
    path = folder / mapped.status.name
    os.utime(path / "map.json", (unix_s, unix_s))
    return path


def test_the_maps_of_a_folder_are_listed_and_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = make_drive(tmp_path, START_S)
    assert main(["map", "list", str(tmp_path)]) == 0
    assert re.search(
        rf"{path.name}  2026-09-21 \d\d:\d\d UTC +30 places .* MB  bright  may be deleted",
        capsys.readouterr().out,
    )
    assert main(["map", "keep", str(path)]) == 0
    other = make_drive(tmp_path, START_S + 1000)
    assert delete_oldest(tmp_path, 0.0) == [other]
    assert main(["map", "keep", str(path), "--undo"]) == 0
    assert main(["map", "keep", str(tmp_path)]) == 78
    make_drive(tmp_path, START_S + 1000)
    assert delete_oldest(tmp_path, 1.0) == [path], "the older one"
    assert delete_oldest(tmp_path, 0.0) == [], "the last layer of its road"


def test_the_quota_deletes_retired_drives_and_then_the_oldest(tmp_path: Path) -> None:
    paths = [make_drive(tmp_path, START_S + 1000 * number) for number in range(6)]
    (paths[0] / KEEP).touch()
    (paths[1] / "map.json.sig").write_text("00")
    own = paths[2].rename(tmp_path / "my own name")
    (paths[4] / RETIRED).touch()
    sizes = {one.path: one.size_bytes for one in stored_maps(tmp_path)}
    assert delete_oldest(tmp_path, sum(sizes.values()) - 1) == [paths[4]], "3 is older, and searched"
    assert delete_oldest(tmp_path, 0.0) == [paths[3], paths[5]]
    assert {path for path in tmp_path.iterdir() if (path / "map.json").exists()} == {paths[0], paths[1], own}


def test_of_the_drives_of_a_road_those_are_searched_that_map_learn_has_chosen(tmp_path: Path) -> None:
    paths = [make_drive(tmp_path, START_S + 1000 * number) for number in range(3)]
    live(tmp_path, START_S + 9000).store.close()
    assert len(open_map_set(tmp_path).names) == 3
    assert main(["map", "learn", str(tmp_path), "--layers", "1"]) == 0
    live(tmp_path, START_S + 9000).store.close()
    assert open_map_set(tmp_path).names == (paths[2].name,)


def test_a_drive_that_was_mapped_while_the_clock_was_not_set_is_deleted_last(tmp_path: Path) -> None:
    by_clock = make_drive(tmp_path, START_S)
    without = make_drive(tmp_path, 1000.0)
    assert delete_oldest(tmp_path, 1.5 * stored_maps(tmp_path)[0].size_bytes) == [by_clock]
    assert without.is_dir()


def test_mapping_waits_for_a_slow_disk_and_goes_on(tmp_path: Path) -> None:
    mapped, row = live(tmp_path), 20
    drive(mapped, range(row))
    with closing(sqlite3.connect(logs_in(tmp_path)[0], isolation_level=None)) as disk:
        disk.execute("BEGIN IMMEDIATE")  # nothing else is written meanwhile
        while mapped.status.state == "mapping" and row < 5000:
            mapped.add(raw_of(row), IMAGE, replace(GPS, lat_deg=GPS.lat_deg + row * 2 / 110_800), row * 2.0)
            row += 1
    assert (mapped.status.state, mapped.status.why) == ("waiting", "the disk is too slow")
    while mapped.store.waiting:
        time.sleep(0.01)
    drive(mapped, range(row, row + 20))
    assert mapped.status.state == "mapping"
    mapped.store.close()
    again = live(tmp_path)
    assert again.status.places == mapped.status.places
    again.store.close()
