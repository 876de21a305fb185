"""The bench measures what it says it does, on tiny sizes; how fast anything is depends on the machine."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import pytest

from edge.descriptor.model_file import GRID, resolve_model
from edge.errors import LookbackError
from edge.reference_map.store import ModelKey, open_map
from edge_plugins.motion.camera_motion import CameraMotion
from sim.bench import drives, stages
from sim.bench.simulated_map import BLOCK, write_simulated_map
from sim.bench.table import Row, cells, page
from sim.bench.timing import Times, race

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
    match = drives.BenchDrive(tmp_path / "m", 3000, known=False).step()
    assert match is not None
    assert match.uniqueness > 1.5
    assert match.place == 3040
    assert match.distance < 1e-4


def test_a_row_has_its_floor_its_rival_and_what_was_aimed_for() -> None:
    ours, floor, rival = Times((4.0, 4.0)), Times((2.0, 2.0)), Times((8.0, 8.0))
    rows = [
        Row("walking", "1 km", ours, floor, "running", rival, most=1.5),
        Row("cycling", "1 km", ours, None, "running", rival, most=1.5),
    ]
    text = page([*rows, Row("standing", "1 h", ours)], "Made by hand.", "bench.csv")
    assert "| walking | 1 km | 4.00 | **2.00** (1.5) | 0.50 | running |" in text
    assert "| cycling | 1 km | 4.00 |  | 0.50 (1.5) | running |" in text
    assert "(1 of 2 rows)" in text.replace("\n", " ") and "standing" not in text
    assert [*cells(rows)][1] == ["walking", "1 km", "4.00", "2.00", "0.50", "running", "1.5"]


def test_search_and_its_rival_find_the_same_lines() -> None:
    """What is raced must do the same work, or the race says nothing."""
    lines = stages.running(300, 10)()
    assert lines is not None
    np.testing.assert_array_equal(lines.costs, stages.direct(300, 10)())


def test_products_of_the_networks() -> None:
    """Of an AlexNet up to fc6, as docs/fleet.md has them for two regions, and of the grid."""
    fc6 = stages.products_of(onnx.load(resolve_model(None)), (2, 224, 224, 3))
    assert fc6 == pytest.approx(1.39e9, rel=0.01)
    one, two = (stages.products_of(onnx.load(GRID), (count, 128, 256, 3)) for count in (1, 2))
    assert two == pytest.approx(2 * one, rel=0.01)


@pytest.mark.long
def test_every_stage(tmp_path: Path) -> None:
    rows = list(stages.measure(1, [300]))
    assert all(row.times.median_ms > 0 for row in rows)
    assert {row.rival for row in rows} >= {"OpenCV, the same file", "faiss SQ8, one of the two orders"}
    frames = list(drives.frames(tmp_path / "map", 200, 3))
    assert [row.stage for row in frames][-1] == "**whole frame**"
    assert {row.stage for row in frames if row.floor} >= {"frame: network", "frame: matching", "frame: search"}
    assert all(row.times.median_ms > 0 for row in drives.mapping(tmp_path / "mapping", 20))
    assert [row.stage for row in drives.maps(tmp_path, 300, 2, KEY)][1] == "frame, place known to 500 m"
    assert not (tmp_path / "300.map").exists()


@pytest.mark.long
def test_the_daemon_is_measured_from_the_camera_on(tmp_path: Path) -> None:
    five, fifteen, start = drives.daemon(tmp_path / "feed", (96, 64), 1)
    assert min(five.times.median_ms, fifteen.times.median_ms, start.times.median_ms) > 0


def test_a_daemon_that_does_not_start_says_why(tmp_path: Path) -> None:
    (tmp_path / "lookback.toml").write_text("[camera]\nkind = 3\n")
    with pytest.raises(LookbackError, match=r"does not start: .*kind"):
        drives.run_daemon(tmp_path / "lookback.toml", 1)


def test_the_motion_that_is_timed_is_measured() -> None:
    motion = CameraMotion(stages.MOTION)
    for at in range(4):
        motion.follow(stages.road(stages.STEP_M * at), (1 + at) * stages.STEP_NS, None)
    assert motion.why == "the height of the camera is not learned yet", "and else it would be known"
