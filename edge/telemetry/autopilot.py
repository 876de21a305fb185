"""The connection to the autopilot: link, codec and vehicle joined into one object that the daemon polls."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from typing import Literal

import msgspec
from pymavlink.dialects.v20 import common as mavlink

from edge.config import TelemetryConfig
from edge.errors import LinkLost
from edge.telemetry import PlaceFix, fixes
from edge.telemetry.codec import MavlinkCodec, Message
from edge.telemetry.link import Link, parse_connection
from edge.telemetry.vehicle import Vehicle

HEARTBEAT_NS = 1_000_000_000
TIMESYNC_NS = 500_000_000
TEXT_NS = 500_000_000  # at most two status texts a second: they share a slow link with the pilot's telemetry
TEXTS_KEPT = 8
RETRY_FIRST_NS = 500_000_000
RETRY_LAST_NS = 8_000_000_000
STREAMS_AGAIN_NS = 5_000_000_000
ANSWER_NS = 2_000_000_000
AGE_LIMIT_S = 5.0  # ArduPilot honours no older fix
STREAMS_HZ = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 5.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
}
FIRST_SYSTEM_ID = 1  # what autopilots have by default, until the vehicle's own is known

log = logging.getLogger(__name__)


class LinkChanged(msgspec.Struct, frozen=True, tag_field="event", tag="link"):
    """The link's state changed."""

    state: str
    why: str = ""


class FixSent(msgspec.Struct, frozen=True, tag_field="event", tag="fix_sent"):
    """A position estimate has left for the autopilot."""

    place: int
    send_boot_s: float
    age_s: float
    sigma_m: float


class FixAnswered(msgspec.Struct, frozen=True, tag_field="event", tag="fix_answered"):
    """The autopilot's answer to a position estimate, MAV_RESULT's name without its prefix, or "NO_ANSWER"."""

    place: int
    result: str


