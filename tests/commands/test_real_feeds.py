"""The main job on real recordings: a corridor driven twice, and a track in both directions."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from edge.__main__ import main


def corridor(shared: Path, path: Path) -> Path:
    feed = str(shared / "feeds/corridor_reference")
    assert main(["map", "build", feed, "-o", str(path), "--spacing-frames", "1"]) == 0
    return path


@pytest.fixture(scope="module")
def corridor_map(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return corridor(shared, tmp_path_factory.mktemp("maps") / "corridor.map")


def replayed(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    capsys.readouterr()
    assert main(["replay", *arguments]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_corridor(shared: Path, corridor_map: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    query, output = str(shared / "feeds/corridor_query"), tmp_path / "lines.jsonl"
    replay = [query, "--map", str(corridor_map), "--sequence-length", "20"]
    assert main(["replay", *replay, "--all", "-o", str(output)]) == 0
    lines = [json.loads(line) for line in output.read_text(encoding="utf-8").splitlines()]
    assert [line["frame"] for line in lines] == list(range(111))
    assert all(line["place"] is None for line in lines[:15])
    right = [abs(line["place"] - line["frame"]) <= 3 for line in lines[15:]]
    assert sum(right) / len(right) >= 0.98
    assert all(right[row] for row, line in enumerate(lines[15:]) if line["accepted"])
    assert sum(line["accepted"] for line in lines) >= 0.7 * len(right)
    assert {(line["direction"], line["order"]) for line in lines[15:]} == {("forward", "same")}
    events = replayed(capsys, *replay)
    assert events == [line for line in lines if line["emitted"]], "from run to run"
    assert len(events) >= 10


def test_the_same_bytes_from_run_to_run(shared: Path, corridor_map: Path, tmp_path: Path) -> None:
    again = corridor(shared, tmp_path / "again.map")
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
