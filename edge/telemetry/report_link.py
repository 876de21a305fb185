"""Links that carry events for people, and nothing else: lines of text and values to plot."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from edge.journal.records import LinkChanged, Record
from edge.localization import PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.link_protocol import HEARTBEAT_NS, StatusTexts
from edge.telemetry.port import Port
from edge.telemetry.vehicle import Vehicle

PEER_SILENT_NS = 5_000_000_000


class ReportLink:
    """A further link, to a ground station or a router: heartbeats, lines and values, never a position."""

    def __init__(
        self, port: Port, vehicle: Vehicle, clock_ns: Callable[[], int], record: Callable[[Record], object]
    ) -> None:
        """vehicle: that of the autopilot's link; messages are sent with its system id and on its boot clock."""
        self.port = port
        self._vehicle = vehicle
        self._clock_ns = clock_ns
        self._record = record
        self.texts = StatusTexts()
        self._heartbeat_ns = self._heard_ns = 0
        self._was_open: bool | None = None
        self.system_status: int = mavlink.MAV_STATE_ACTIVE
        """MAV_STATE for our heartbeat."""

    def poll(self) -> None:
        """One turn. What arrives is read, so that the buffers stay empty, and ignored."""
        now_ns = self._clock_ns()
        self.port.open_if_due(now_ns)
        for _ in self.port.receive():
            self._heard_ns = now_ns
            self.port.peer_answered()
        if now_ns - self._heard_ns > PEER_SILENT_NS:
            self.port.peer_silent()
        self.port.codec.system_id = self._vehicle.system_id or self.port.codec.system_id
        if now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = now_ns + HEARTBEAT_NS
            self.port.send(encoders.heartbeat(self.system_status))
        self._send(self.texts.due(now_ns))
        if self.port.is_open != self._was_open:
            self._was_open = self.port.is_open
            self._record(
                LinkChanged("up" if self._was_open else "closed", self.port.why_closed, str(self.port.connection))
            )

    def publish_place(self, fix: PlaceFix) -> None:
        """Publish a place: a line of text at most every five seconds, and values to plot."""
        now_ns = self._clock_ns()
        self.texts.put_place(fix, now_ns)
        self._send(encoders.plotted_values(fix, round((self._vehicle.boot_time_s(now_ns) or 0.0) * 1000)))

    def _send(self, messages: list[Message]) -> None:
        for message in messages:
            self.port.send(message)
