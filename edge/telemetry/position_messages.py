"""The MAVLink messages that can carry a position to an autopilot, as a table; `firmware` says who takes which."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from edge.localization import PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.encoders import MessageContext

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
    encode: Callable[[PlaceFix, MessageContext], Message]
    time_base: TimeBase
    period_s: float | None
    max_age_s: float
    acknowledged: bool = False


POSITION_MESSAGES: dict[str, PositionMessage] = {
    message.name: message
    for message in (
        # ArduPilot uses an age of up to 5 s, PX4 of 15, and both go on by their present velocity over it, also in a
        # bend: six resets of 2.4 to 4 s on real ArduPilot turned 24 m of errors in all into 31, one of 6.4 m into 12.8.
        PositionMessage("external_position", encoders.external_position, "exposure", None, 2.0, acknowledged=True),
        # Where its velocity is measured, a larger standard deviation let PX4 go 17 m off, its own 4.5 m (recorded).
        PositionMessage("global_position_sensor", encoders.global_position_sensor, "now", 0.2, 1.0),
    )
}
