"""The main job on real recordings: a corridor driven twice, and a track in both directions."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from edge.__main__ import main


@pytest.fixture(scope="module")
def corridor_map(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("maps") / "corridor.map"
    assert (
        main(["map", "build", str(shared / "feeds/corridor_reference"), "-o", str(path), "--spacing-frames", "1"]) == 0
    )
    return path


@pytest.fixture(scope="module")
def corridor_lines(shared: Path, corridor_map: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a replay writes of each frame of the corridor."""
    path = tmp_path_factory.mktemp("replayed") / "lines.jsonl"
    assert main(replay_all(shared, corridor_map, path)) == 0
    return path


def replay_all(shared: Path, corridor_map: Path, output: Path) -> list[str]:
    query, path = str(shared / "feeds/corridor_query"), str(corridor_map)
    return ["replay", query, "--map", path, "--sequence-length", "20", "--all", "-o", str(output)]


def replayed(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    capsys.readouterr()
    assert main(["replay", *arguments]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_corridor(shared: Path, corridor_map: Path, corridor_lines: Path, capsys: pytest.CaptureFixture[str]) -> None:
    query = str(shared / "feeds/corridor_query")
    lines = [json.loads(line) for line in corridor_lines.read_text(encoding="utf-8").splitlines()]
    assert [line["frame"] for line in lines] == list(range(111))
    assert all(line["place"] is None for line in lines[:15])
    right = [abs(line["place"] - line["frame"]) <= 3 for line in lines[15:]]
    assert sum(right) / len(right) >= 0.98
    assert all(right[row] for row, line in enumerate(lines[15:]) if line["accepted"])
    assert sum(line["accepted"] for line in lines) >= 0.7 * len(right)
    assert {(line["direction"], line["order"]) for line in lines[15:]} == {("forward", "same")}
    events = replayed(capsys, query, "--map", str(corridor_map), "--sequence-length", "20")
    assert events == [line for line in lines if line["emitted"]]
    assert len(events) >= 10


def test_the_same_bytes_from_run_to_run(shared: Path, corridor_map: Path, corridor_lines: Path, tmp_path: Path) -> None:
    assert main(replay_all(shared, corridor_map, tmp_path / "lines.jsonl")) == 0
    assert (tmp_path / "lines.jsonl").read_bytes() == corridor_lines.read_bytes()
    again = tmp_path / "again.map"
    assert (
        main(["map", "build", str(shared / "feeds/corridor_reference"), "-o", str(again), "--spacing-frames", "1"]) == 0
    )
    for file in corridor_map.iterdir():
        assert file.read_bytes() == (again / file.name).read_bytes()


def test_track(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "track.map"
    assert main(["map", "build", str(shared / "feeds/track_lap_a"), "-o", str(path), "--interval-s", "0.2"]) == 0
    again = replayed(
        capsys, str(shared / "feeds/track_laps_a_again"), "--map", str(path), "--sequence-length", "20", "--all"
    )
    known = [line for line in again if line["accepted"]]
    # Two laps of 60 frames: the belief goes on where the map ends.
    assert len(known) >= 0.95 * sum(line["place"] is not None for line in again)
    steps = [(later["place"] - line["place"] + 30) % 60 - 30 for line, later in pairwise(known)]
    assert max(map(abs, steps)) <= 4
    assert {(line["direction"], line["order"]) for line in known} == {("forward", "same")}
    # The other way round: few matches are believed, and those go against the map as the car does.
    back = replayed(capsys, str(shared / "feeds/track_laps_b"), "--map", str(path), "--sequence-length", "20", "--all")
    believed = [line for line in back if line["accepted"]]
    assert len(believed) <= 0.2 * len(back)
    assert {line["direction"] for line in believed} <= {"reverse"}
