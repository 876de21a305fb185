"""kill -9 while drives of a folder are retired and moved, or as they were again: all is as before, or as after."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.layers.drives import MADE_S, Driven, build

LOOP = Path(__file__).with_name("learn_loop.py")


@pytest.mark.parametrize("kills", [20, pytest.param(200, marks=pytest.mark.soak)])
def test_killed_while_learning(kills: int, tmp_path: Path, seed: int) -> None:
    for number in range(3):
        build(tmp_path / f"{number}", Driven(end=20, made_s=MADE_S + number))
    command = [sys.executable, str(LOOP), str(tmp_path), str(kills), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = done.stdout.split()
    assert len(found) == kills
    assert set(found) == {"3/0", "1/1"}, "both must be met, and nothing else"
    assert not done.stderr
