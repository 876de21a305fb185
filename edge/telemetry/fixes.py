"""What goes out: pure encoders, one for each message."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common as mavlink

from edge.telemetry import PlaceFix
from edge.telemetry.codec import Message

EXTERNAL_POSITION_ESTIMATE = 43003  # MAV_CMD_EXTERNAL_POSITION_ESTIMATE
TEXT_BYTES = 50
UNIQUENESS_NAME = b"uniqueness"  # at most 10 characters


def heartbeat(system_status: int) -> Message:
    """An onboard controller's heartbeat; autopilot 8 (invalid) keeps others from taking us for the vehicle."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, system_status, 3
    )


def external_position(fix: PlaceFix, system_id: int, send_boot_s: float, age_s: float) -> Message:
    """COMMAND_INT 43003: where the vehicle was `age_s` seconds before `send_boot_s` on the autopilot's boot clock.

    param1 does not wrap, although MAVLink allows it: ArduPilot then stamps every later fix 500 ms late. z is NaN,
    since 0 is denied by ArduPilot and resets PX4's altitude. ValueError without a position or a finite sigma.
    """
    if fix.lat_deg is None or fix.lon_deg is None or not math.isfinite(fix.sigma_m):
        raise ValueError("a position estimate needs a latitude, a longitude and a finite sigma")
    return mavlink.MAVLink_command_int_message(
        target_system=system_id,
        target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
        frame=mavlink.MAV_FRAME_GLOBAL,
        command=EXTERNAL_POSITION_ESTIMATE,
        current=0,
        autocontinue=0,
        param1=send_boot_s,
        param2=age_s,
        param3=fix.sigma_m,
        param4=0.0,
        x=round(fix.lat_deg * 1e7),
        y=round(fix.lon_deg * 1e7),
        z=math.nan,
    )


def describe(fix: PlaceFix) -> str:
    """The line that a pilot reads, at most 50 bytes for names of categories up to 18 letters."""
    way = "" if fix.direction == "forward" else " backwards"
    return f"Place {fix.place}{way}, {fix.category}, {fix.uniqueness:.2f}"


def status_text(text: str, severity: int, text_id: int) -> list[Message]:
    """STATUSTEXT, in chunks that share `text_id` (1 to 65535) when the text is longer than 50 bytes of UTF-8."""
    data = text.encode()
    if len(data) <= TEXT_BYTES:
        return [mavlink.MAVLink_statustext_message(severity, data, 0, 0)]
    # The reader knows the last chunk by a null byte: a text of exactly n x 50 bytes needs an empty one more.
    return [
        mavlink.MAVLink_statustext_message(severity, data[start : start + TEXT_BYTES], text_id, chunk)
        for chunk, start in enumerate(range(0, len(data) + 1, TEXT_BYTES))
    ]


def uniqueness_value(fix: PlaceFix, boot_ms: int) -> Message:
    """NAMED_VALUE_FLOAT of the fix's uniqueness, for ground stations that plot."""
    return mavlink.MAVLink_named_value_float_message(boot_ms % 2**32, UNIQUENESS_NAME, fix.uniqueness)


def stream_request(system_id: int, message_id: int, rate_hz: float) -> Message:
    """COMMAND_LONG 511: send us that message at that rate, on this link."""
    return mavlink.MAVLink_command_long_message(
        system_id,
        mavlink.MAV_COMP_ID_AUTOPILOT1,
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        0,
        message_id,
        1e6 / rate_hz,
        0,
        0,
        0,
        0,
        0,
    )


def timesync_request(now_ns: int) -> Message:
    """TIMESYNC: what time is it there? `now_ns` comes back as ts1."""
    return mavlink.MAVLink_timesync_message(0, now_ns)


def timesync_answer(request: Message, now_ns: int) -> Message:
    """TIMESYNC: our time in answer to the autopilot's request."""
    return mavlink.MAVLink_timesync_message(now_ns, request.ts1)
