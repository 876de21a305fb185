"""A day at five frames a second, with everything but the network: memory and descriptors stay as they are."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.journal.journal import records_of
from edge.journal.records import PlaceFix

DAY = 24 * 3600 * 5
SLOPE_BYTES = 1_000_000 / 100_000
"""Per frame."""
WARM_UP = 500
SAMPLES = 50


@pytest.mark.parametrize("frames", [1500, pytest.param(DAY, marks=pytest.mark.soak)])
def test_a_day(
    frames: int,
    street: Path,
    write_config: Callable[..., Path],
    make_bench: Callable[..., Any],
    network: Network,
    proc: Any,
    tmp_path: Path,
    figures: Callable[[str], None],
) -> None:
    feed = FeedImages(read_feed(street / "feed"))
    drive = [feed.read(row) for row in range(80)]
    there_and_back = itertools.cycle([*drive, *drive[-2:0:-1]])
    config = write_config(telemetry={"emit": "external_position"}, acceptance={"hold_off_s": 1.0})
    bench = make_bench(config, network=network)
    began_s, told = time.monotonic(), []
    at, resident = [], []
    descriptors = 0
    for number in range(frames):
        bench.step(next(there_and_back), number)
        told.append(len(bench.autopilot.received))
        bench.autopilot.received.clear()  # the simulated autopilot keeps what it has heard
        bench.autopilot.resets.clear()
        told = [sum(told)]
        if number == WARM_UP // 2:
            descriptors = proc.open_descriptors()
        if number >= WARM_UP and number % (frames // SAMPLES) == 0:
            at.append(number)
            resident.append(proc.resident_bytes())
    slope = float(np.polyfit(at, resident, 1)[0])
    took_s = time.monotonic() - began_s
    events = len(list(records_of(tmp_path / "events.jsonl", PlaceFix)))
    figures(
        f"{frames} frames in {took_s:.0f} s, {events} events, {told[0]} messages; RSS {resident[0] / 1e6:.1f} to "
        f"{resident[-1] / 1e6:.1f} MB, {slope / 10:.2f} MB in 100,000 frames"
    )
    assert proc.open_descriptors() == descriptors
    assert events > frames / 40
    assert told[0] > frames / 5
    # Of a short run, a few pages more are already a slope.
    assert slope < SLOPE_BYTES or resident[-1] - resident[0] < 1_000_000
