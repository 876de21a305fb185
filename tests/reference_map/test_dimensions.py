"""Descriptors of any dimension that a network may have, from the map on the disk to the recognized place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge.config import Config, SequenceConfig
from edge.descriptor.normalize import RunningStatistics
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.recognition.warm_start import PersistentTime, StateFile, StateKey
from edge.reference_map import MapSet, open_map
from edge.sequence import MotionPrior
from edge_plugins.mapping.builder import Place
from sim.maps.shrinking import shrink_to
from tests.map_of import map_of

PLACES, LENGTH = 40, 10


@pytest.mark.parametrize("regions", [2, 1])
@pytest.mark.parametrize("kept", [None, 48])
@pytest.mark.parametrize("dimensions", [64, 112, 1000, 5120, 32_768])
def test_a_drive_is_recognized(dimensions: int, kept: int | None, regions: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(dimensions)
    raw = rng.gamma(0.5, 3.0, (PLACES, regions, dimensions)).astype(np.float32)  # positive and skewed, as after ReLU
    places = [Place(row, route_m=2.0 * row) for row in range(PLACES)]
    map_of(tmp_path / "map", raw, places, shrink=shrink_to(kept or dimensions, dimensions))
    reference_map = open_map(tmp_path / "map", every_file=True)
    assert reference_map.descriptors.shape == (regions, PLACES, kept or dimensions)

    config = Config(sequence=SequenceConfig(length=LENGTH))
    matcher = SequenceMatcher(MapSet.of(reference_map), config)
    noisy = raw + rng.normal(0, 1.0, raw.shape).astype(np.float32)
    matches = [matcher.push(one, MotionPrior(2.0 * row)) for row, one in enumerate(noisy)]
    found = [match.place_index for match in matches[LENGTH:] if match is not None]
    assert len(found) == PLACES - LENGTH
    assert np.abs(np.array(found) - np.arange(LENGTH, PLACES)).max() <= 1

    statistics = matcher.statistics
    assert isinstance(statistics, RunningStatistics)
    file = StateFile(tmp_path / "state", StateKey("0", "tap", "left-right", 0.4, "0"), (regions, dimensions))
    file.write(statistics, PersistentTime.now())
    again = file.read(PersistentTime.now(), 60.0)
    assert again is not None
    np.testing.assert_array_equal(again.mean, statistics.mean)


def test_the_greatest_products_do_not_overflow(tmp_path: Path) -> None:
    """All values of the greatest dimension at the end of int8: the squared length has to fit int32."""
    from edge.reference_map.costs import CostMatcher, encode, squared_norms

    ones = np.ones((3, 2, 32_768), np.float32)
    ones[1] = -1
    encoded = encode(ones)
    assert squared_norms(encoded).tolist() == [32_768 * 127**2] * 3
    costs = CostMatcher.of_encoded(encoded).costs(ones[:1])
    np.testing.assert_array_equal(costs[0, 0], [0, 32_768, 0])
