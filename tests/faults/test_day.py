"""A day at five frames a second, with everything but the network: memory and descriptors stay as they are."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.journal.records import PlaceFix
from sim.journal import records_of

pytestmark = pytest.mark.long

ROWS = 80
LAP = 2 * (ROWS - 1)
"""Frames there and back."""
DAY = 24 * 3600 * 5
WARM_UP_LAPS = 16
"""Until the page's history of 2400 frames is full, and every new frame of it replaces an old one."""
ROUND_LAPS = 3
"""Memory is compared at its lowest of so many laps: texts and journal lines come and go with periods of their own."""
BLOCKS_PER_FRAME = 0.1
"""A leak of a single object, however small, is 1."""
BYTES_PER_FRAME = 10.0
"""Resident, over a day: also what is no object of Python's."""


@pytest.mark.parametrize(
    "laps", [WARM_UP_LAPS + 2 * ROUND_LAPS, pytest.param(DAY // LAP, marks=pytest.mark.soak)], ids=["quick", "day"]
)
def test_a_day(
    laps: int,
    street: Path,
    write_config: Callable[..., Path],
    make_bench: Callable[..., Any],
    grid: Network,
    proc: Any,
    tmp_path: Path,
    figures: Callable[[str], None],
) -> None:
    feed = FeedImages(read_feed(street / "feed"))
    drive = [feed.read(row) for row in range(ROWS)]
    there_and_back = [*drive, *drive[-2:0:-1]]
    config = write_config(telemetry={"emit": "external_position"}, acceptance={"hold_off_s": 1.0})
    bench = make_bench(config, network=grid)
    began_s, messages = time.monotonic(), 0
    blocks, resident, descriptors = [], [], []
    for lap in range(laps):
        for number, image in enumerate(there_and_back):
            bench.step(image, lap * LAP + number)
            messages += len(bench.autopilot.received)
            bench.autopilot.received.clear()  # the simulated autopilot keeps what it has received
            bench.autopilot.resets.clear()
        gc.collect()
        blocks.append(sys.getallocatedblocks())
        resident.append(proc.resident_bytes())
        descriptors.append(proc.open_descriptors())
    took_s, frames = time.monotonic() - began_s, laps * LAP
    events = len(list(records_of(tmp_path / "events.jsonl", PlaceFix)))
    steady = blocks[WARM_UP_LAPS:]
    between = (len(steady) - ROUND_LAPS) * LAP
    grown = (min(steady[-ROUND_LAPS:]) - min(steady[:ROUND_LAPS])) / between
    grown_bytes = (resident[-1] - resident[WARM_UP_LAPS]) / between
    figures(
        f"{frames} frames in {took_s:.0f} s, {events} events, {messages} messages; {grown:.3f} objects and "
        f"{grown_bytes:.1f} bytes (RSS) more a frame"
    )
    # Not of every lap: a thread may just be writing a file.
    assert min(descriptors[-ROUND_LAPS:]) <= min(descriptors[:ROUND_LAPS])
    assert events > frames / 40
    assert messages > frames / 5
    assert grown < BLOCKS_PER_FRAME
    if frames > DAY / 2:  # of a short run, one page more is already a slope
        assert grown_bytes < BYTES_PER_FRAME
