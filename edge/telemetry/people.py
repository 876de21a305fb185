"""What goes to people on every link: heartbeats, lines of text and values to plot; and what they read of GPS.

At most two lines a second come out, and of many only the newest: a slow link carries the pilot's telemetry as well.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import GpsJudged, LinkChanged, Record
from edge.localization import GpsVerdict, PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.port import Port
from edge.telemetry.vehicle import Vehicle

HEARTBEAT_NS = 1_000_000_000
TEXT_NS = 500_000_000
PLACE_NS = 5_000_000_000
QUEUE_LINES = 8
PEER_SILENT_NS = 5_000_000_000
VALUES_NS = 1_000_000_000
GPS_TEXTS = {
    "faulty": "Lookback: GPS faulty: {}",
    "consistent": "Lookback: GPS consistent with the map again",
    "inconsistent": "Lookback: GPS inconsistent: {}",
    "map faulty": "Lookback: map faulty here, GPS {}",
    "not recognized": "Lookback: not recognized where GPS says we are",
}


@dataclass(frozen=True)
class Publisher:
    """Where what happens is published: a record in the journal, a warning to the pilot."""

    record: Callable[[Record], object]
    warn: Callable[[str], object]


class PeopleLink:
    """What people get on one link."""

    def __init__(self, port: Port, vehicle: Vehicle) -> None:
        """vehicle: that of the autopilot's link; messages are sent with its system id and on its boot clock."""
        self.port = port
        self._vehicle = vehicle
        self.system_status: int = mavlink.MAV_STATE_ACTIVE
        """MAV_STATE of our heartbeats."""
        self.kind: int = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
        """MAV_TYPE of our heartbeats."""
        self._lines: deque[list[Message]] = deque(maxlen=QUEUE_LINES)
        self._heartbeat_ns, self._line_ns, self._place_ns = 0, 0, 0

    def send(self, messages: Iterable[Message]) -> None:
        """Send messages, as far as the port takes them."""
        for message in messages:
            self.port.send(message)

    def put(self, text: str, severity: int) -> None:
        """Queue a line of any length."""
        self._lines.append(encoders.status_text(text, severity))

    def publish_place(self, fix: PlaceFix, now_ns: int) -> None:
        """Publish a place: values to plot, and a line at most every five seconds: places come by the second."""
        if now_ns >= self._place_ns:
            self._place_ns = now_ns + PLACE_NS
            self.put(encoders.describe(fix), mavlink.MAV_SEVERITY_INFO)
        self.send(encoders.plotted_values(fix, self._vehicle.boot_ms(now_ns)))

    def send_heartbeat(self, now_ns: int) -> None:
        """Once a second from the moment when the port is opened, whether there is a peer or not."""
        if not self.port.is_open:
            self._heartbeat_ns = now_ns
        elif now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = now_ns + HEARTBEAT_NS
            self.send([encoders.heartbeat(self.system_status, self.kind)])

    def send_line(self, now_ns: int) -> None:
        """The next line, if it is time for one."""
        if self._lines and now_ns >= self._line_ns:
            self._line_ns = now_ns + TEXT_NS
            self.send(self._lines.popleft())

    def say_now(self, text: str, severity: int, now_ns: int) -> None:
        """A heartbeat and a line at once, even where no peer was heard."""
        if self.port.open_if_due(now_ns):
            self.send([encoders.heartbeat(self.system_status, self.kind), *encoders.status_text(text, severity)])


class ReportLink(PeopleLink):
    """A further link, to a ground station or a router, which carries nothing else; never a position."""

    def __init__(self, port: Port, vehicle: Vehicle, record: Callable[[Record], object]) -> None:
        super().__init__(port, vehicle)
        self._record = record
        self._heard_ns = 0
        self._was_open: bool | None = None

    def poll(self, now_ns: int) -> None:
        """One turn. What arrives is read, so that the buffers stay empty, and ignored."""
        port = self.port
        port.open_if_due(now_ns)
        for _ in port.receive():
            self._heard_ns = now_ns
            port.peer_answered()
        if now_ns - self._heard_ns > PEER_SILENT_NS:
            port.peer_silent()
        port.codec.system_id = self._vehicle.system_id or port.codec.system_id
        self.send_heartbeat(now_ns)
        self.send_line(now_ns)
        if port.is_open != self._was_open:
            self._was_open = port.is_open
            self._record(LinkChanged("up" if port.is_open else "closed", port.why_closed, str(port.connection)))


class GpsNews:
    """What was published of what the places say of GPS."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._published = ""  # the newest state, "" before the first
        self._values_ns = 0

    def publish(self, verdict: GpsVerdict) -> str:
        """Publish a verdict where it is another one; returns its state then, else ""."""
        before = self._published
        if verdict.state == before or (not before and verdict.state == "cannot say"):
            return ""
        self._published = verdict.state
        east_m, north_m = verdict.off_m or (None, None)
        self._publisher.record(GpsJudged(verdict.state, east_m, north_m, verdict.doubt))
        if verdict.state in GPS_TEXTS and (verdict.state != "consistent" or before == "faulty"):
            self._publisher.warn(GPS_TEXTS[verdict.state].format(verdict.where))
        return verdict.state

    def values_due(self, verdict: GpsVerdict, boot_ms: int, now_ns: int) -> list[Message]:
        """The values for ground stations and scripts, once a second from the first answer on."""
        if not self._published or now_ns < self._values_ns:
            return []
        self._values_ns = now_ns + VALUES_NS
        return encoders.gps_values(verdict.doubt, verdict.distance_m, boot_ms)
