"""What is said of the way home, on maps that are unique, repeat themselves, or have gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.reference_map import ModelKey, RegionsKey
from edge_plugins.mapping.builder import Place
from edge_plugins.mapping.growing_map import GrowingMap
from edge_plugins.mapping.status import SelfComparison, WayHome

SPACING_M = 2.0


def landscape(places: int, seed: int) -> NDArray[np.float32]:
    """Raw descriptors (N, 2, D) of which neighbors are alike, as pictures a few meters apart are."""
    noise = np.random.default_rng(seed).normal(size=(places + 12, 2, 128))
    return np.stack([np.maximum(noise[row : row + 12].sum(axis=0), 0) for row in range(places)]).astype(np.float32)


def way_home(raw: NDArray[np.float32], route_m: NDArray[np.float64]) -> WayHome | None:
    growing = GrowingMap(
        Path("drive"), ModelKey("test", "0" * 64, "fc6", 128), RegionsKey("left-right", 0.4, "set"),
        SamplingConfig(), lambda rows: raw[list(rows)], capacity=len(raw),
    )  # fmt: skip
    growing.begin_segment("drive", "rear")
    comparison = SelfComparison()
    for row, one in enumerate(raw):
        growing.add(one, Place(row, 47.0 + route_m[row] / 110_800, 8.0, route_m=float(route_m[row])))
        if row % 16 == 15:
            comparison.add(growing.first(row + 1))
    return comparison.way_home(float(route_m[-1]), behind_m=150.0, line_m=80.0, drift=0.05)


def test_a_drive_that_repeats_nothing_is_recognized_from_the_first_fix_on() -> None:
    found = way_home(landscape(400, 1), SPACING_M * np.arange(0.0, 400))
    assert found is not None
    assert found.share > 0.9
    assert found.first_m == 155.0
    assert found.longest_m == pytest.approx(155.0, abs=3 * 32)
    assert found.drift_m == pytest.approx(0.05 * found.longest_m)


def test_a_stretch_that_repeats_another_counts_as_not_recognized() -> None:
    raw = landscape(400, 1)
    raw[250:380] = raw[100:230] + np.random.default_rng(2).normal(0, 0.1, (130, 2, 128)).clip(0)
    found = way_home(raw, SPACING_M * np.arange(0.0, 400))
    assert found is not None
    assert 0.5 < found.share < 0.8
    assert found.longest_m > 250.0


def test_a_gap_in_the_map_is_a_stretch_without_a_fix() -> None:
    route_m = SPACING_M * np.arange(0.0, 400)
    route_m[200:] += 500.0
    found = way_home(landscape(400, 1), route_m)
    assert found is not None
    assert found.share == pytest.approx(800 / 1300, abs=0.1)
    assert 450.0 < found.longest_m < 600.0


def test_nothing_is_said_of_nothing() -> None:
    assert way_home(landscape(20, 1), SPACING_M * np.arange(0.0, 20)) is None
