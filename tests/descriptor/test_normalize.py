"""Equation 1, for a set and online, against the formula written out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.descriptor import RunningStatistics
from edge.descriptor.normalize import RENEWED_AT_ONCE, STALE_GROWTH, OnlineNormalizer, normalize


def descriptors(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Like fc6 after ReLU: (count, 2, 50), half of it zero, dimension 7 of region 0 dead, 9 stuck at 3."""
    raw = np.maximum(np.random.default_rng(seed).normal(size=(count, 2, 50)), 0).astype(np.float32)
    raw[:, 0, 7], raw[:, 0, 9] = 0, 3
    return raw


def test_statistics_of_many_at_once_are_those_of_one_after_another() -> None:
    raw = descriptors(60)
    one_by_one, in_blocks = RunningStatistics((2, 50)), RunningStatistics((2, 50))
    for row in raw:
        one_by_one.update(row)
    for start, end in ((0, 1), (1, 1), (1, 20), (20, 60)):
        in_blocks.update_all(raw[start:end])
    np.testing.assert_allclose(in_blocks.mean, one_by_one.mean, rtol=1e-12)
    np.testing.assert_allclose(in_blocks.deviation, one_by_one.deviation, rtol=1e-12, atol=1e-12)
    assert in_blocks.count == one_by_one.count


def nsd(raw: NDArray[np.float32]) -> NDArray[np.float64]:
    """Equation 1 over a whole set."""
    mean, deviation = raw.mean(axis=0, dtype=np.float64), raw.std(axis=0, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.nan_to_num((raw - mean) / deviation, nan=0.0, posinf=0.0, neginf=0.0))


def test_dead_and_stuck_dimensions_count_for_nothing() -> None:
    raw = descriptors(30)
    normalized = normalize(raw, raw.mean(axis=0, dtype=np.float64), raw.std(axis=0, dtype=np.float64))
    assert (normalized[:, 0, [7, 9]] == 0).all()
    np.testing.assert_allclose(normalized, nsd(raw), atol=1e-4)


def test_stale_rows_of_the_ring_are_normalized_again_with_the_newest_statistics() -> None:
    raw = descriptors(400)
    online = OnlineNormalizer(10)
    ring: list[tuple[int, NDArray[np.float32]]] = []  # when it was last normalized, and the row
    for count, row in enumerate(raw, start=1):
        change = online.push(row)
        expected = nsd(raw[:count])
        assert len(change.ages) <= 1 + RENEWED_AT_ONCE
        ring = [*ring, (0, row)][-10:]
        for age, normalized in zip(change.ages, change.rows, strict=True):
            np.testing.assert_allclose(normalized, expected[count - 1 - age], atol=1e-3)
            ring[-1 - age] = count, normalized
        np.testing.assert_array_equal(online.rows(), np.stack([normalized for _, normalized in ring]))
        if count > 20:  # five at once are enough for ten rows in two renewals, each three frames apart
            assert min(when for when, _ in ring) >= min(count - 8, count / (1 + STALE_GROWTH) - 8)
    renewals = [online.push(row).ages for row in descriptors(40, seed=1)]
    assert sum(len(ages) > 1 for ages in renewals) <= 10  # of forty frames
