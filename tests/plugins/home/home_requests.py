"""Requests for the way home to our connection, and how they were answered."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge_plugins.home import HomeConfig
from tests.telemetry.rig import Rig

ENABLED = HomeConfig(enabled=True, speed_mps=2.5)
ACCEPTED, FAILED, IN_PROGRESS = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_FAILED,
    mavlink.MAV_RESULT_IN_PROGRESS,
)
REJECTED, DENIED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED, mavlink.MAV_RESULT_DENIED
OLD = [
    mavlink.MAVLink_mission_item_int_message(1, 1, number, 3, 16, 0, 1, 0, 0, 0, 0, -274000000 + number, 1530000000, 0)
    for number in range(30)
]
DRIVING_ITSELF = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED


def command(
    component_id: int = 191,
    params: tuple[float, float] = (1.0, 5665.0),
    confirmation: int = 0,
    number: int = mavlink.MAV_CMD_USER_5,
    route: float = 0.0,
) -> Any:
    return mavlink.MAVLink_command_long_message(1, component_id, number, confirmation, *params, route, 0, 0, 0, 0)


def acknowledgements(rig: Rig) -> list[Any]:
    return [ack for ack in rig.received("COMMAND_ACK") if ack.command == mavlink.MAV_CMD_USER_5]


def results(rig: Rig) -> list[int]:
    return [ack.result for ack in acknowledgements(rig)]


def finished(rig: Rig) -> Callable[[], bool]:
    return lambda: any(result != IN_PROGRESS for result in results(rig))


def asked(rig: Rig, seconds: float = 10.0, message: Any = None) -> list[int]:
    """Request the way home, by default as one does, and wait for the last answer; all answers."""
    rig.autopilot.send(message or command())
    assert rig.run(seconds, finished(rig))
    return results(rig)


def accepted(rig: Rig, times: int) -> Callable[[], bool]:
    return lambda: results(rig).count(ACCEPTED) == times


def stop_at_item(rig: Rig, item: int) -> None:
    """Request the way home on a link that loses one item of the upload, until those before it have arrived."""

    def loses(message: Any) -> bool:
        return message.get_type() == "MISSION_ITEM_INT" and (message.seq, message.get_srcComponent()) == (item, 191)

    rig.wire.loses = loses
    rig.autopilot.send(command())
    rig.run(3.0, lambda: len(rig.received("MISSION_ITEM_INT")) == item)
