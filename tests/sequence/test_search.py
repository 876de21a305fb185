"""The running sums against equations 2 and 3 written out, for every direction, order, slope, gap and refill."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.sequence.search import NO_LINE, SequenceSearch, slopes_around_diagonal

DIRECTIONS = ("forward", "reverse")


def direct_lines(
    rows: list[NDArray[np.int32]], first_frame: int, segments: list[tuple[int, int]], slopes: tuple[float, ...]
) -> NDArray[np.int32]:
    """Equation 2 for each plane and place, cell by cell: (planes, N), planes as forward then reverse."""
    orders, places = rows[0].shape
    last = first_frame + len(rows) - 1
    out = np.full((2 * orders, places), NO_LINE, dtype=np.int64)
    segment_of = np.repeat(np.arange(len(segments)), [end - start for start, end in segments])
    for plane in range(2 * orders):
        sign = 1 if plane < orders else -1
        for place in range(places):
            for slope in slopes:
                total = 0
                for age, row in enumerate(rows[::-1]):
                    passed = math.floor(slope * last + 0.5) - math.floor(slope * (last - age) + 0.5)
                    at = place - sign * passed
                    if not 0 <= at < places or segment_of[at] != segment_of[place]:
                        break
                    total += int(row[plane % orders, at])
                else:
                    out[plane, place] = min(out[plane, place], total)
    return out


def searched_lines(search: SequenceSearch) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    lines = search.lines()
    assert lines is not None
    return lines.costs, lines.planes


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    lengths=st.lists(st.integers(1, 25), min_size=1, max_size=4),
    length=st.integers(2, 9),
    slopes=st.integers(1, 7),
    orders=st.integers(1, 2),
    frames=st.integers(0, 30),
    refill_at=st.integers(0, 30),
)
def test_running_sums_are_the_direct_sums(
    seed: int, lengths: list[int], length: int, slopes: int, orders: int, frames: int, refill_at: int
) -> None:
    rng = np.random.default_rng(seed)
    ends = np.cumsum(lengths).tolist()
    segments = list(zip([0, *ends[:-1]], ends, strict=True))
    all_slopes = slopes_around_diagonal(0.3, slopes)
    search = SequenceSearch(segments, orders, length, all_slopes, DIRECTIONS)
    rows: list[NDArray[np.int32]] = []
    for frame in range(length + frames):
        rows = [*rows, rng.integers(0, 2**15 + 1, (orders, ends[-1]), dtype=np.int32)][-length:]
        if frame == refill_at:  # the whole ring normalised again: every row is new
            rows = [rng.integers(0, 2**15 + 1, row.shape, dtype=np.int32) for row in rows]
            search.refill(np.stack(rows))
        else:
            search.push(rows[-1])
        if len(rows) < length:
            assert search.lines() is None
    direct = direct_lines(rows, frames + 1, segments, all_slopes)
    costs, planes = searched_lines(search)
    np.testing.assert_array_equal(costs, direct.min(axis=0))
    np.testing.assert_array_equal(direct[planes, np.arange(ends[-1])], costs)


def test_still_exact_after_a_billion_frames() -> None:
    rng = np.random.default_rng(1)
    slopes = slopes_around_diagonal(0.2, 5)
    search = SequenceSearch([(0, 40)], 1, 6, slopes, DIRECTIONS)
    start = 10**9
    search._frame = start - 1  # months of driving
    rows = [rng.integers(0, 2**15, (1, 40), dtype=np.int32) for _ in range(50)]
    for row in rows:
        search.push(row)
    np.testing.assert_array_equal(
        searched_lines(search)[0], direct_lines(rows[-6:], start + 44, [(0, 40)], slopes).min(axis=0)
    )


def test_after_clear_a_line_needs_all_its_frames_again() -> None:
    rng = np.random.default_rng(2)
    search = SequenceSearch([(0, 30)], 2, 4, (1.0,), DIRECTIONS)
    rows = [rng.integers(0, 2**15, (2, 30), dtype=np.int32) for _ in range(9)]
    for row in rows[:5]:
        search.push(row)
    search.clear()
    for row in rows[5:8]:
        search.push(row)
        assert search.lines() is None
    search.push(rows[8])
    np.testing.assert_array_equal(searched_lines(search)[0], direct_lines(rows[5:], 6, [(0, 30)], (1.0,)).min(axis=0))


def test_no_line_where_the_map_is_shorter_than_the_sequence() -> None:
    search = SequenceSearch([(0, 3), (3, 6)], 1, 5, (1.0,), DIRECTIONS)
    for _ in range(5):
        search.push(np.zeros((1, 6), dtype=np.int32))
    assert (searched_lines(search)[0] == NO_LINE).all()


def test_each_direction_and_order_is_told_apart() -> None:
    places, length = 50, 10
    slopes = slopes_around_diagonal(0.2, 21)
    for direction in DIRECTIONS:
        for order in (0, 1):
            search = SequenceSearch([(0, places)], 2, length, slopes, DIRECTIONS)
            for frame in range(length):
                row = np.full((2, places), 1000, dtype=np.int32)
                row[order, 20 + frame if direction == "forward" else 20 - frame] = 0
                search.push(row)
            costs, planes = searched_lines(search)
            place = int(costs.argmin())
            assert place == (20 + length - 1 if direction == "forward" else 20 - length + 1)
            assert costs[place] == 0
            assert search.planes[planes[place]] == (direction, ("same", "swapped")[order])


def test_slopes_of_the_paper() -> None:
    slopes = slopes_around_diagonal(0.2, 21)
    assert slopes[0] == pytest.approx(0.663, abs=5e-4)
    assert slopes[10] == pytest.approx(1.0)
    assert slopes[-1] == pytest.approx(1.508, abs=5e-4)
    assert len({math.floor(slope * 40 + 0.5) for slope in slopes_around_diagonal(0.2, 101)}) == 34
