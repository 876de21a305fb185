"""Hours of mapping at five places a second: memory and work for each place stay as they are, but for the map itself."""

from __future__ import annotations

import gc
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.config import SamplingConfig
from edge.reference_map import ModelKey, RegionsKey
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.drive_store import DriveStore
from edge_plugins.mapping.live_map import LiveMap
from edge_plugins.mapping.place_log_records import LogHeader
from tests.faults.mapping_loop import GPS

pytestmark = pytest.mark.long

DIMENSIONS = 128
TEN_HOURS = 10 * 3600 * 5
PLACE_BYTES = 2 * DIMENSIONS + 100 + 200
"""Of the map itself: the descriptor, the place, and where it lies in the file."""
BLOCKS_PER_PLACE = 4.0
"""Objects of Python: the numbers that say where the place lies in the file."""


@pytest.mark.parametrize("places", [3000, pytest.param(TEN_HOURS, marks=pytest.mark.soak)])
def test_ten_hours_of_mapping(places: int, tmp_path: Path, proc: Any, figures: Callable[[str], None]) -> None:
    header = LogHeader(ModelKey("test", "0" * 64, "fc6", DIMENSIONS), RegionsKey("left-right", 0.4), SamplingConfig())
    config = MappingConfig(folder=str(tmp_path / "maps"), min_free_mb=0.0)
    mapped = LiveMap(config, DriveStore(config, header, "rear"))
    raw = np.abs(np.random.default_rng(0).normal(size=(97, 2, DIMENSIONS))).astype(np.float32)
    image = np.full((48, 64, 3), 90, np.uint8)
    marks = []
    began_s, busy_s = time.monotonic(), 0.0
    for row in range(places):
        while mapped.store.waiting > 8:
            os.sched_yield()
        start_s = time.thread_time()
        position = replace(GPS, lat_deg=47.0 + row * 2 / 110_800 % 1.0)
        mapped.add(raw[row % len(raw)], image, position, row * 2.0)
        mapped.newly_searchable(row * 2.0)
        busy_s += time.thread_time() - start_s
        if row + 1 in (places // 3, 2 * places // 3, places):
            gc.collect()
            marks.append((row + 1, sys.getallocatedblocks(), proc.resident_bytes(), busy_s))
    first, second, last = marks
    blocks = (last[1] - second[1]) / (last[0] - second[0])
    grown_bytes = (last[2] - second[2]) / (last[0] - second[0])
    early_ms, late_ms = (
        1e3 * (to[3] - since[3]) / (to[0] - since[0]) for since, to in ((first, second), (second, last))
    )
    figures(
        f"{places} places in {time.monotonic() - began_s:.0f} s; {blocks:.2f} objects and {grown_bytes:.0f} bytes (RSS)"
        f" more a place, {early_ms:.2f} ms a place in the second third, {late_ms:.2f} in the last"
    )
    assert mapped.status.places == places
    assert blocks < BLOCKS_PER_PLACE
    if places > TEN_HOURS / 2:  # of a short run, one page more is already a slope
        assert grown_bytes < PLACE_BYTES
    mapped.store.close()
