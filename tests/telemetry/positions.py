"""Fixes that are offered to our connection, and what a simulated autopilot gets of them."""

from __future__ import annotations

from typing import Any

from edge.config import GatesConfig
from tests.telemetry.rig import Rig

OFTEN = GatesConfig(with_gps=True, min_interval_s=0.1, risk=1.0)


def fixes_received(rig: Rig) -> list[Any]:
    return [message for message in rig.received("COMMAND_INT") if message.command == 43003]


def offer_for(rig: Rig, seconds: float, **changes: Any) -> int:
    """Offer a fix of half a second ago, or of now, whenever one is wanted; how many went."""
    sent = 0

    def offer() -> bool:
        nonlocal sent
        moment = rig.connection.position_due()
        if moment is not None:
            sent += rig.send_position(rig.fix(age_s=0.0 if moment == "now" else 0.5, **changes))
        return False

    rig.run(seconds, offer)
    return sent
