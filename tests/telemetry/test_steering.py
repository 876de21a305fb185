"""By what the vehicle steers and what was sent, as people read it, against what the autopilot heard."""

from __future__ import annotations

from typing import Any

import pytest

from edge.config import GatesConfig
from edge.journal.records import SteeringChanged
from edge.localization import GpsVerdict
from tests.telemetry.rig import SPEED_MPS, OpenRig, Rig
from tests.telemetry.test_fused_poses import fused, poses, poses_for, texts

FAULTY = GpsVerdict("faulty", (0.0, 12.0), 1.0)


def heard(rig: Rig) -> dict[str, int]:
    """How many positions came, by the message that brought them."""
    resets = [one for one in rig.received("COMMAND_INT") if one.command == 43003]
    counts = {
        "COMMAND_INT": len(resets),
        "VISION_POSITION_ESTIMATE": len(poses(rig)),
        "GLOBAL_POSITION_SENSOR": len(rig.received("GLOBAL_POSITION_SENSOR")),
    }
    return {name: count for name, count in counts.items() if count}


def steering(rig: Rig) -> tuple[str, str]:
    status = rig.connection.status()
    return status.gps_use, status.steers_by


def test_people_read_what_has_left_and_by_what_the_vehicle_steers(open_rig: OpenRig) -> None:
    rig = fused(open_rig)
    assert poses_for(rig, 4.0) == 0
    status = rig.connection.status()
    assert (status.sent, status.sent_ns) == ({}, None), "nothing left"
    assert steering(rig) == ("in use", "GPS")

    rig.autopilot.gps = False
    poses_for(rig, 8.0)
    status = rig.connection.status()
    assert status.sent == heard(rig) and status.sent["VISION_POSITION_ESTIMATE"] > 10
    assert status.sent_ns is not None and rig.now_ns - status.sent_ns < 1e9
    assert steering(rig) == ("lost", "places") and status.reckoned_m is None

    rig.run(30.0)
    status = rig.connection.status()
    assert steering(rig) == ("lost", "dead reckoning")
    assert status.reckoned_m == pytest.approx(20 * SPEED_MPS, abs=15.0), "since positions counted"
    assert status.sent == heard(rig)

    rig.autopilot.gps = True
    rig.run(12.0)
    assert steering(rig) == ("in use", "GPS")
    by = [(one.gps, one.by) for one in rig.journalled(SteeringChanged)]
    assert by == [("in use", "GPS"), ("lost", "places"), ("lost", "dead reckoning"), ("in use", "GPS")]
    written = [one for one in texts(rig) if "steers by" in one]
    assert written == [
        f"Lookback: GPS {one}"
        for one in ("LOST, steers by places", "LOST, steers by dead reckoning", "in use, steers by GPS")
    ]


def test_what_the_link_does_not_take_is_not_counted(open_rig: OpenRig) -> None:
    rig = fused(open_rig)
    rig.autopilot.gps = False
    poses_for(rig, 6.0)
    sent = rig.connection.status().sent
    rig.unplug()
    assert rig.connection.status().sent == sent
    poses_for(rig, 3.0)
    assert rig.connection.status().sent == sent
    assert steering(rig) == ("unknown", "unknown"), "nobody is heard"


def test_an_autopilot_that_does_not_follow_steers_by_dead_reckoning(open_rig: OpenRig) -> None:
    """It is sent positions, and its own stays far from them."""
    rig = fused(open_rig)
    rig.autopilot.gps = False
    rig.run(3.0)
    rig.wire.loses = lambda one: one.get_type() == "VISION_POSITION_ESTIMATE"
    rig.autopilot.estimate.shift(40.0, 0.0)
    poses_for(rig, 8.0)
    assert rig.connection.status().sent["VISION_POSITION_ESTIMATE"] > 5
    assert steering(rig) == ("lost", "dead reckoning")


@pytest.mark.parametrize(("doubted", "by"), [("report", "GPS"), ("switch", "places")])
def test_a_faulty_gps_is_said_with_who_follows_it(open_rig: OpenRig, doubted: Any, by: str) -> None:
    rig = fused(open_rig, gates=GatesConfig(risk=1.0, doubted_gps=doubted))
    poses_for(rig, 2.0)
    rig.judge_gps(FAULTY)
    poses_for(rig, 6.0)
    assert steering(rig) == ("faulty", by)
