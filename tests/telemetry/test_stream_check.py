"""Whether a stream of positions is used, by distances that are given by hand."""

from __future__ import annotations

import pytest

from edge.telemetry.stream_check import StreamCheck
from edge.telemetry.vehicle import Vehicle

S = 1_000_000_000
SIGMA_M = 2.0


def verdicts(distances_m: list[float], check: StreamCheck, from_s: int = 100) -> list[tuple[int, bool]]:
    """What is said at which second, of one position a second."""
    said = [(second, check.add(far_m, SIGMA_M, (from_s + second) * S)) for second, far_m in enumerate(distances_m)]
    return [(second, verdict) for second, verdict in said if verdict is not None]


@pytest.mark.parametrize(("far_m", "later_m", "is_used"), [(25.0, 25.0, False), (25.0, 12.0, True), (5.0, 1.9, True)])
def test_an_autopilot_that_is_far_must_come_nearer(far_m: float, later_m: float, is_used: bool) -> None:
    assert verdicts([far_m] * 5 + [later_m] * 10, StreamCheck(Vehicle(), 1)) == [(10, is_used)]


def test_one_that_drifts_away_from_the_positions_does_not_use_them() -> None:
    """It is near at first, which says nothing: the autopilot has just lost GPS."""
    assert verdicts([0.3 * second for second in range(60)], StreamCheck(Vehicle(), 1)) == [(30, False)]


def test_one_that_stays_near_says_nothing() -> None:
    assert verdicts([1.0, 3.0, 2.0] * 40, StreamCheck(Vehicle(), 1)) == []


def test_each_stream_is_checked_anew() -> None:
    check = StreamCheck(Vehicle(), 1)
    assert verdicts([25.0] * 30, check) == [(10, False)]
    assert verdicts([25.0] * 30, check, from_s=200) == [(10, False)]
