"""The MAVLink messages that can carry a position to an autopilot, as a table; `firmware` says who takes which."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from edge.localization import Moment, PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.encoders import MessageContext


@dataclass(frozen=True)
class PositionMessage:
    """One message that carries a position.

    moment: "exposure" where the message has an age that the autopilot uses; else its position must be that of the
    moment of sending: of a keypoint pose, or of whatever is known, see `FixRequest`. period_s: between messages while
    the vehicle is on the map; None where each is a hard reset, whose interval [gates] sets. max_age_s: the greatest age
    of an exposure. acknowledged: COMMAND_ACK follows. widest_m: standard deviation of a pose that is sent at most,
    unless none was for a while, to a filter that counts all alike.
    """

    name: str
    encode: Callable[[PlaceFix, MessageContext], Message]
    moment: Moment
    period_s: float | None
    max_age_s: float
    acknowledged: bool = False
    widest_m: float = math.inf


CARRIERS = ("COMMAND_INT", "VISION_POSITION_ESTIMATE", "GLOBAL_POSITION_SENSOR")
"""MAVLink's names of those below; no other COMMAND_INT is sent."""
POSITION_MESSAGES: dict[str, PositionMessage] = {
    message.name: message
    for message in (
        # ArduPilot uses an age of up to 5 s, PX4 of 15, and both go on by their present velocity over it, also in a
        # bend: six resets of 2.4 to 4 s on real ArduPilot turned 24 m of errors in all into 31, one of 6.4 m into 12.8.
        PositionMessage("external_position", encoders.external_position, "exposure", None, 2.0, acknowledged=True),
        # Of set 2 of its sources, which has to be selected. Where each pose was fused on real ArduPilot 4.6.3, home at
        # night by wheels 3 % wrong was .46 / 1.35 / 2.13 m off (median, 95 %, most), by resets 2.2 / 4.1 / 5.1 m. 4.6
        # counts each as the last accuracy of GPS, .5 m at least, and goes to the first one after a hole: of seven
        # flights' poses those of up to 1 m were .2 / .7 / 2.4 m off, wider ones .4 / 2.2 / 3.0 m (106 of 3,165).
        PositionMessage("vision_position", encoders.vision_position, "pose", 0.0, 1.0, widest_m=1.0),
        # Where its velocity is measured, a larger standard deviation let PX4 go 17 m off, its own 4.5 m (recorded).
        PositionMessage("global_position_sensor", encoders.global_position_sensor, "now", 0.2, 1.0),
    )
}
