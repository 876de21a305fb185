"""The messages that are sent: pure encoders, one for each, and the table of those that carry positions."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable
from dataclasses import dataclass

from msgspec import UNSET
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.localization import Moment, PlaceFix, ProtectionLevel
from edge.telemetry.codec import Message
from edge.telemetry.session import Origin

EXTERNAL_POSITION_ESTIMATE: int = mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE  # 43003
SENSOR_ENABLE, SENSOR_GPS = 43006, 0  # MAV_CMD_ESTIMATOR_SENSOR_ENABLE, which pymavlink does not have yet
TEXT_BYTES = 50
ARDUPILOT_M_PER_DEG = 0.011131884502145034 * 1e7
UNIQUENESS_NAME, SIGMA_NAME, PLACE_NAME = b"uniqueness", b"fix_sigma", b"place"  # at most 10 characters
LEVEL_NAMES, UNBOUNDED_M = (b"pl_along", b"pl_across"), 1e6
GPS_DOUBT_NAME, GPS_OFF_NAME, UNKNOWN_DOUBT = b"gps_doubt", b"gps_off", -1.0


@dataclass(frozen=True)
class MessageContext:
    """What a position message carries besides the fix.

    boot_s: time of sending on the autopilot's boot clock. age_s: time since the moment of the fix. origin: of its local
    frame, None where it has none. alt_m: its own altitude above mean sea level.
    """

    system_id: int
    boot_s: float
    age_s: float
    sensor_id: int = 1
    origin: Origin | None = None
    alt_m: float = 0.0


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


def heartbeat(system_status: int, kind: int = mavlink.MAV_TYPE_ONBOARD_CONTROLLER) -> Message:
    """A heartbeat of a MAV_TYPE; autopilot 8 (invalid) says that we are not the vehicle itself."""
    return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, system_status, 3)


def external_position(fix: PlaceFix, sending: MessageContext) -> Message:
    """COMMAND_INT 43003: where the vehicle was `age_s` seconds before `boot_s` on the autopilot's boot clock.

    param1 does not wrap, although MAVLink allows it: ArduPilot then stamps every later fix 500 ms late. z is NaN,
    since 0 is denied by ArduPilot and resets PX4's altitude. ValueError without a position or a finite sigma.
    """
    lat_deg, lon_deg = _position(fix, sending)
    return mavlink.MAVLink_command_int_message(
        target_system=sending.system_id,
        target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
        frame=mavlink.MAV_FRAME_GLOBAL,
        command=EXTERNAL_POSITION_ESTIMATE,
        current=0,
        autocontinue=0,
        param1=sending.boot_s,
        param2=sending.age_s,
        param3=fix.sigma_m,
        param4=0.0,
        x=round(lat_deg * 1e7),
        y=round(lon_deg * 1e7),
        z=math.nan,
    )


def global_position_sensor(fix: PlaceFix, sending: MessageContext) -> Message:
    """GLOBAL_POSITION_SENSOR 296: where the vehicle is now, by a camera; heights NaN, since a place has none.

    PX4 1.18 ignores both times, so the fix must have been moved on to the moment of sending. ValueError as above.
    """
    lat_deg, lon_deg = _position(fix, sending)
    return mavlink.MAVLink_global_position_sensor_message(
        target_system=sending.system_id,
        target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
        id=sending.sensor_id,
        time_usec=round(sending.boot_s * 1e6),
        processing_time=0,
        source=mavlink.GLOBAL_POSITION_SRC_VISION,
        flags=0,
        lat=round(lat_deg * 1e7),
        lon=round(lon_deg * 1e7),
        alt_ellipsoid=math.nan,
        alt=math.nan,
        eph=fix.sigma_m,
        epv=math.nan,
    )


def vision_position(fix: PlaceFix, sending: MessageContext) -> Message:
    """VISION_POSITION_ESTIMATE 102: where the vehicle is now, north, east and down of the autopilot's origin.

    By ArduPilot's own flat formula (`Location::get_distance_NE`), and at its own altitude: the first one sets its
    height. It reads the covariance as one sigma, the cube root of the sum of squared variances, and no attitude while
    its yaw is that of the compass. ValueError as above, and without an origin.
    """
    lat_deg, lon_deg = _position(fix, sending)
    origin = sending.origin
    if origin is None:
        raise ValueError("a vision position needs the autopilot's origin")
    north_m = (lat_deg - origin.lat_deg) * ARDUPILOT_M_PER_DEG
    to_east = math.cos(math.radians((lat_deg + origin.lat_deg) / 2))
    east_m = math.remainder(lon_deg - origin.lon_deg, 360) * ARDUPILOT_M_PER_DEG * to_east
    covariance = [0.0] * 21
    covariance[0] = covariance[6] = math.sqrt(fix.sigma_m**3 / 2)  # x and y of the upper triangle
    usec, down_m = round(sending.boot_s * 1e6), origin.alt_m - sending.alt_m
    return mavlink.MAVLink_vision_position_estimate_message(usec, north_m, east_m, down_m, 0.0, 0.0, 0.0, covariance)


def no_vision_position(boot_s: float) -> Message:
    """ODOMETRY 331 of quality -1, which ArduPilot does not use: without a message for 0.3 s it cannot be armed.

    Its velocity is not a number, since one that was used once would be expected from then on.
    """
    unknown = [math.nan] * 21
    return mavlink.MAVLink_odometry_message(
        round(boot_s * 1e6),
        mavlink.MAV_FRAME_LOCAL_FRD,
        mavlink.MAV_FRAME_BODY_FRD,
        *(0.0, 0.0, 0.0),
        [1.0, 0.0, 0.0, 0.0],
        *(math.nan, math.nan, math.nan, 0.0, 0.0, 0.0),
        unknown,
        unknown,
        0,
        mavlink.MAV_ESTIMATOR_TYPE_VISION,
        -1,
    )


def _position(fix: PlaceFix, sending: MessageContext) -> tuple[float, float]:
    if not fix.is_position or fix.lat_deg is None or fix.lon_deg is None:
        raise ValueError("a position estimate needs a latitude, a longitude and a finite sigma")
    if not (math.isfinite(sending.boot_s) and math.isfinite(sending.age_s)):
        raise ValueError("a position estimate needs finite times")
    return fix.lat_deg, fix.lon_deg


CARRIERS = ("COMMAND_INT", "VISION_POSITION_ESTIMATE", "GLOBAL_POSITION_SENSOR")
"""MAVLink's names of those below; no other COMMAND_INT is sent."""
POSITION_MESSAGES: dict[str, PositionMessage] = {
    message.name: message
    for message in (
        # ArduPilot uses an age of up to 5 s, PX4 of 15, and both go on by their present velocity over it, also in a
        # bend: six resets of 2.4 to 4 s on real ArduPilot turned 24 m of errors in all into 31, one of 6.4 m into 12.8.
        PositionMessage("external_position", external_position, "exposure", None, 2.0, acknowledged=True),
        # Of set 2 of its sources, which has to be selected. Where each pose was fused on real ArduPilot 4.6.3, home at
        # night by wheels 3 % wrong was .46 / 1.35 / 2.13 m off (median, 95 %, most), by resets 2.2 / 4.1 / 5.1 m. 4.6
        # counts each as the last accuracy of GPS, .5 m at least, and goes to the first one after a hole: of seven
        # flights' poses those of up to 1 m were .2 / .7 / 2.4 m off, wider ones .4 / 2.2 / 3.0 m (106 of 3,165).
        PositionMessage("vision_position", vision_position, "pose", 0.0, 1.0, widest_m=1.0),
        # Where its velocity is measured, a larger standard deviation let PX4 go 17 m off, its own 4.5 m (recorded).
        PositionMessage("global_position_sensor", global_position_sensor, "now", 0.2, 1.0),
    )
}
"""Those that can carry a position to an autopilot; `firmware` says who takes which."""


