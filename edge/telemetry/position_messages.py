"""The MAVLink messages that can carry a position to an autopilot, as a table; which of them suits which firmware, and
what it must be set to.

What each firmware does with each message was tried on the firmware itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.localization import PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.encoders import Sending

TimeBase: TypeAlias = Literal["exposure", "now"]
"""The moment whose position a message carries: that of an exposure, or that of sending."""


@dataclass(frozen=True)
class PositionMessage:
    """One message that carries a position.

    time_base: "exposure" where the message has an age that the autopilot uses; with "now" the fix must be moved on to
    the moment of sending. period_s: between messages while the vehicle is on the map; None where each is a hard reset,
    whose interval [gates] sets. max_age_s: the greatest age of an exposure. acknowledged: COMMAND_ACK follows.
    """

    name: str
    encode: Callable[[PlaceFix, Sending], Message]
    time_base: TimeBase
    period_s: float | None
    max_age_s: float
    acknowledged: bool = False


POSITION_MESSAGES: dict[str, PositionMessage] = {
    message.name: message
    for message in (
        # ArduPilot uses an age of up to 5 s, PX4 of 15.
        PositionMessage("external_position", encoders.external_position, "exposure", None, 5.0, acknowledged=True),
        # Where its velocity is measured, a larger standard deviation let PX4 go 17 m off, its own 4.5 m (recorded).
        PositionMessage("global_position_sensor", encoders.global_position_sensor, "now", 0.2, 1.0),
    )
}


@dataclass(frozen=True)
class Support:
    """From which version on a firmware accepts a message; the first that fits is used."""

    autopilot: int
    version: tuple[int, int]
    message: str


SUITABLE = (
    Support(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, (4, 5), "external_position"),
    Support(mavlink.MAV_AUTOPILOT_PX4, (1, 18), "global_position_sensor"),
    Support(mavlink.MAV_AUTOPILOT_PX4, (1, 15), "external_position"),
)
NAMES = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}


def autopilot_name(autopilot: int | None) -> str:
    """Of a MAV_AUTOPILOT, for people."""
    return NAMES.get(autopilot or 0, f"autopilot {autopilot}")


def suitable_message(autopilot: int | None, version: tuple[int, int] | None) -> tuple[PositionMessage | None, str]:
    """What `auto` chooses, and why; None while the version is not known, and for firmware that accepts no position."""
    name = autopilot_name(autopilot) if autopilot is not None else "no autopilot"
    if version is None:
        return None, f"{name} has not reported its version"
    spelled = f"{name} {version[0]}.{version[1]}"
    for support in SUITABLE:
        if support.autopilot == autopilot and version >= support.version:
            return POSITION_MESSAGES[support.message], f"{spelled} takes {support.message}"
    return None, f"{spelled} takes no position"


CONTROL, ID = "EKF2_AGP0_CTRL", "EKF2_AGP0_ID"
FUSES_POSITION = 1
"""Bit of `CONTROL`."""
USE_PARAMETERS = {mavlink.MAV_AUTOPILOT_PX4: (CONTROL, ID)}
"""What an autopilot is asked to know whether it uses positions, by MAV_AUTOPILOT."""


def unused_because(autopilot: int | None, parameters: Mapping[str, float], message: str, sensor_id: int) -> str:
    """Why this autopilot will use no position that comes in that message; "" where nothing is known against it."""
    if message != "global_position_sensor" or autopilot != mavlink.MAV_AUTOPILOT_PX4:
        return ""
    control, own_id = (parameters.get(name) for name in (CONTROL, ID))
    if control is not None and not round(control) & FUSES_POSITION:
        return f"{CONTROL} is {control:.0f}"
    if own_id is not None and round(own_id) != sensor_id:
        return f"{ID} is {own_id:.0f}"
    return ""
