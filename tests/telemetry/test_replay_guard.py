"""Which signed frames are new: rule by rule, and over crashes, held against a list of all that was taken."""

from __future__ import annotations

import random

import pytest

from edge.telemetry.codec import Stream
from edge.telemetry.signing import MINUTE_TICKS, TICKS_PER_S, ReplayGuard

NOW = 10**13
AUTOPILOT: Stream = (0, 1, 1)
OTHER_WAY: Stream = (1, 1, 1)
GROUND: Stream = (0, 255, 190)


class Clock:
    """CLOCK_MONOTONIC, moved by hand."""

    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> int:
        return round(self.s * 1e9)


def test_each_stream_only_rises() -> None:
    guard = ReplayGuard({}, Clock())
    assert guard.accept(AUTOPILOT, NOW, NOW)
    assert not guard.accept(AUTOPILOT, NOW, NOW)
    assert not guard.accept(AUTOPILOT, NOW - 1, NOW)
    assert guard.accept(GROUND, NOW - 5, NOW), "another's clock is its own"
    assert guard.accept(AUTOPILOT, NOW + 1, NOW)


@pytest.mark.parametrize(("behind_s", "taken"), [(59.0, True), (61.0, False)])
def test_a_new_stream_is_a_minute_behind_at_most(behind_s: float, taken: bool) -> None:
    assert ReplayGuard({}, Clock()).accept(AUTOPILOT, NOW - round(behind_s * TICKS_PER_S), NOW) is taken


def test_what_was_sent_over_one_link_is_not_taken_later_over_another() -> None:
    guard = ReplayGuard({}, Clock())
    assert guard.accept(AUTOPILOT, NOW, NOW)
    assert not guard.accept(OTHER_WAY, NOW - 1, NOW)
    assert guard.accept(OTHER_WAY, NOW + 1, NOW)
    assert guard.accept(AUTOPILOT, NOW + 1, NOW), "once both are known, each has its own time"


def test_what_was_recorded_while_nothing_was_heard_is_stale_when_a_minute_has_gone() -> None:
    clock = Clock()
    guard = ReplayGuard({}, clock)
    assert guard.accept(AUTOPILOT, NOW, NOW)
    clock.s += 600.0
    now = NOW + 600 * TICKS_PER_S
    assert not guard.accept(AUTOPILOT, NOW + 100 * TICKS_PER_S, now)
    assert guard.accept(AUTOPILOT, now - 1, now)


def test_a_slow_clock_is_no_reason_to_lose_a_stream_that_goes_on() -> None:
    """Ours was stepped by an hour: the sender, who will follow what we sign, still has the old time."""
    guard = ReplayGuard({}, Clock())
    assert guard.accept(AUTOPILOT, NOW, NOW)
    assert guard.accept(AUTOPILOT, NOW + 1, NOW + 60 * MINUTE_TICKS)


def test_a_frame_from_the_future_leaves_no_trace() -> None:
    guard = ReplayGuard({}, Clock())
    assert not guard.accept(AUTOPILOT, NOW + 2 * MINUTE_TICKS, NOW)
    assert guard.timestamps(0) == {}
    assert guard.accept(AUTOPILOT, NOW, NOW)


def test_frames_from_the_future_whose_time_runs_otherwise_than_ours_are_not_believed() -> None:
    clock = Clock()
    guard = ReplayGuard({}, clock)
    for second in range(10):
        now = NOW + second * TICKS_PER_S
        assert not guard.accept(AUTOPILOT, NOW + 2 * MINUTE_TICKS + 3 * second * TICKS_PER_S, now)
        clock.s += 1.0


def test_only_what_was_heard_is_kept_ahead() -> None:
    guard = ReplayGuard({AUTOPILOT: NOW, GROUND: NOW}, Clock())
    assert guard.accept(AUTOPILOT, NOW + 1, NOW)
    assert guard.timestamps(7) == {AUTOPILOT: NOW + 8, GROUND: NOW}


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_ever_taken_twice(seed: int) -> None:
    """Two streams, 400 moments, a crash at one in twenty, and all that was ever sent may come again at any time."""
    rng, clock, ahead = random.Random(seed), Clock(), 10 * TICKS_PER_S
    kept: dict[Stream, int] = {}
    guard = ReplayGuard(kept, clock)
    sent: list[tuple[Stream, int]] = []
    taken: list[tuple[Stream, int]] = []
    for _ in range(400):
        clock.s += rng.choice([0.01, 0.5, 5.0])
        now = round(clock.s * TICKS_PER_S)
        if rng.random() < 0.05:
            guard = ReplayGuard(kept, clock)
        sent.append((rng.choice([AUTOPILOT, GROUND]), now))
        for stream, timestamp in [sent[-1], rng.choice(sent), rng.choice(sent[-5:])]:
            if guard.accept(stream, timestamp, now):
                if timestamp > kept.get(stream, 0):
                    kept = guard.timestamps(ahead)
                taken.append((stream, timestamp))
    assert len(taken) == len(set(taken))
    assert len(taken) > 150
