"""What an acknowledgement means, and whether a position has moved as an accepted fix says."""

from __future__ import annotations

from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import common as mavlink

from edge.geodesy import VehiclePosition
from edge.telemetry.acknowledgements import VERDICTS, Jump, result_name

S = 1_000_000_000
METRE_DEG = 1 / 110_574  # of latitude, at the equator
BEFORE = VehiclePosition(10 * S, 0.0, 10.0, 20.0, 0.0, 10.0, north_mps=10.0)
JUMP = Jump(BEFORE, east_m=0.0, north_m=40.0, sigma_m=5.0)


def after(seconds: float, north_m: float) -> VehiclePosition:
    return replace(BEFORE, stamp_ns=BEFORE.stamp_ns + round(seconds * S), lat_deg=north_m * METRE_DEG)


def test_every_result_of_the_protocol_has_a_verdict() -> None:
    results = {number for number in mavlink.enums["MAV_RESULT"] if number != mavlink.MAV_RESULT_ENUM_END}
    assert results <= set(VERDICTS)
    assert VERDICTS[6] == "not now", "CANCELLED"
    assert result_name(mavlink.MAV_RESULT_TEMPORARILY_REJECTED) == "TEMPORARILY_REJECTED"
    assert result_name(99) == "99"


@pytest.mark.parametrize(
    ("north_m", "remaining_m", "happened"),
    [(50.0, 0.0, True), (30.5, 19.5, True), (29.0, 21.0, False), (10.0, 40.0, False)],
)
def test_a_jump_is_the_move_that_driving_does_not_explain(north_m: float, remaining_m: float, happened: bool) -> None:
    a_second_later = after(1.0, north_m)
    assert JUMP.remaining_m(a_second_later) == pytest.approx(remaining_m, abs=0.05)
    assert JUMP.happened(a_second_later) is happened


def test_a_jump_within_the_fixs_own_deviation_has_always_happened() -> None:
    assert replace(JUMP, north_m=4.0).happened(after(1.0, 10.0))
