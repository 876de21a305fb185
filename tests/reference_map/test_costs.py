"""Integer costs against the cosine distance written out."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator

import numkong
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.reference_map.costs import COST_ONE, CostMatcher, encode

DIGEST = "8d1c6d3d2cc5a06982c23e998a182b55261b74f1970d4788e23598190e7ba2c8"


def slow_costs_of_encoded(query: NDArray[np.int8], reference: NDArray[np.int8]) -> NDArray[np.int32]:
    """Both orders of encoded rows in Python's own integers, one float64 operation after another: (n, orders, N)."""
    out = np.empty((query.shape[1], len(query), reference.shape[1]), dtype=np.int32)
    wide_query, wide = query.astype(object), reference.astype(object)
    for row in range(query.shape[1]):
        for place in range(reference.shape[1]):
            dots = [int(wide_query[plane, row] @ wide[plane, place]) for plane in range(len(query))]
            lengths = [math.sqrt(max(1, int((rows**2).sum()))) for rows in (wide_query[:, row], wide[:, place])]
            scale = (1.0 / lengths[0]) * (COST_ONE / lengths[1])
            shares = [float(dot) * scale for dot in dots]
            for order, sign in enumerate((1, -1)[: len(query)]):
                rest = (COST_ONE + 0.5) - shares[0]
                out[row, order, place] = math.floor(rest - sign * shares[1] if len(shares) == 2 else rest)
    return out


def matcher_of(reference: NDArray[np.float32]) -> CostMatcher:
    encoded = encode(reference)
    return CostMatcher.of_encoded(encoded)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    places=st.integers(1, 12),
    rows=st.integers(1, 3),
    regions=st.integers(1, 2),
    dimensions=st.sampled_from([1, 63, 64, 65, 300]),
    extreme=st.booleans(),
)
def test_costs_are_exact_to_the_bit(
    seed: int, places: int, rows: int, regions: int, dimensions: int, extreme: bool
) -> None:
    """In integers of any size and Python's float64: what every machine must give, whichever kernel it has."""
    rng = np.random.default_rng(seed)
    values = (-127, 127) if extreme else np.arange(-127, 128)
    reference = rng.choice(values, (regions, places, dimensions)).astype(np.int8)
    query = rng.choice(values, (regions, rows, dimensions)).astype(np.int8)
    reference[:, rng.random(places) < 0.1] = 0
    matcher = CostMatcher.of_encoded(reference)
    expected = slow_costs_of_encoded(query, reference)
    np.testing.assert_array_equal(matcher.costs_of_encoded(query), expected)
    for row in range(rows):  # one row alone goes through another kernel than several
        np.testing.assert_array_equal(matcher.costs_of_encoded(query[:, row : row + 1])[0], expected[row])


@pytest.fixture
def kernels() -> Iterator[list[str]]:
    """The families of kernels that this processor has; on again in the end, whichever were turned off."""
    found = [name for name, on in numkong.get_capabilities().items() if on and name != "serial"]
    yield found
    for name in found:
        numkong.enable_capability(name)


@pytest.mark.parametrize("rows", [1, 4])
def test_every_kernel_gives_the_same_bits(kernels: list[str], rows: int) -> None:
    """From the newest down to plain C, as an older processor would run them."""
    rng = np.random.default_rng(rows)
    reference = rng.integers(-127, 128, (2, 300, 4096), dtype=np.int8)
    query = rng.integers(-127, 128, (2, rows, 4096), dtype=np.int8)
    matcher = CostMatcher.of_encoded(reference)
    expected = matcher.costs_of_encoded(query)
    for name in kernels:
        numkong.disable_capability(name)
        np.testing.assert_array_equal(matcher.costs_of_encoded(query), expected, err_msg=f"without {name}")
    np.testing.assert_array_equal(
        expected[:, 0], slow_costs_by_integers(query, reference, (1, 1)), err_msg="same order"
    )
    np.testing.assert_array_equal(expected[:, 1], slow_costs_by_integers(query, reference, (1, -1)), err_msg="swapped")


