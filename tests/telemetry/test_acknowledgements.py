"""What an acknowledgement means."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.acknowledgements import Command, result_name


@pytest.mark.parametrize(("name", "verdict"), [
    ("ACCEPTED", "accepted"), ("TEMPORARILY_REJECTED", "not now"), ("FAILED", "not now"), ("DENIED", "never"),
    ("UNSUPPORTED", "never"), ("IN_PROGRESS", "wait"), ("COMMAND_INT_ONLY", "never"),
])  # fmt: skip
def test_what_each_result_means(name: str, verdict: str) -> None:
    assert Command().read(getattr(mavlink, f"MAV_RESULT_{name}"), 0) == verdict


def test_a_result_that_is_not_known_is_not_now() -> None:
    assert Command().read(6, 0) == Command().read(99, 0) == "not now", "6 is CANCELLED, which the dialect lacks"
    assert result_name(mavlink.MAV_RESULT_TEMPORARILY_REJECTED) == "TEMPORARILY_REJECTED"
    assert result_name(99) == "99"
