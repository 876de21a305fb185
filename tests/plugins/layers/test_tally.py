"""What a daemon counts of a drive: by map, light and stretch, and the stretches that it passed unrecognized."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.files import wait_for_writes
from edge.reference_map import open_map_set, read_header
from edge_plugins.layers.tally import KEPT_FILES, TALLIES, DriveTally, read_tallies
from sim.maps.learning import learn
from tests.plugins.layers.drives import MADE_S, SPACING_M, Driven, build, count, picture


def test_frames_are_counted_by_light_and_stretch(tmp_path: Path) -> None:
    path = build(tmp_path / "a", Driven())
    count(tmp_path, "a", range(60), MADE_S, gray=100)
    count(tmp_path, "a", range(10), MADE_S + 1, gray=60)
    day, dusk = read_tallies(tmp_path)
    key = read_header(path).header_sha256
    assert day.recognized == {key: {"front forward bright": {0: 50, 1: 10}}}
    assert dusk.recognized == {key: {"front forward dim": {0: 10}}}
    assert day.maps == {key: 60}


@pytest.mark.parametrize(
    ("odometer", "passed"), [(1.0, {1: 1, 2: 1}), (1.6, {}), (0.4, {})], ids=["along it", "a detour", "a short cut"]
)
def test_stretches_between_two_that_are_recognized_are_passed(
    odometer: float, passed: dict[int, int], tmp_path: Path
) -> None:
    path = build(tmp_path / "a", Driven())
    maps, tally = open_map_set(tmp_path), DriveTally(tmp_path, "front", MADE_S, "run")
    for row, driven_m in ((40, 0.0), (170, 130 * SPACING_M * odometer)):
        tally.count(maps, row, "forward", picture(120), driven_m, 0)
    tally.count(maps, 20, "forward", picture(120), None, 0)
    tally.close()
    wait_for_writes()
    (found,) = read_tallies(tmp_path)
    assert found.passed.get(read_header(path).header_sha256, {}).get("front forward bright", {}) == passed


def test_a_file_that_cannot_be_read_costs_its_own_counts_only(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    build(tmp_path / "a", Driven())
    count(tmp_path, "a", range(3), MADE_S)
    (tmp_path / TALLIES / "other.json").write_text('{"began_unix_s": "now"}')
    assert len(read_tallies(tmp_path)) == 1
    assert "other.json" in caplog.text
    assert learn(tmp_path).drives[0].recognized == 3


def test_the_oldest_files_are_deleted_and_a_disk_that_refuses_stops_nothing(tmp_path: Path) -> None:
    build(tmp_path / "a", Driven())
    (tmp_path / TALLIES).mkdir()
    for number in range(KEPT_FILES + 5):
        (tmp_path / TALLIES / f"{number:012}-x.json").touch()
    DriveTally(tmp_path, "front", MADE_S, "run").close()
    wait_for_writes()
    left = sorted(file.name for file in (tmp_path / TALLIES).iterdir())
    assert (len(left), left[0]) == (KEPT_FILES, "000000000005-x.json")
    (tmp_path / "a" / TALLIES).touch()
    tally = DriveTally(tmp_path / "a", "front", MADE_S, "run")
    tally.count(open_map_set(tmp_path), 0, "forward", picture(120), None, 10**12)
    tally.close()
    wait_for_writes()
