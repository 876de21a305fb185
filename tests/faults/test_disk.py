"""A disk that takes no more: the daemon goes on, says so, and writes again as soon as there is room."""

from __future__ import annotations

import resource
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.journal.records import FrameUsed, Stopped
from sim.journal import read_journal

WORDS = "journal: File too large"


def test_a_full_disk(
    calm_feed: Path,
    write_config: Callable[..., Path],
    start: Callable[..., Any],
    tmp_path: Path,
    figures: Callable[[str], None],
) -> None:
    """The largest file allowed stands in for the disk: the same call fails, and room can be given back."""
    journal = tmp_path / "events.jsonl"
    process = start(write_config(camera={"device": str(calm_feed)}, telemetry={"journal_frames": True}))
    process.wait_until_on_the_map(WORDS)
    _, hard = resource.prlimit(process.popen.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(process.popen.pid, resource.RLIMIT_FSIZE, (journal.stat().st_size, hard))
    while WORDS not in process.wait_for_word("STATUS="):
        pass
    for _ in range(5):
        process.wait_for_word("WATCHDOG=1")
    resource.prlimit(process.popen.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, hard))
    process.wait_until_on_the_map(WORDS)
    assert process.end()[0] == 0, process.told()
    assert process.told().count("cannot write the journal") == 1
    assert "writing again" in process.told()
    records = [line.record for line in read_journal(journal)]
    lines = journal.read_bytes().splitlines()
    torn = len(lines) - len(records)
    assert torn <= 1, "only the line that was being written"
    assert isinstance(records[-1], Stopped)
    numbers = [record.frame for record in records if isinstance(record, FrameUsed)]
    lost = numbers[-1] + 1 - len(numbers)
    figures(f"{lost} frame lines lost while the disk was full, {torn} torn")
    assert 0 < lost < numbers[-1] / 2


def test_no_room_from_the_start(
    calm_feed: Path, write_config: Callable[..., Path], start: Callable[..., Any], tmp_path: Path
) -> None:
    prlimit = shutil.which("prlimit")
    if prlimit is None:
        pytest.skip("needs prlimit")
    buffered = {"PYTHONUNBUFFERED": ""}  # or nothing of the log would be left to be written at the end
    process = start(
        write_config(camera={"device": str(calm_feed)}), wrapper=[prlimit, "--fsize=0"], environment=buffered
    )
    while not (status := process.wait_for_word("STATUS=degraded")).endswith("; on the map"):
        pass
    assert WORDS in status
    assert process.end()[0] == 0, process.told()
    assert (tmp_path / "events.jsonl").stat().st_size == 0
    assert not (tmp_path / "events.state").exists()
