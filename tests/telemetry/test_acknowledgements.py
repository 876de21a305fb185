"""What an acknowledgement means."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.acknowledgements import VERDICTS, result_name


def test_every_result_of_the_protocol_has_a_verdict() -> None:
    results = {number for number in mavlink.enums["MAV_RESULT"] if number != mavlink.MAV_RESULT_ENUM_END}
    assert results <= set(VERDICTS)
    assert VERDICTS[6] == "not now", "CANCELLED"
    assert result_name(mavlink.MAV_RESULT_TEMPORARILY_REJECTED) == "TEMPORARILY_REJECTED"
    assert result_name(99) == "99"
