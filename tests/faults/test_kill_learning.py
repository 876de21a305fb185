"""kill -9 while a folder of maps learns or undoes it: each drive is as before, or as after."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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


def run(loop: str, *arguments: object) -> list[str]:
    """What a loop prints."""
    command = [sys.executable, str(Path(__file__).with_name(loop)), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert not done.stderr
    return done.stdout.split()
