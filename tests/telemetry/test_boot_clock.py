"""The boot clock against autopilots whose clock, and delays, are known."""

from __future__ import annotations

import random

import pytest

from edge.telemetry.boot_clock import BootClock

MS = 1_000_000
S = 1000 * MS
AHEAD_NS = 100 * S


def error_ms(clock: BootClock, now_ns: int, boot_ns: int) -> float:
    estimate_ns = clock.boot_ns(now_ns)
    assert estimate_ns is not None
    return (estimate_ns - boot_ns) / MS


def test_streams_alone_are_as_good_as_their_quickest_message() -> None:
    clock, delays = BootClock(), random.Random(3)
    for now_ns in range(S, 20 * S, 20 * MS):
        clock.add_stamp(now_ns + AHEAD_NS - delays.randrange(1, 60) * MS, now_ns)
        if now_ns > 2 * S:
            assert -30 < error_ms(clock, now_ns, now_ns + AHEAD_NS) <= -1
    assert clock.monotonic_ns(S + AHEAD_NS) == pytest.approx(S, abs=30 * MS)


def test_answers_that_are_read_late_halve_the_error_of_streams() -> None:
    clock = BootClock()
    for sent_ns in range(S, 10 * S, S // 2):
        clock.add_answer(sent_ns, sent_ns + 2 * MS + AHEAD_NS, sent_ns + 42 * MS)
    assert error_ms(clock, 10 * S, 10 * S + AHEAD_NS) == pytest.approx((-40 + 2) / 2)


def test_streams_that_are_read_at_once_mend_answers_that_are_read_late() -> None:
    clock = BootClock()
    for sent_ns in range(S, 10 * S, S // 2):
        clock.add_answer(sent_ns, sent_ns + 2 * MS + AHEAD_NS, sent_ns + 42 * MS)
        clock.add_stamp(sent_ns + 50 * MS + AHEAD_NS, sent_ns + 51 * MS)
    assert error_ms(clock, 10 * S, 10 * S + AHEAD_NS) == pytest.approx((-1 + 2) / 2)


@pytest.mark.parametrize("off_ns", [-3 * S, 3 * S])
def test_answers_of_another_clock_than_that_of_the_messages_change_nothing(off_ns: int) -> None:
    """Also the first ones, which come before any message: 3 s ahead, they put it off by 1.5 s for a whole drive."""
    clock = BootClock()
    for sent_ns in range(S, 10 * S, S // 2):
        clock.requested(sent_ns)
        clock.read_timesync(sent_ns + AHEAD_NS + off_ns, sent_ns, sent_ns + 20 * MS)
        for late_ms in range(20, 500, 100):
            now_ns = sent_ns + late_ms * MS
            clock.read_stamp((now_ns + AHEAD_NS) // MS - 5, now_ns)
    assert error_ms(clock, 10 * S, 10 * S + AHEAD_NS) == pytest.approx(-5)


@pytest.mark.parametrize("rate", [0.9925, 1.0075])
def test_a_clock_that_drifts_by_as_much_as_a_simulated_one_is_followed(rate: float) -> None:
    clock = BootClock()
    for now_ns in range(S, 60 * S, 10 * MS):
        boot_ns = round(now_ns * rate) + AHEAD_NS
        if now_ns > 3 * S:
            assert abs(error_ms(clock, now_ns, boot_ns)) < 8
        clock.add_stamp(boot_ns - MS, now_ns)
        if now_ns % (S // 2) == 0:
            clock.add_answer(now_ns - 4 * MS, boot_ns - 2 * MS, now_ns)


TURN_MS = 2**32


def test_a_stamp_minutes_from_each_turn_is_of_another_boot() -> None:
    clock = BootClock()
    clock.add_stamp((TURN_MS + 5 * 60_000) * MS, S)
    assert clock.unwrapped_ms(0, S) == 0
    assert clock.unwrapped_ms(4 * 60_000 + 30_000, S) == TURN_MS + 4 * 60_000 + 30_000
