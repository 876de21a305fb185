"""Fixes that are offered to our connection, GPS that is wrong, and what a simulated autopilot gets of them."""

from __future__ import annotations

from typing import Any

from edge.config import GatesConfig
from edge.localization import GpsVerdict
from sim.vehicle.gps import GpsReport
from tests.telemetry.rig import OpenRig, Rig

OFF_M = 60.0
AGREES, WRONG = GpsVerdict("consistent", (0.5, 0.5), 0.0), GpsVerdict("faulty", (OFF_M, 0.0), 1.0)


def spoofed(open_rig: OpenRig, doubted_gps: Any, **options: Any) -> Rig:
    """GPS has been healthy for 10 s, and is 60 m too far to the east from then on."""
    gates = GatesConfig(doubted_gps=doubted_gps, min_move_m=0.0, **options.pop("gates", {}))
    rig = open_rig(gates=gates, **{"emit": "external_position", **options})
    rig.autopilot._gps_at = lambda now_s: GpsReport(east_off_m=rig.off_m)
    rig.run(8.0)
    rig.judge_gps(AGREES)
    rig.off_m = OFF_M
    rig.run(2.0)
    return rig


def fixes_received(rig: Rig) -> list[Any]:
    return [message for message in rig.received("COMMAND_INT") if message.command == 43003]


def offer_for(rig: Rig, seconds: float, **changes: Any) -> int:
    """Offer a fix of half a second ago, or of now, whenever one is wanted; how many went."""
    sent = 0

    def offer() -> bool:
        nonlocal sent
        limits = rig.connection.position_due()
        if limits is not None:
            sent += rig.send_position(rig.fix(age_s=0.0 if limits.at == "now" else 0.5, **changes))
        return False

    rig.run(seconds, offer)
    return sent
