"""The bench measures what it says it does, on tiny sizes; how fast anything is depends on the machine."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from edge.errors import LookbackError
from edge.reference_map.map_folder import open_map_set
from edge.reference_map.map_set import MapSet
from edge.reference_map.store import ModelKey, open_map
from edge_plugins.motion.camera_motion import CameraMotion
from sim.bench.simulated_map import BLOCK, write_simulated_map
from sim.bench.timing import Times, race
from sim.research.bench import daemon_rows, frame_rows, keypoint_rows, map_rows, mapping_rows, motion_rows, search_rows
from sim.research.bench.machine import Machine
from sim.research.bench.map_rows import seen_at, write_simulated_tiles
from sim.research.bench.rows import Row, Section, Target, page

MACHINE = Machine("a slide rule", 1e6, 1e8)
KEY = ModelKey("random", "0" * 64, "fc6", 64)


def test_a_race_goes_round_in_turns() -> None:
    order: list[str] = []
    ticks: Iterator[int] = iter([0, 2_000_000, 5_000_000, 6_000_000, 10_000_000, 14_000_000, 20_000_000, 21_000_000])
    times = race({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, 2, lambda: next(ticks))
    assert order == ["a", "b"] * 3
    assert times["a"].runs_ms == (2.0, 4.0)
    assert times["b"].runs_ms == (1.0, 1.0)
    assert times["a"].ratio(times["b"]) == 3.0
    assert times["a"].median_ms == 3.0


def test_a_simulated_map_is_a_whole_map(tmp_path: Path) -> None:
    write_simulated_map(tmp_path / "m", BLOCK + 1000, KEY)
    reference_map = open_map(tmp_path / "m", every_file=True)
    assert [segment.end for segment in reference_map.header.segments] == [5000, BLOCK + 1000]
    drive = map_rows.Drive(MapSet.of(reference_map), 3000, known=False)
    match = drive.step()
    assert match is not None
    assert match.uniqueness > 1.5
    assert match.place == 3040
    assert match.distance < 1e-4
    assert seen_at(reference_map.descriptors, 7).shape == (2, 64)


def test_simulated_tiles_are_a_folder_of_maps(tmp_path: Path) -> None:
    write_simulated_tiles(tmp_path / "tiles", 12_000, 4, KEY)
    maps = open_map_set(tmp_path / "tiles", every_file=True)
    assert not maps.excluded
    assert [len(header.segments) for header in maps.headers] == [1, 2, 1, 2]
    north, south = maps.places["lat_deg"][2999:3001]
    assert south - north == pytest.approx(2 / 110_800, rel=0.01)  # the street goes on from one tile to the next
    match = map_rows.Drive(maps, 4000, known=True).step()
    assert match is not None
    assert match.place_index == 4040
    assert match.uniqueness > 1.5


def test_a_floor_is_bytes_and_products() -> None:
    assert MACHINE.floor_ms(3e6, 2e8) == pytest.approx(5.0)


def test_rows_and_targets_on_a_page() -> None:
    row = Row("walking", Times((1.0, 2.0, 30.0)), "running", 2.5, "uphill")
    targets = [Target("a", "1x", "2x", False), Target("b", "1x", "1x", True)]
    text = page(MACHINE, [Section("Feet", [row], targets)], "Made by hand.")
    assert "| walking | 2.00 (2.50) | running; uphill |" in text
    assert "1 of 2 targets (`sim/research/bench`) are met. **Not met:**\n\n- a: 2x (wanted: 1x)\n\n## Feet" in text


def test_rows_that_differ_in_their_size_are_one_line() -> None:
    one, three = Times((3.0,)), Times((9.0,))
    rows = [Row("walking", one, "running", 1.5, size="1 km"), Row("walking", three, "running", 4.5, size="3 km")]
    text = page(MACHINE, [Section("Feet", [*rows, Row("cycling", one, "walking", 0.5, size="3 km")], [])], "By hand.")
    assert "| ms (ratio) | 1 km | 3 km | against |\n|---|---|---|---|\n" in text
    assert "| walking | 3.00 (1.50) | 9.00 (4.50) | running |\n| cycling |  | 3.00 (0.500) | walking |\n" in text


def test_search_and_its_rivals_find_the_same_lines() -> None:
    """What is raced must do the same work, or the race says nothing."""
    count, length = 300, 10
    lines = search_rows.running(count, length)()
    direct = search_rows.direct(count, length)()
    assert lines is not None
    np.testing.assert_array_equal(lines.costs, direct)


def test_every_section_of_tiny_maps(tmp_path: Path) -> None:
    sections = [
        search_rows.measure([200], 2),
        frame_rows.measure(tmp_path, 200, 3),
        map_rows.measure(tmp_path, [300], 2, KEY),
        mapping_rows.measure(tmp_path, 200, 20),
    ]
    text = page(MACHINE, sections, "Made by a test.")
    for what in ("L = 80", "whole frame", "| 300 places |", "opening, with its search", "one that maps"):
        assert what in text
    assert not (tmp_path / "300.map").exists()


def test_the_daemon_is_measured_from_the_camera_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(daemon_rows, "BEGUN_S", 1)
    monkeypatch.setattr(daemon_rows, "STARTS", 1)
    section = daemon_rows.measure(tmp_path, 200, 1, ["grid"], [(96, 64)])
    took_ms = {row.what: row.times.median_ms for row in section.rows if row.times}
    _, five, fifteen, unused, start = took_ms.values()
    assert unused == pytest.approx((fifteen - five) / 10)
    assert min(five, fifteen, start) > 0
    journal = (tmp_path / "96x64/events-15.jsonl").read_text()
    assert '"frames_used":15' in journal
    assert '"delivered":45' in journal, "pictures of three seconds, all of which came"


def test_a_daemon_that_does_not_start_says_why(tmp_path: Path) -> None:
    (tmp_path / "lookback.toml").write_text("[camera]\nkind = 3\n")
    with pytest.raises(LookbackError, match=r"does not start: .*kind"):
        daemon_rows._start(tmp_path / "lookback.toml")


def test_the_motion_that_is_timed_is_measured() -> None:
    motion = CameraMotion(motion_rows.CONFIG)
    for at in range(4):
        motion.follow(motion_rows.road(motion_rows.STEP_M * at), (1 + at) * motion_rows.STEP_NS, None)
    assert motion.why == "the height of the camera is not learned yet", "and else it would be known"
    (row,) = motion_rows.measure(1).rows
    assert row.ratio is not None


def test_matching_against_rivals() -> None:
    pytest.importorskip("faiss")
    from sim.research.bench import matching_rows

    section = matching_rows.measure(MACHINE, [300], 2, dimensions=64)
    assert {row.what for row in section.rows} >= {"faiss SQ8, one order", "ours"}


def test_keypoints_and_their_comparison_stand_beside_the_grid() -> None:
    rows = keypoint_rows.measure(1).rows
    assert {row.against for row in rows} == {keypoint_rows.GRID}
    assert [row.what.split(",")[0] for row in rows[:3]] == ["keypoints of one picture", "verify", "verify"]
    assert all(row.times and row.times.median_ms > 0 for row in rows)