class AutopilotConnection:
    """Owns the link: opens it, keeps it, and opens it again; nothing in here blocks.

    `state` is "closed" (no port; it is tried again with growing pauses), "waiting" (no autopilot heard) or "up".
    """

    def __init__(
        self,
        config: TelemetryConfig,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        record: Callable[[msgspec.Struct], object] = lambda record: None,
    ) -> None:
        """`record` keeps what happens (`Journal.write`). ConfigError for a malformed `connection`."""
        self._config = config
        self._connection = parse_connection(config.connection)
        self._clock_ns = clock_ns
        self._record = record
        self._codec = MavlinkCodec(FIRST_SYSTEM_ID, config.component_id)
        self._link: Link | None = None
        self.vehicle = Vehicle()
        self.state: Literal["closed", "waiting", "up"] = "closed"
        self.system_status: int = mavlink.MAV_STATE_ACTIVE
        """MAV_STATE for our heartbeat."""
        self.positions_enabled = config.emit == "external_position"
        self._retry_ns = RETRY_FIRST_NS
        self._last_failure = ""
        self._due_ns = dict.fromkeys(("open", "heartbeat", "timesync", "text", "streams"), 0)
        self._session = 0
        self._texts: deque[list[Message]] = deque(maxlen=TEXTS_KEPT)
        self._text_id = 0
        self._unanswered: tuple[int, int] | None = None  # when the last fix was sent, and its place

    def poll(self) -> None:
        """One turn: read what has arrived, and send what is due. Never raises LinkLost."""
        now_ns = self._clock_ns()
        if self._link is None and not self._open(now_ns):
            return
        try:
            self._receive(now_ns)
            self._send_due(now_ns)
        except LinkLost as error:
            self._lose(str(error), now_ns)

    def send_fix(self, fix: PlaceFix) -> bool:
        """Tell the robot of a place, in the way that [telemetry] emit says; True when a position went out."""
        now_ns = self._clock_ns()
        boot_s = self.vehicle.boot_time_s(now_ns)
        if self.state != "up":
            return False
        self.status_text(fixes.describe(fix), mavlink.MAV_SEVERITY_INFO)
        self._send(fixes.uniqueness_value(fix, round((boot_s or 0.0) * 1000)))
        age_s = (now_ns - fix.stamp_ns) / 1e9
        if not self.positions_enabled or boot_s is None or fix.lat_deg is None or not 0 <= age_s <= AGE_LIMIT_S:
            return False
        sent = self._send(fixes.external_position(fix, self.vehicle.system_id or FIRST_SYSTEM_ID, boot_s, age_s))
        if sent:
            self._unanswered = now_ns, fix.place
            self._record(FixSent(fix.place, boot_s, age_s, fix.sigma_m))
        return sent

    def status_text(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Queue a line for the pilot; at most two a second go out, and of a flood only the newest are kept."""
        self._text_id = self._text_id % 65535 + 1
        self._texts.append(fixes.status_text(text, severity, self._text_id))

    def close(self) -> None:
        """Close the link; more than once is harmless, and poll() would open it again."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def _open(self, now_ns: int) -> bool:
        if now_ns < self._due_ns["open"]:
            return False
        log.debug("opening %s", self._connection)
        try:
            self._link = self._connection.open()
        except LinkLost as error:
            self._lose(str(error), now_ns)
            return False
        self._due_ns.update(heartbeat=now_ns, timesync=now_ns)
        self._set_state("waiting", str(self._connection))
        return True

    def _lose(self, why: str, now_ns: int) -> None:
        self.close()
        self.vehicle.forget_link()
        self._due_ns["open"] = now_ns + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, RETRY_LAST_NS)
        if why != self._last_failure:  # one line for each new reason, not one for each try
            self._last_failure = why
            log.warning("%s; trying again", why)
        self._set_state("closed", why)

    def _set_state(self, state: Literal["closed", "waiting", "up"], why: str = "") -> None:
        if state == self.state:
            return
        self.state = state
        if state == "up":
            self._last_failure, self._retry_ns = "", RETRY_FIRST_NS
        log.info("link %s %s", state, why)
        self._record(LinkChanged(state, why))

    def _receive(self, now_ns: int) -> None:
        assert self._link is not None
        for message in self._codec.decode(self._link.receive()):
            if self.vehicle.handle(message, now_ns):
                self._heed(message)
        self.vehicle.expire(now_ns)
        if self.vehicle.connected and self.vehicle.system_id:
            self._codec.system_id = self.vehicle.system_id
        self._set_state("up" if self.vehicle.connected else "waiting")

    def _heed(self, message: Message) -> None:
        kind = message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            self._write(fixes.timesync_answer(message, self._clock_ns()))
        elif kind == mavlink.MAVLINK_MSG_ID_COMMAND_ACK and message.command == fixes.EXTERNAL_POSITION_ESTIMATE:
            self._read_answer(message)

    def _read_answer(self, message: Message) -> None:
        if self._unanswered is None or message.target_component not in (0, self._config.component_id):
            return  # somebody else's
        result = mavlink.enums["MAV_RESULT"].get(message.result)
        name = result.name.removeprefix("MAV_RESULT_") if result else str(message.result)
        self._record(FixAnswered(self._unanswered[1], name))
        self._unanswered = None
        if name in ("DENIED", "UNSUPPORTED") and self.positions_enabled:
            self.positions_enabled = False
            log.error("the autopilot answered %s: no more positions until it reboots", name)
            self.status_text(f"Lookback: positions {name}, off", mavlink.MAV_SEVERITY_WARNING)

    def _send_due(self, now_ns: int) -> None:
        if self._is_due("heartbeat", now_ns, HEARTBEAT_NS):
            self._write(fixes.heartbeat(self.system_status))
        if self.state != "up":
            return
        if self._session != self.vehicle.session:
            self._session = self.vehicle.session
            self.positions_enabled = self._config.emit == "external_position"
            self._due_ns["streams"] = 0
        if self._is_due("timesync", now_ns, TIMESYNC_NS):
            sent_ns = self._clock_ns()
            self.vehicle.timesync_sent(sent_ns)
            self._write(fixes.timesync_request(sent_ns))
        if self.vehicle.speed_mps(now_ns) is None or self._due_ns["streams"] == 0:
            self._ask_for_streams(now_ns)
        if self._texts and self._is_due("text", now_ns, TEXT_NS):
            for chunk in self._texts.popleft():
                self._write(chunk)
        if self._unanswered is not None and now_ns - self._unanswered[0] > ANSWER_NS:
            self._record(FixAnswered(self._unanswered[1], "NO_ANSWER"))
            self._unanswered = None

    def _ask_for_streams(self, now_ns: int) -> None:
        if self._is_due("streams", now_ns, STREAMS_AGAIN_NS):
            for message_id, rate_hz in STREAMS_HZ.items():
                self._write(fixes.stream_request(self._codec.system_id, message_id, rate_hz))

    def _is_due(self, what: str, now_ns: int, period_ns: int) -> bool:
        if now_ns < self._due_ns[what]:
            return False
        self._due_ns[what] = now_ns + period_ns
        return True

    def _write(self, message: Message) -> bool:
        return self._link is not None and self._link.send(self._codec.encode(message))

    def _send(self, message: Message) -> bool:
        """Send outside poll(), where a lost link must not reach the caller."""
        try:
            return self._write(message)
        except LinkLost as error:
            self._lose(str(error), self._clock_ns())
            return False
