"""kill -9 at any moment of a write, and every prefix of one: the old or the new, and never something unreadable."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.descriptor import RunningStatistics
from edge.journal.journal import Journal
from edge.journal.records import StateChanged
from edge.recognition.warm_start import PersistentTime, StateFile, StateKey
from sim.journal import records_of

pytestmark = pytest.mark.long

CRASH_LOOP = Path(__file__).with_name("crash_loop.py")


@pytest.mark.parametrize("kills", [40, pytest.param(500, marks=pytest.mark.soak)])
@pytest.mark.parametrize("what", ["map", "state", "journal", "clock"])
def test_killed_while_writing(what: str, kills: int, tmp_path: Path, seed: int, figures: Callable[[str], None]) -> None:
    done = subprocess.run(
        [sys.executable, str(CRASH_LOOP), what, str(tmp_path), str(kills), str(seed)],
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout)
    figures(str(found))
    assert found.get("unreadable", 0) == found.get("neither", 0) == 0, done.stderr
    assert found.get("new", 0) + found.get("old", 0) == kills
    assert found["left over"] <= 1, "what a killed builder has left is cleared by the next"
    assert found["in the middle of a write"] > kills / 4, "the kills did not hit what they are for"


def test_every_prefix_of_a_state_is_refused(tmp_path: Path, figures: Callable[[str], None]) -> None:
    key, shape, now = StateKey("m", "fc6", "left-right", 0.4, "h"), (2, 8), PersistentTime(1.0, "boot", 1.0)
    path = tmp_path / "events.state"
    file = StateFile(path, key, shape)
    kept = RunningStatistics.of_another_run(30, np.ones(shape), np.ones(shape), at_most=30)
    file.write(kept, now)
    whole = path.read_bytes()
    assert file.read(now, 60) is not None
    flips = 0
    with path.open("r+b", buffering=0) as stream:
        for bit in range(8 * len(whole)):
            for value in (whole[bit // 8] ^ 1 << bit % 8, whole[bit // 8]):
                os.pwrite(stream.fileno(), bytes([value]), bit // 8)
                flips += value != whole[bit // 8]
                assert (file.read(now, 60) is None) is (value != whole[bit // 8])
        for length in reversed(range(len(whole))):
            stream.truncate(length)
            assert file.read(now, 60) is None
    figures(f"{len(whole)} prefixes and {flips} bit flips refused")


def test_every_prefix_of_a_journal_costs_the_last_line_at_most(tmp_path: Path, figures: Callable[[str], None]) -> None:
    path = tmp_path / "events.jsonl"
    journal = Journal(path, unix_time_s=lambda: 1.5)
    for number in range(5):
        journal.write(StateChanged(str(number), "a \u00fc \n b"))
    journal.close()
    whole = path.read_bytes()
    for length in range(len(whole) + 1):
        os.truncate(path, 0)
        path.write_bytes(whole[:length])
        again = Journal(path, unix_time_s=lambda: 1.5)
        again.write(StateChanged("after"))
        again.close()
        numbers = [record.state for record in records_of(path, StateChanged)]
        # A line whose newline alone is missing is whole.
        lines = max(0, whole[:length].count(b"\n") - 1)  # the first is journal_opened
        assert numbers[-1] == "after"
        assert numbers[:-1] in ([str(number) for number in range(to)] for to in (lines, lines + 1))
    figures(f"{len(whole) + 1} prefixes")