def test_the_same_bits_as_on_other_processors() -> None:
    """Made on x86-64 (AVX-512); Cortex-A53, A72, A76, Neoverse N1 and SVE2, emulated, gave the same."""

    def values(name: str, *shape: int) -> NDArray[np.float32]:
        numbers = hashlib.shake_256(name.encode()).digest(math.prod(shape) * 2)
        return np.frombuffer(numbers, dtype="<i2").reshape(shape).astype(np.float32)

    matcher = matcher_of(values("map", 40, 2, 4096))
    costs = matcher.costs(values("query", 5, 2, 4096))
    one = np.concatenate([matcher.costs(row[np.newaxis]) for row in values("query", 5, 2, 4096)])
    np.testing.assert_array_equal(one, costs)
    assert hashlib.sha256(costs.astype("<i4").tobytes()).hexdigest() == DIGEST


def slow_costs_by_integers(
    query: NDArray[np.int8], reference: NDArray[np.int8], signs: tuple[int, int]
) -> NDArray[np.int32]:
    """One order of encoded rows by NumPy's own 64-bit integers: (n, N)."""
    wide_query, wide = query.astype(np.int64), reference.astype(np.int64)
    scale = (1 / np.sqrt((wide_query**2).sum(axis=(0, 2))))[:, None] * (COST_ONE / np.sqrt((wide**2).sum(axis=(0, 2))))
    shares = [(wide_query[plane] @ wide[plane].T) * scale * signs[plane] for plane in range(2)]
    return np.asarray(np.floor((COST_ONE + 0.5 - shares[0]) - shares[1]), np.int32)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), cuts=st.lists(st.integers(0, 60), min_size=2, max_size=8))
def test_ranges_are_the_same_columns(seed: int, cuts: list[int]) -> None:
    rng = np.random.default_rng(seed)
    matcher = matcher_of(rng.normal(size=(60, 2, 33)).astype(np.float32))
    query = rng.normal(size=(2, 2, 33)).astype(np.float32)
    cuts = sorted(cuts)
    ranges = [(start, end) for start, end in zip(cuts[::2], cuts[1::2], strict=False) if start < end]
    if not ranges:
        return
    columns = np.concatenate([np.arange(start, end) for start, end in ranges])
    np.testing.assert_array_equal(matcher.costs(query, ranges), matcher.costs(query)[:, :, columns])


def test_extreme_values_do_not_overflow() -> None:
    reference = np.ones((3, 2, 4096), dtype=np.float32)
    reference[1] = -1
    for query in (1.0, np.finfo(np.float32).max):
        costs = matcher_of(reference).costs(np.full((1, 2, 4096), query, dtype=np.float32))
        np.testing.assert_array_equal(costs[0], [[0, 2 * COST_ONE, 0]] * 2)


def test_int8_is_close_to_float() -> None:
    rng = np.random.default_rng(0)
    reference, query = rng.normal(size=(200, 2, 4096)).astype(np.float32), rng.normal(size=(2, 4096)).astype(np.float32)
    for order, shown in enumerate((query, query[::-1])):
        flat, rows = shown.reshape(-1), reference.reshape(200, -1)
        exact = 1 - rows @ flat / (np.linalg.norm(rows, axis=1) * np.linalg.norm(flat))
        costs = matcher_of(reference).costs(query[np.newaxis])[0, order] / COST_ONE
        assert np.abs(costs - exact).max() < 2e-3


@pytest.mark.parametrize("regions", [1, 2])
@pytest.mark.parametrize("nothing", [0.0, 1e-40])
def test_a_query_without_direction_is_unrelated_to_everything(regions: int, nothing: float) -> None:
    rng = np.random.default_rng(0)
    reference = rng.normal(size=(20, regions, 64)).astype(np.float32)
    reference[4] = 0
    matcher = matcher_of(reference)
    assert (matcher.costs(np.full((1, regions, 64), nothing, dtype=np.float32)) == COST_ONE).all()
    assert (matcher.costs(rng.normal(size=(1, regions, 64)).astype(np.float32))[0, :, 4] == COST_ONE).all()


@pytest.mark.parametrize("regions", [1, 2])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_number_costs_only_its_own_dimension(bad: float, regions: int) -> None:
    rng = np.random.default_rng(0)
    matcher = matcher_of(rng.normal(size=(20, regions, 64)).astype(np.float32))
    query = rng.normal(size=(1, regions, 64)).astype(np.float32)
    spoiled, without = query.copy(), query.copy()
    spoiled[0, 0, 5], without[0, 0, 5] = bad, 0
    np.testing.assert_array_equal(matcher.costs(spoiled), matcher.costs(without))