def describe(fix: PlaceFix) -> str:
    """The line that a pilot reads: at most 50 bytes for a single map."""
    direction = "" if fix.direction == "forward" else " backwards"
    of = "" if fix.map is UNSET else f" of {fix.map}"
    return f"Place {fix.place}{of}{direction}, confidence {fix.confidence:.2f}"


def status_text(text: str, severity: int) -> list[Message]:
    """STATUSTEXT, one for each line of complete words of at most 50 bytes of UTF-8."""
    one_byte_each = text.encode().decode("latin-1")
    lines = textwrap.wrap(one_byte_each, TEXT_BYTES, break_on_hyphens=False)
    return [mavlink.MAVLink_statustext_message(severity, line.encode("latin-1"), 0, 0) for line in lines]


def plotted_values(fix: PlaceFix, boot_ms: int) -> list[Message]:
    """NAMED_VALUE_FLOAT and NAMED_VALUE_INT of a fix, for ground stations that plot."""
    place = mavlink.MAVLink_named_value_int_message(boot_ms % 2**32, PLACE_NAME, fix.place)
    return [*_named({UNIQUENESS_NAME: fix.uniqueness, SIGMA_NAME: fix.sigma_m}, boot_ms), place]


def protection_values(level: ProtectionLevel | None, boot_ms: int) -> list[Message]:
    """NAMED_VALUE_FLOAT of the protection level of a position, in meters; UNBOUNDED_M where it has none."""
    levels_m = (math.inf, math.inf) if level is None else (level.along_track_m, level.cross_track_m)
    values = {name: min(level_m, UNBOUNDED_M) for name, level_m in zip(LEVEL_NAMES, levels_m, strict=True)}
    return _named(values, boot_ms)


