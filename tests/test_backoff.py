"""Pauses that double while attempts fail."""

from __future__ import annotations

from edge.backoff import BackOff

S = 1_000_000_000


def test_there_is_no_pause_before_the_first_failure() -> None:
    assert BackOff(S, 30 * S).is_over(0)


def test_pauses_double_up_to_the_longest_and_start_short_again_after_a_success() -> None:
    back_off = BackOff(S, 30 * S)
    assert [back_off.failed(0) // S for _ in range(8)] == [1, 2, 4, 8, 16, 30, 30, 30]
    assert not back_off.is_over(30 * S - 1)
    assert back_off.is_over(30 * S)
    back_off.reset()
    assert back_off.is_over(0)
    assert back_off.failed(100 * S) == S
    assert not back_off.is_over(100 * S)
