"""The wall clock is stepped under a running daemon: no event is lost, told twice, or late."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.journal.records import FrameUsed, PlaceFix
from sim.journal import read_journal, records_of

HOUR_S, TEN_YEARS_S = 3600, 10 * 365 * 86400
HOLD_OFF_S = 0.3
LATE_S = 30.0
"""A step would show as its own length; a machine that is busy may take a while."""


@pytest.mark.parametrize(
    "step_s",
    [
        pytest.param(HOUR_S, marks=pytest.mark.long),  # a step back is what misleads a clock
        -TEN_YEARS_S,
        pytest.param(-HOUR_S, marks=pytest.mark.soak),
        pytest.param(TEN_YEARS_S, marks=pytest.mark.soak),
    ],
)
def test_the_wall_clock_is_stepped(
    step_s: int,
    compile_shim: Callable[[str], Path],
    calm_feed: Path,
    write_config: Callable[..., Path],
    start: Callable[..., Any],
    tmp_path: Path,
    figures: Callable[[str], None],
) -> None:
    config = write_config(
        camera={"device": str(calm_feed)},
        telemetry={"journal_frames": True},
        acceptance={"hold_off_s": HOLD_OFF_S},
    )
    steps = tmp_path / "step"
    steps.write_text("0")
    shim = str(compile_shim("clock_shim"))
    process = start(config, environment={"LD_PRELOAD": shim, "LOOKBACK_CLOCK_STEP": str(steps)})
    process.wait_until_on_the_map()
    before = told(tmp_path)
    steps.write_text(str(step_s))
    while told(tmp_path) < before + 5:
        process.wait_for_word("WATCHDOG=1")
    assert process.end()[0] == 0, process.told()
    lines = list(read_journal(tmp_path / "events.jsonl"))
    frames = [line.record for line in lines if isinstance(line.record, FrameUsed)]
    places = [(line.unix_s or 0.0, line.record.stamp_ns) for line in lines if isinstance(line.record, PlaceFix)]

    # The step has been seen, once.
    told_s = [line.unix_s for line in lines if line.unix_s is not None]
    assert len(told_s) == len(lines)
    jumps_s = [after_s - before_s for before_s, after_s in itertools.pairwise(told_s)]
    assert [round(jump_s / step_s) for jump_s in jumps_s if abs(jump_s) > HOUR_S / 2] == [1]
    stamps_ns = [frame.stamp_ns for frame in frames]
    assert stamps_ns == sorted(set(stamps_ns))
    # Every frame that was believed is an event, unless it came within the hold-off of the one before.
    due, last_ns = [], -(10**18)
    for frame in frames:
        if frame.accepted and frame.stamp_ns - last_ns >= HOLD_OFF_S * 1e9:
            due.append(frame.stamp_ns)
            last_ns = frame.stamp_ns
    assert [stamp_ns for _, stamp_ns in places] == due
    # Told when they were seen: the journal's clock, less the step, runs with the frames' clock.
    late_s = [unix_s - stamp_ns / 1e9 for unix_s, stamp_ns in places]
    late_s = [
        late - step_s if late - late_s[0] > HOUR_S / 2 or late - late_s[0] < -HOUR_S / 2 else late for late in late_s
    ]
    spread_s = max(late_s) - min(late_s)
    figures(f"{len(places)} events of {len(frames)} frames; told within {spread_s:.2f} s of each other's delay")
    assert len(places) >= 5
    assert spread_s < LATE_S


def told(folder: Path) -> int:
    """How many events there are."""
    return len(list(records_of(folder / "events.jsonl", PlaceFix)))