def gps_values(doubt: float | None, off_m: float | None, boot_ms: int) -> list[Message]:
    """NAMED_VALUE_FLOAT: whether GPS is doubted, 0 to 1, where 1 is declared faulty, and by how many meters it is off.

    doubt: None where nothing is known, which is sent as -1; off_m: None is not sent.
    """
    off = {} if off_m is None else {GPS_OFF_NAME: off_m}
    return _named({GPS_DOUBT_NAME: UNKNOWN_DOUBT if doubt is None else doubt, **off}, boot_ms)


def _named(values: dict[bytes, float], boot_ms: int) -> list[Message]:
    stamp_ms = boot_ms % 2**32
    return [mavlink.MAVLink_named_value_float_message(stamp_ms, name, value) for name, value in values.items()]


def stream_request(system_id: int, message_id: int, rate_hz: float) -> Message:
    """COMMAND_LONG 511: request a message at a rate, on this link."""
    return _command(system_id, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)


def message_request(system_id: int, message_id: int) -> Message:
    """COMMAND_LONG 512: request a message once."""
    return _command(system_id, mavlink.MAV_CMD_REQUEST_MESSAGE, message_id)


def set_mode(system_id: int, mode: tuple[int, ...]) -> Message:
    """COMMAND_LONG 176: a mode of the vehicle, see `Firmware.hold`."""
    return _command(system_id, mavlink.MAV_CMD_DO_SET_MODE, *mode)


def parameter_request(system_id: int, name: str) -> Message:
    """PARAM_REQUEST_READ: request one parameter."""
    return mavlink.MAVLink_param_request_read_message(system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), -1)


def gps_fusion(system_id: int, *, is_on: bool) -> Message:
    """COMMAND_LONG 43006: whether a filter fuses GPS."""
    return _command(system_id, SENSOR_ENABLE, SENSOR_GPS, 0, is_on)


def source_set(system_id: int, number: int) -> Message:
    """COMMAND_LONG 42007: which of the filter's sets of sources (1 to 3) is used."""
    return _command(system_id, mavlink.MAV_CMD_SET_EKF_SOURCE_SET, number)


def acknowledgement(command: int, result: int, param2: int, system_id: int, component_id: int) -> Message:
    """COMMAND_ACK to the component that sent a command."""
    return mavlink.MAVLink_command_ack_message(command, result, 0, param2, system_id, component_id)


def _command(system_id: int, command: int, param1: float, param2: float = 0.0, param3: float = 0.0) -> Message:
    return mavlink.MAVLink_command_long_message(
        system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, command, 0, param1, param2, param3, 0, 0, 0, 0
    )


def set_origin(system_id: int, origin: Origin) -> Message:
    """SET_GPS_GLOBAL_ORIGIN: the origin of the local frame, for an autopilot that has never had GPS."""
    return mavlink.MAVLink_set_gps_global_origin_message(
        system_id, round(origin.lat_deg * 1e7), round(origin.lon_deg * 1e7), round(origin.alt_m * 1000)
    )


def timesync_request(now_ns: int) -> Message:
    """TIMESYNC: request the peer's time; `now_ns` comes back as ts1."""
    return mavlink.MAVLink_timesync_message(0, now_ns)


def timesync_answer(request: Message, now_ns: int) -> Message:
    """TIMESYNC: our time in answer to the autopilot's request."""
    return mavlink.MAVLink_timesync_message(now_ns, request.ts1)
