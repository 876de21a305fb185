"""Events for people: lines of text and values to plot, and links that carry nothing else."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from edge.journal.records import LinkChanged, Record
from edge.localization import PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.link_protocol import HEARTBEAT_NS
from edge.telemetry.port import Port
from edge.telemetry.vehicle import Vehicle

TEXT_NS = 500_000_000
PLACE_NS = 5_000_000_000
PEER_SILENT_NS = 5_000_000_000
QUEUE_LINES = 8


class StatusTexts:
    """A queue of lines for the pilot: at most two a second come out, and of many only the newest.

    A slow link carries the pilot's telemetry as well.
    """

    def __init__(self) -> None:
        self._queue: deque[list[Message]] = deque(maxlen=QUEUE_LINES)
        self._id = 0
        self._next_ns = 0
        self._next_place_ns = 0

    def put(self, text: str, severity: int) -> None:
        """Queue a line of any length."""
        self._id = self._id % 65535 + 1
        self._queue.append(encoders.status_text(text, severity, self._id))

    def put_place(self, fix: PlaceFix, now_ns: int, severity: int) -> None:
        """Queue a line about a place, but not more than one each five seconds: places come by the second."""
        if now_ns >= self._next_place_ns:
            self._next_place_ns = now_ns + PLACE_NS
            self.put(encoders.describe(fix), severity)

    def due(self, now_ns: int) -> list[Message]:
        """The messages of the next line, if it is time for one."""
        if not self._queue or now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + TEXT_NS
        return self._queue.popleft()


class ReportLink:
    """A further link, to a ground station or a router: heartbeats, lines and values, never a position."""

    def __init__(
        self,
        port: Port,
        vehicle: Vehicle,
        clock_ns: Callable[[], int],
        record: Callable[[Record], object],
    ) -> None:
        """vehicle: that of the autopilot's link; messages are sent with its system id and on its boot clock."""
        self._port = port
        self._vehicle = vehicle
        self._clock_ns = clock_ns
        self._record = record
        self._texts = StatusTexts()
        self._heartbeat_ns = self._heard_ns = 0
        self._was_open: bool | None = None
        self.system_status: int = mavlink.MAV_STATE_ACTIVE
        """MAV_STATE for our heartbeat."""

    def poll(self) -> None:
        """One turn. What arrives is read, so that the buffers stay empty, and ignored."""
        now_ns = self._clock_ns()
        self._port.open_if_due(now_ns)
        for _ in self._port.receive():
            self._heard_ns = now_ns
            self._port.peer_answered()
        if now_ns - self._heard_ns > PEER_SILENT_NS:
            self._port.peer_silent()
        self._port.codec.system_id = self._vehicle.system_id or self._port.codec.system_id
        if now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = now_ns + HEARTBEAT_NS
            self._port.send(encoders.heartbeat(self.system_status))
        self._send(self._texts.due(now_ns))
        if self._port.is_open != self._was_open:
            self._was_open = self._port.is_open
            self._record(
                LinkChanged("up" if self._was_open else "closed", self._port.why_closed, str(self._port.connection))
            )

    def publish_place(self, fix: PlaceFix) -> None:
        """Publish a place: a line of text at most every five seconds, and values to plot."""
        now_ns = self._clock_ns()
        self._texts.put_place(fix, now_ns, mavlink.MAV_SEVERITY_INFO)
        self._send(encoders.plotted_values(fix, round((self._vehicle.boot_time_s(now_ns) or 0.0) * 1000)))

    def status_text(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Queue a line for the pilot."""
        self._texts.put(text, severity)

    @property
    def port(self) -> Port:
        """Where its messages go."""
        return self._port

    def close(self) -> None:
        """Close the link."""
        self._port.close()

    def _send(self, messages: list[Message]) -> None:
        for message in messages:
            self._port.send(message)
