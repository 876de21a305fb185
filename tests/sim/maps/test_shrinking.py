"""`lookback map build --dimensions` shrinks the map."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from edge.__main__ import main


def test_a_shrunk_map_is_built_and_used(
    write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    morning = write_traverse(tmp_path / "morning", range(60))
    evening = write_traverse(tmp_path / "evening", range(60), noise=6.0)
    map_path = str(tmp_path / "map")
    assert main(["map", "build", str(morning), "-o", map_path, "--spacing-frames", "1", "--dimensions", "48"]) == 0
    capsys.readouterr()
    assert main(["map", "info", map_path]) == 0
    assert "reduced   to 48 of 2304 dimensions per region" in capsys.readouterr().out
    options = ["--map", map_path, "--sequence-length", "8", "--all"]
    assert main(["replay", str(evening), *options]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert all(abs(line["place"] - line["frame"]) <= 1 for line in lines[8:])
    assert main(["map", "extend", map_path, str(evening)]) == 0
    assert main(["map", "info", map_path]) == 0
    assert "reduced   to 48 of 2304" in capsys.readouterr().out


@pytest.mark.parametrize("dimensions", ["0", "2305"])
def test_impossible_dimensions_are_one_line(
    write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], dimensions: str
) -> None:
    feed = write_traverse(tmp_path / "feed", range(5))
    command = ["map", "build", str(feed), "-o", str(tmp_path / "map"), "--dimensions", dimensions]
    assert main(command) == 78
    error = capsys.readouterr().err
    assert f"--dimensions: {dimensions} is not between 1 and the network's 2304" in error
    assert not (tmp_path / "map").exists()
