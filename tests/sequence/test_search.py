"""The running sums against equations 2 and 3 written out, for every direction, order, slope, gap and refill."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.reference_map import COST_ONE
from edge.sequence import Alignment
from edge.sequence.search import NO_LINE, SequenceSearch, slopes_around_diagonal

ONE_REGION: list[Alignment] = [("forward", "same"), ("reverse", "same")]
ALL_PLANES: list[Alignment] = [("forward", "same"), ("forward", "swapped"), ("reverse", "same"), ("reverse", "swapped")]


def direct_lines(
    rows: list[NDArray[np.int32]],
    driven: Sequence[float],
    segments: list[tuple[int, int]],
    slopes: tuple[float, ...],
    planes: list[Alignment],
) -> NDArray[np.int64]:
    """Equation 2 for each plane and place, cell by cell: (planes, N). driven: in places, at the newest rows."""
    places = rows[0].shape[1]
    out = np.full((len(planes), places), NO_LINE, dtype=np.int64)
    segment_of = np.repeat(np.arange(len(segments)), [end - start for start, end in segments])
    for plane, (direction, order) in enumerate(planes):
        sign = 1 if direction == "forward" else -1
        for place in range(places):
            for slope in slopes:
                total = 0
                for age, row in enumerate(rows[::-1]):
                    passed = math.floor(slope * driven[-1] + 0.5) - math.floor(slope * driven[-1 - age] + 0.5)
                    at = place - sign * passed
                    if not 0 <= at < places or segment_of[at] != segment_of[place]:
                        break
                    total += int(row[("same", "swapped").index(order), at])
                else:
                    out[plane, place] = min(out[plane, place], total)
    return out


def searched_lines(search: SequenceSearch, length: int | None = None) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    lines = search.lines(length=length)
    assert lines is not None
    return lines.costs, np.array([lines.plane(place) for place in range(len(lines.costs))])


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    lengths=st.lists(st.integers(1, 25), min_size=1, max_size=4),
    length=st.integers(2, 9),
    shorter=st.integers(1, 8),
    asked=st.sampled_from([0.0, 0.8, 1.0]),
    slopes=st.integers(1, 7),
    planes=st.lists(st.sampled_from(ALL_PLANES), min_size=1, max_size=4, unique=True),
    frames=st.integers(0, 30),
    refill_at=st.integers(0, 30),
    steps=st.sampled_from([(1.0, 1.0), (2.0, 2.0), (0.5, 0.5), (0.1, 2.7)]),
)
def test_running_sums_are_the_direct_sums(
    seed: int,
    lengths: list[int],
    length: int,
    shorter: int,
    asked: float,
    slopes: int,
    planes: list[Alignment],
    frames: int,
    refill_at: int,
    steps: tuple[float, float],
) -> None:
    """Also where frames are two places, half a place, or any distance apart; shorter lines were asked for or not."""
    rng, shorter = np.random.default_rng(seed), min(shorter, length - 1)
    driven = np.cumsum(rng.uniform(*steps, length + frames)).tolist()
    ends = np.cumsum(lengths).tolist()
    segments = list(zip([0, *ends[:-1]], ends, strict=True))
    all_slopes = slopes_around_diagonal(0.3, slopes)
    possible = rng.random((len(planes), ends[-1])) < 0.9
    search = SequenceSearch(segments, planes, length, all_slopes, possible, span=2.7 * length, shorter=shorter)
    rows: list[NDArray[np.int32]] = []
    for frame in range(length + frames):
        rows = [*rows, rng.integers(0, 2**15 + 1, (2, ends[-1]), dtype=np.int32)][-length:]
        if frame == refill_at:  # the whole ring normalized again: every row is new
            rows = [rng.integers(0, 2**15 + 1, row.shape, dtype=np.int32) for row in rows]
            search.refill(np.stack(rows), driven[: frame + 1][-length:])
        else:
            search.push(rows[-1], driven[frame])
        for age in rng.integers(0, len(rows), int(rng.integers(0, 4))).tolist():  # some normalized again
            rows[-1 - age] = rng.integers(0, 2**15 + 1, rows[0].shape, dtype=np.int32)
            search.replace(age, rows[-1 - age])
        if len(rows) < length:
            assert search.lines() is None
        if rng.random() < asked:
            search.lines(length=shorter)
    for few in (length, shorter):
        recent = rows[-few:], driven[-few:], segments
        direct = direct_lines(*recent, all_slopes, planes)
        direct[~possible] = NO_LINE
        costs, which = searched_lines(search, few)
        np.testing.assert_array_equal(costs, direct.min(axis=0))
        np.testing.assert_array_equal(direct[which, np.arange(ends[-1])], costs)
        for place in np.flatnonzero(costs < NO_LINE) if few > 1 else ():
            of_plane = planes[which[place]]
            passed = search.passed(int(which[place]), int(place), few)
            of_slope = min(all_slopes, key=lambda slope: abs(slope - passed[-1] / (driven[-1] - driven[-few])))
            np.testing.assert_allclose(passed, of_slope * (driven[-1] - np.array(recent[1][::-1])), atol=1e-9)
            again = direct_lines(*recent, (of_slope,), [of_plane])
            assert again[0, place] == costs[place]


@pytest.mark.parametrize("start", [10**9, 2**31 - 20, 2**32 - 20, 2**40])
def test_still_exact_after_years_and_where_counters_of_32_bits_would_wrap(start: int) -> None:
    rng = np.random.default_rng(1)
    slopes = slopes_around_diagonal(0.2, 5)
    search = SequenceSearch([(0, 40)], ONE_REGION, 6, slopes)
    rows = [rng.integers(0, 2**15, (1, 40), dtype=np.int32) for _ in range(50)]
    search.refill(np.stack(rows[:1]), [float(start)])
    for frame, row in enumerate(rows[1:], start=1):
        search.push(row, float(start + frame))
    np.testing.assert_array_equal(
        searched_lines(search)[0],
        direct_lines(rows[-6:], range(start, start + 50), [(0, 40)], slopes, ONE_REGION).min(axis=0),
    )


@pytest.mark.parametrize("slope_limit_rad", [0.2, 0.6])
def test_exact_for_thousands_of_frames_through_gaps_and_ends(slope_limit_rad: float) -> None:
    """So many that the sums have come to the end of their memory and begun again several times."""
    rng = np.random.default_rng(5)
    segments, length = [(0, 17), (17, 20), (20, 60)], 7
    slopes = slopes_around_diagonal(slope_limit_rad, 5)
    search = SequenceSearch(segments, ALL_PLANES, length, slopes)
    rows: list[NDArray[np.int32]] = []
    for frame in range(4001):
        rows = [*rows, rng.integers(0, 2**15 + 1, (2, 60), dtype=np.int32)][-length:]
        search.push(rows[-1])
        if frame % 800 == 799 or frame in (1000, 1001, 1002):
            direct = direct_lines(rows, range(frame + 2), segments, slopes, ALL_PLANES)
            np.testing.assert_array_equal(searched_lines(search)[0], direct.min(axis=0))


def test_the_largest_costs_of_the_longest_sequence_fit() -> None:
    search = SequenceSearch([(0, 1000)], ONE_REGION, 500, (1.0,))
    for _ in range(600):
        search.push(np.full((1, 1000), 1 << 15, dtype=np.int32))
    costs, _ = searched_lines(search)
    assert set(costs.tolist()) == {500 << 15}


def test_after_clear_a_line_needs_all_its_frames_again() -> None:
    rng = np.random.default_rng(2)
    search = SequenceSearch([(0, 30)], ALL_PLANES, 4, (1.0,))
    rows = [rng.integers(0, 2**15, (2, 30), dtype=np.int32) for _ in range(9)]
    for row in rows[:5]:
        search.push(row)
    search.clear()
    for row in rows[5:8]:
        search.push(row)
        assert search.lines() is None
    search.push(rows[8])
    direct = direct_lines(rows[5:], range(10), [(0, 30)], (1.0,), ALL_PLANES)
    np.testing.assert_array_equal(searched_lines(search)[0], direct.min(axis=0))


def test_slopes_of_the_paper() -> None:
    slopes = slopes_around_diagonal(0.2, 21)
    assert slopes[0] == pytest.approx(0.663, abs=5e-4)
    assert slopes[10] == pytest.approx(1.0)
    assert slopes[-1] == pytest.approx(1.508, abs=5e-4)
    assert len({math.floor(slope * 40 + 0.5) for slope in slopes_around_diagonal(0.2, 101)}) == 34


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    lengths=st.lists(st.integers(1, 25), min_size=1, max_size=3),
    longer=st.integers(0, 12),
    further=st.lists(st.integers(1, 12), max_size=2),
    length=st.integers(2, 9),
    slopes=st.integers(1, 7),
    planes=st.lists(st.sampled_from(ALL_PLANES), min_size=1, max_size=4, unique=True),
    frames=st.integers(1, 20),
)
def test_a_search_that_grows_is_one_that_always_had_all_places(
    seed: int,
    lengths: list[int],
    longer: int,
    further: list[int],
    length: int,
    slopes: int,
    planes: list[Alignment],
    frames: int,
) -> None:
    """To the bit, at once and with every frame after it, whether or not the ring was full."""
    rng = np.random.default_rng(seed)
    all_slopes = slopes_around_diagonal(0.3, slopes)
    begin = list(itertools.pairwise(np.cumsum([0, *lengths]).tolist()))
    segments = list(itertools.pairwise(np.cumsum([0, *lengths[:-1], lengths[-1] + longer, *further]).tolist()))
    places = segments[-1][1]
    whole = SequenceSearch(segments, planes, length, all_slopes, span=2 * length, open_ends=True)
    part = SequenceSearch(begin, planes, length, all_slopes, span=2 * length, open_ends=True)
    driven = np.cumsum(rng.uniform(0.5, 2.0, frames + length)).tolist()
    rows: list[NDArray[np.int32]] = []
    for frame in range(frames + length):
        row = rng.integers(0, 2**15 + 1, (2, places), dtype=np.int32)
        rows = [*rows, row][-length:]
        whole.push(row, driven[frame])
        part.push(row if frame > frames else row[:, : sum(lengths)], driven[frame])
        if frame == frames:
            begun, part = part, SequenceSearch(segments, planes, length, all_slopes, span=2 * length, open_ends=True)
            part.take_over(begun, np.stack(rows)[:, :, sum(lengths) :])
        if frame >= frames:
            one, other = whole.lines(), part.lines()
            assert (one is None) == (other is None)
            if one is not None and other is not None:
                np.testing.assert_array_equal(np.stack(one.by_plane), np.stack(other.by_plane))


@pytest.mark.parametrize("open_ends", [False, True])
def test_a_vehicle_that_comes_from_before_the_map_is_found_as_if_nothing_had_been_refilled(open_ends: bool) -> None:
    rng, length, places = np.random.default_rng(5), 20, 60
    slopes = slopes_around_diagonal(0.2, 5)
    pushed, refilled = (
        SequenceSearch([(0, places)], ALL_PLANES, length, slopes, open_ends=open_ends) for _ in range(2)
    )
    rows = rng.integers(0, 2**15 + 1, (4 * length, 2, places), dtype=np.int32)
    for frame, row in enumerate(rows):
        pushed.push(row, frame)
        if frame == length:
            refilled.refill(rows[1 : length + 1], range(1, length + 1))
        elif frame > length:
            refilled.push(row, frame)
            for one, other in zip(searched_lines(pushed), searched_lines(refilled), strict=True):
                np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("overlap", [-1, 0, 3])
def test_lines_on_a_closed_drive_are_those_on_one_that_was_driven_three_times(overlap: int) -> None:
    rng, length, lap = np.random.default_rng(2), 9, 30
    slopes = slopes_around_diagonal(0.2, 5)
    places = lap + overlap
    search = SequenceSearch([(0, places)], ALL_PLANES, length, slopes, open_ends=True, laps=[lap])
    thrice = SequenceSearch([(0, 3 * lap)], ALL_PLANES, length, slopes, open_ends=True)
    for _ in range(2 * length):
        row = rng.integers(0, 2**15 + 1, (2, lap), dtype=np.int32)
        repeated = np.tile(row, 3)
        if overlap < 0:  # one place of the lap is in no map
            repeated[:, lap - 1 :: lap] = COST_ONE
        search.push(repeated[:, :places])
        thrice.push(repeated)
    of_one, of_three = searched_lines(search)[0], searched_lines(thrice)[0]
    np.testing.assert_array_equal(of_one, of_three[lap : lap + places])
