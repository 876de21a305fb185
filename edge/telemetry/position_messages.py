"""The ways to tell an autopilot a position, as a table, and which of them suits which firmware.

What each firmware does with each message was tried on the firmware itself; the gates are ours because ArduPilot and
PX4 take a position that is 500 m wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import common as mavlink

from edge.localization import PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.encoders import Sending

Moment: TypeAlias = Literal["exposure", "now"]


@dataclass(frozen=True)
class PositionMessage:
    """One message that carries a position.

    of: the moment whose position it carries: that of the exposure, where the message has an age that is heeded, or
    that of sending, to which the fix must have been moved. period_s: between messages while the vehicle is on the
    map; None where each is a hard reset, whose interval [gates] sets. oldest_s: the greatest age of an exposure.
    acknowledged: COMMAND_ACK follows. needs_origin: meters from the origin of the autopilot's filter.
    """

    name: str
    encode: Callable[[PlaceFix, Sending], Message]
    of: Moment
    period_s: float | None
    oldest_s: float
    acknowledged: bool = False
    needs_origin: bool = False


POSITION_MESSAGES: dict[str, PositionMessage] = {
    way.name: way
    for way in (
        # ArduPilot honors an age of up to 5 s, PX4 of 15.
        PositionMessage("external_position", encoders.external_position, "exposure", None, 5.0, acknowledged=True),
        PositionMessage("global_position_sensor", encoders.global_position_sensor, "now", 0.2, 1.0),
        # Arming wants one every 300 ms.
        PositionMessage("vision_position", encoders.vision_position, "now", 0.2, 1.0, needs_origin=True),
    )
}


@dataclass(frozen=True)
class Support:
    """From which version on a firmware takes a way; the first that fits is taken."""

    autopilot: int
    version: tuple[int, int]
    way: str


SUITABLE = (
    Support(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, (4, 5), "external_position"),
    Support(mavlink.MAV_AUTOPILOT_PX4, (1, 18), "global_position_sensor"),
    Support(mavlink.MAV_AUTOPILOT_PX4, (1, 15), "external_position"),
)
NAMES = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}


def suitable_message(autopilot: int | None, version: tuple[int, int] | None) -> tuple[PositionMessage | None, str]:
    """What `auto` picks, and why; None while the version is not known, and for firmware that takes no position."""
    name = NAMES.get(autopilot, f"autopilot {autopilot}") if autopilot is not None else "no autopilot"
    if version is None:
        return None, f"{name} has not told its version"
    spelled = f"{name} {version[0]}.{version[1]}"
    for suits in SUITABLE:
        if suits.autopilot == autopilot and version >= suits.version:
            return POSITION_MESSAGES[suits.way], f"{spelled} takes {suits.way}"
    return None, f"{spelled} takes no position that we can send"
