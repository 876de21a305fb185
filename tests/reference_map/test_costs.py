"""Integer costs against the cosine distance written out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.reference_map.costs import COST_ONE, CostMatcher, quantize, squared_norms


def slow_costs(query: NDArray[np.int8], reference: NDArray[np.int8]) -> NDArray[np.int32]:
    """1 - cosine of every pair in exact integers and then float64: (n, N)."""
    dots = query.astype(np.int64) @ reference.astype(np.int64).T
    norms = np.sqrt((query.astype(np.float64) ** 2).sum(1))[:, None] * np.sqrt(
        (reference.astype(np.float64) ** 2).sum(1)
    )
    cosine = np.divide(dots, norms, out=np.zeros(dots.shape), where=norms > 0)
    return np.rint((1 - cosine) * COST_ONE).astype(np.int32)


def matcher_of(reference: NDArray[np.int8], regions: int) -> CostMatcher:
    return CostMatcher(reference, squared_norms(reference), regions)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    places=st.integers(1, 70),
    rows=st.integers(1, 9),
    regions=st.integers(1, 2),
    dimensions=st.sampled_from([1, 3, 64, 100, 257, 4096]),
)
def test_costs_are_exact_in_both_orders(seed: int, places: int, rows: int, regions: int, dimensions: int) -> None:
    rng = np.random.default_rng(seed)
    reference = quantize(rng.normal(size=(places, regions * dimensions)).astype(np.float32))
    query = rng.normal(size=(rows, regions, dimensions)).astype(np.float32)
    costs = matcher_of(reference, regions).costs(query)
    assert costs.shape == (rows, regions, places)
    quantized = quantize(query)
    np.testing.assert_array_equal(costs[:, 0], slow_costs(quantized.reshape(rows, -1), reference))
    if regions == 2:
        swapped = quantized[:, ::-1].reshape(rows, -1)
        np.testing.assert_array_equal(costs[:, 1], slow_costs(swapped, reference))


def test_extreme_values_do_not_overflow() -> None:
    reference = np.full((3, 8192), 127, dtype=np.int8)
    reference[1] = -127
    costs = matcher_of(reference, 2).costs(np.ones((1, 2, 4096), dtype=np.float32))
    np.testing.assert_array_equal(costs[0], [[0, 2 * COST_ONE, 0]] * 2)


def test_int8_is_close_to_float() -> None:
    rng = np.random.default_rng(0)
    reference, query = rng.normal(size=(200, 8192)).astype(np.float32), rng.normal(size=(1, 2, 4096)).astype(np.float32)
    flat = query.reshape(-1)
    exact = 1 - reference @ flat / (np.linalg.norm(reference, axis=1) * np.linalg.norm(flat))
    costs = matcher_of(quantize(reference), 2).costs(query)[0, 0] / COST_ONE
    assert np.abs(costs - exact).max() < 2e-3


def test_a_query_without_direction_is_unrelated_to_everything() -> None:
    rng = np.random.default_rng(0)
    reference = quantize(rng.normal(size=(20, 64)).astype(np.float32))
    reference[4] = 0
    matcher = matcher_of(reference, 1)
    assert (matcher.costs(np.zeros((1, 1, 64), dtype=np.float32)) == COST_ONE).all()
    assert matcher.costs(rng.normal(size=(1, 1, 64)).astype(np.float32))[0, 0, 4] == COST_ONE


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_number_costs_only_its_own_dimension(bad: float) -> None:
    rng = np.random.default_rng(0)
    matcher = matcher_of(quantize(rng.normal(size=(20, 64)).astype(np.float32)), 1)
    query = rng.normal(size=(1, 1, 64)).astype(np.float32)
    spoiled, without = query.copy(), query.copy()
    spoiled[0, 0, 5], without[0, 0, 5] = bad, 0
    np.testing.assert_array_equal(matcher.costs(spoiled), matcher.costs(without))
