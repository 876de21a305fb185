"""kill -9 while a folder of maps learns, undoes it, or takes a delta: each drive is as before, or as after."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from sim.maps.exchange import write_delta
from tests.plugins.layers.drives import MADE_S, Driven, build

pytestmark = pytest.mark.long

KILLS = pytest.mark.parametrize("kills", [20, pytest.param(200, marks=pytest.mark.soak)])


@KILLS
def test_killed_while_learning(kills: int, tmp_path: Path, seed: int) -> None:
    for number in range(3):
        build(tmp_path / f"{number}", Driven(end=20, made_s=MADE_S + number))
    found = run("learn_loop.py", tmp_path, kills, seed)
    assert len(found) == kills
    assert set(found) == {"3/0", "1/1"}, "both must be met, and nothing else"


@KILLS
def test_killed_while_a_delta_is_applied(kills: int, tmp_path: Path, seed: int) -> None:
    office, vehicle, delta = tmp_path / "office", tmp_path / "vehicle", tmp_path / "delta.tar.gz"
    for number in range(4):
        build(office / f"{number}", Driven(end=20, made_s=MADE_S + number))
    shutil.copytree(office / "0", vehicle / "0")
    write_delta(office, vehicle, delta)
    found = run("apply_loop.py", vehicle, delta, kills, seed)
    assert len(found) == kills
    assert {one.partition("/")[2] for one in found} == {"4"}, "the same command adds the rest, and leaves nothing else"
    assert len(set(found)) > 1, "killed before a drive was added, and after"


def run(loop: str, *arguments: object) -> list[str]:
    """What a loop prints."""
    command = [sys.executable, str(Path(__file__).with_name(loop)), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert not done.stderr
    return done.stdout.split()
