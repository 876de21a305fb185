"""Frames beside `map learn`: the command runs or is stopped as it should be, and the table compares the two."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

from sim.research.evaluation.learning_frames import Learning, table
from tests.plugins.layers.drives import Driven, build


def _state(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_it_stands_still_only_while_it_is_stopped_and_begins_anew(tmp_path: Path) -> None:
    for number in range(2):
        build(tmp_path / f"{number}", Driven(light=number))
    learning, ends_s = Learning(tmp_path), time.monotonic() + 120.0
    first = learning.pid
    try:
        with learning.stopped():
            while _state(first) != "T":
                assert time.monotonic() < ends_s
        assert _state(first) != "T"
        os.kill(first, signal.SIGKILL)  # at the lowest priority it may take minutes to end by itself
        while learning.pid == first:
            assert time.monotonic() < ends_s
            learning.keep_running()
    finally:
        learning.close()


def test_the_table_compares_medians_and_the_slowest_with_the_median_of_frames_alone() -> None:
    alone_ms = np.tile(np.r_[np.full(98, 10.0), 30.0, 30.0], (3, 1))
    rows = list(table(np.stack([alone_ms, alone_ms * [[1.0], [1.1], [1.3]]], axis=1), 0.5))
    assert rows[2:] == ["| is stopped | 10 ms | 1.00 | 3.00 |", "| runs, with 0.50 of a core | 11 ms | 1.10 | 3.30 |"]
