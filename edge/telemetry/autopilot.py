"""The connection to the autopilot: port, vehicle, link protocol and positions, joined into what the daemon polls."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

from pymavlink.dialects.v20 import common as mavlink

from edge.config import Config, GatesConfig, HomeConfig, LinkConfig, TelemetryConfig
from edge.geodesy import PositionSource
from edge.journal.records import LinkChanged, Record
from edge.localization import GpsFix, GpsVerdict, PlaceFix, PositionEstimator, Report
from edge.motion import CameraSpeed
from edge.telemetry import LinkStatus, encoders
from edge.telemetry.codec import MavlinkCodec, Message
from edge.telemetry.home_requests import Answer, HomeRequests
from edge.telemetry.link import parse_connection
from edge.telemetry.link_protocol import (
    FIRST_SYSTEM_ID,
    NO_AID,
    VISION,
    LinkProtocol,
    Publisher,
    StatusTexts,
    velocity_aid,
)
from edge.telemetry.port import Port
from edge.telemetry.position_history import PositionHistory
from edge.telemetry.position_messages import TimeBase
from edge.telemetry.position_sender import PositionSender
from edge.telemetry.report_link import ReportLink
from edge.telemetry.signing import Signer, load_key
from edge.telemetry.vehicle import DOUBLED, Vehicle
from edge.telemetry.velocity_sender import VelocitySender

DRAIN_S = 0.1  # what a serial port has not sent yet is lost when it is closed
RESTORE_TRIES = 3
GPS_SPEED_NS = 500_000_000  # older, the speed is of another moment
log = logging.getLogger(__name__)


class AutopilotConnection:
    """Owns the links, and opens them again when they are lost; nothing in here blocks.

    `state` is "closed" (no port; opened again with growing pauses), "waiting" (no autopilot heard) or "up".
    """

    def __init__(
        self,
        config: TelemetryConfig,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        record: Callable[[Record], object] = lambda record: None,
        gates: GatesConfig = GatesConfig(),  # noqa: B008  # frozen
        home: HomeConfig = HomeConfig(),  # noqa: B008
        estimator: PositionEstimator | None = None,
        *,
        motion: str = "off",
    ) -> None:
        """record: writes a record of what happens (`Journal.write`). ConfigError for a wrong connection or key.

        estimator: decides on each position, and reads what bounds the autopilot's own; None: one without maps.
        motion: [motion] use.
        """
        self._clock_ns = clock_ns
        self._record = record
        self._component_id = config.component_id
        self._connection, self._emit = config.connection, config.emit
        self.vehicle = Vehicle(config.system_id)
        self.state: Literal["closed", "waiting", "up"] = "closed"
        self._port = open_port(config, LinkConfig(config.connection, config.signing_key), 0, clock_ns)
        self.protocol = LinkProtocol(config, self.vehicle, asks_attitude=motion != "off")
        self._texts = StatusTexts()
        self._estimator = estimator = estimator or PositionEstimator(Config(gates=gates))
        self.positions = PositionSender(config, gates, self.vehicle, estimator, Publisher(record, self._warn))
        replaced = Path(config.journal).with_suffix(".mission") if config.journal else None
        self.home = HomeRequests(home, self.vehicle, record, self.status_text, replaced)
        self.home.position = lambda: (self.vehicle.position(clock_ns()), self.uncertainty_m)
        self._report_links = [
            ReportLink(open_port(config, link, number, clock_ns), self.vehicle, clock_ns, record)
            for number, link in enumerate(config.links, start=1)
        ]
        self.velocity = VelocitySender(self.vehicle, record, is_on=motion == "send" and config.emit != "report")
        self.history = PositionHistory(clock_ns)
        """Its own positions at exposures, each with its accuracy and source."""
        self._session = 0
        self._was_doubled = False
        self._has_warned = False  # in this session, that nothing measures velocity
        self._system_status: int = mavlink.MAV_STATE_ACTIVE

    @property
    def why_closed(self) -> str:
        """Why there is no port, "" while there is none yet."""
        return self._port.why_closed if self.state == "closed" else ""

    @property
    def uncertainty_m(self) -> float | None:
        """One standard deviation of the autopilot's own position, None where it is not known."""
        return self.positions.uncertainty_m(self._clock_ns())

    def report(self) -> Report:
        """What the autopilot reports now, for the estimator."""
        return self.positions.report(self._clock_ns())

    def gps_fix(self, stamp_ns: int) -> GpsFix | None:
        """Where GPS puts the vehicle at a moment, None without GPS."""
        now_ns = self._clock_ns()
        return self.vehicle.gps.fix(self.vehicle.position(now_ns), stamp_ns, now_ns)

    def judge_gps(self, verdict: GpsVerdict) -> None:
        """What the places say of GPS now."""
        self.positions.judge_gps(verdict, is_aided=self._is_aided(self._clock_ns()))

    @property
    def why_no_position(self) -> str:
        """Why no position is sent, for people; "" while one is, and without a link."""
        if self.state != "up":
            return ""
        return DOUBLED if self.vehicle.is_doubled else self.positions.why_none(self._clock_ns())

    @property
    def gps_fault(self) -> str:
        """What is wrong with GPS by the places, for people; "" where nothing is. How far it is off is in `status`."""
        return "GPS is wrong" if self._estimator.gps_is_wrong else ""

    def gps_speed_mps(self) -> float | None:
        """How fast the vehicle moves by the autopilot, while GPS that nobody doubts bounds it; None otherwise."""
        now_ns = self._clock_ns()
        own = self.vehicle.position(now_ns)
        is_good = self.vehicle.gps.state(now_ns) == "healthy" and not (self.gps_fault or self._estimator.ignores_gps)
        return own.speed_mps if own is not None and is_good and now_ns - own.stamp_ns <= GPS_SPEED_NS else None

    def status(self) -> LinkStatus:
        """The link, and what the autopilot says of itself, for people."""
        now_ns = self._clock_ns()
        position = self.vehicle.position(now_ns)
        verdict = self.positions.doubted_gps.verdict or GpsVerdict()
        return LinkStatus(
            state=self.state,
            connection=self._connection,
            emit=self._emit,
            lat_deg=position.lat_deg if position else None,
            lon_deg=position.lon_deg if position else None,
            heading_deg=position.heading_deg if position else None,
            speed_mps=self.vehicle.speed_mps(now_ns),
            gps=self.vehicle.gps.state(now_ns),
            gps_why=self.vehicle.gps.why(now_ns),
            velocity_aid=self._velocity_aid,
            gps_verdict=verdict.state,
            gps_off_m=verdict.distance_m,
            gps_off=verdict.where,
            gps_doubt=verdict.doubt,
            **self.positions.sent_status,
        )

    def set_system_status(self, status: int) -> None:
        """MAV_STATE of our heartbeats from now on, on every link."""
        self._system_status = status
        for link in self._report_links:
            link.system_status = status

    def poll(self) -> None:
        """One turn: read what has arrived, and send what is due. Never raises LinkLost."""
        now_ns = self._clock_ns()
        was_open = self._port.is_open
        if self._port.open_if_due(now_ns):
            if not was_open:
                self.protocol.opened(now_ns)
                self._set_state("waiting", str(self._port.connection))
            self._receive(now_ns)
            self._notice_aid(now_ns)
            self._send_due(now_ns)
        self._notice_loss()
        for link in self._report_links:
            link.poll()

    def publish_place(self, fix: PlaceFix) -> None:
        """Publish a place on every link: a line of text at most every five seconds, and values to plot."""
        now_ns = self._clock_ns()
        if self.state == "up":
            self._texts.put_place(fix, now_ns)
            self._send(encoders.plotted_values(fix, round((self.vehicle.boot_time_s(now_ns) or 0.0) * 1000)))
        for link in self._report_links:
            link.publish_place(fix)

    @property
    def is_ready_for_home(self) -> bool:
        """Whether the way home can be requested: the autopilot, its mode, and how good its position is, are known."""
        is_known = self.report().position is not None and self.uncertainty_m is not None
        return self.state == "up" and is_known and self.vehicle.drives_itself is not None

    def request_home(self, reply: Callable[[Answer], object], *, restore: bool = False) -> None:
        """Upload the way home as a mission, if [home] allows; `reply` gets each answer, the final one last.

        restore: the mission that it has replaced instead.
        """
        self._send(self.home.request(reply, self._clock_ns(), restore=restore))

    def position_due(self) -> TimeBase | None:
        """The moment of the position that is due to the autopilot: the last exposure's, or now. None while none is."""
        is_known = self.state == "up" and not self.vehicle.is_doubled
        return self.positions.due(self._clock_ns()) if is_known else None

    def send_position(self, fix: PlaceFix) -> bool:
        """Send the autopilot a position, by the message of [telemetry] emit and if [gates] allow; True if it was sent.

        The fix is of the moment that `position_due` returned.
        """
        if self.position_due() is None:
            return False
        messages = self.positions.send(fix, self._clock_ns())
        self._send(messages)
        return bool(messages)

    def status_text(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Queue a line for the pilot on every link; at most two a second are sent, and of many only the newest."""
        self._texts.put(text, severity)
        for link in self._report_links:
            link.texts.put(text, severity)

    def say_now(self, text: str, severity: int) -> None:
        """Send a heartbeat and a line on every link at once, even where no peer was heard: before the program ends."""
        for port in (self._port, *(link.port for link in self._report_links)):
            if port.open_if_due(self._clock_ns()):
                for message in (encoders.heartbeat(self._system_status), *encoders.status_text(text, severity)):
                    port.send(message)
        time.sleep(DRAIN_S)

    def restore_sources(self) -> None:
        """Select ArduPilot's first set of sources again, if we may have selected another; waits for the answer.

        Not while GPS is ignored: the vehicle would follow it as soon as this program ends.
        """
        if self._estimator.ignores_gps:
            return
        for _ in range(RESTORE_TRIES):
            messages = self.positions.sources.restore(self._clock_ns()) if self.state == "up" else []
            if not messages:
                break
            self._send(messages)
            time.sleep(DRAIN_S)
            self._receive(self._clock_ns())

    def close(self) -> None:
        """Close the links; more than once is harmless, and poll() would open them again."""
        self.restore_sources()
        abandoned = self.home.abandon(self._clock_ns())
        self._send(abandoned)
        if abandoned:
            time.sleep(DRAIN_S)
        self._port.close()
        for link in self._report_links:
            link.port.close()

    def _warn(self, text: str) -> None:
        self.status_text(text, mavlink.MAV_SEVERITY_WARNING)

    def _receive(self, now_ns: int) -> None:
        for message in self._port.receive():
            if self.vehicle.handle(message, now_ns):
                self._port.codec.system_id = self.vehicle.system_id or self._port.codec.system_id
                self._set_state("up")
                self._answer(message)
                if message.get_msgId() == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                    self._keep_position(now_ns)
            self._send(self.home.read(message, now_ns, is_for_us=self._is_for_us(message)))
        self.vehicle.expire(now_ns)
        if self._port.is_open and not self.vehicle.connected:
            self._set_state("waiting")

    def _is_for_us(self, message: Message) -> bool:
        target = getattr(message, "target_system", None), getattr(message, "target_component", None)
        return target == (self.vehicle.system_id, self._component_id)

    def _keep_position(self, now_ns: int) -> None:
        """With its accuracy: of the receiver behind it, else of the filter."""
        own, sender = self.vehicle.position(now_ns), self.positions
        if own is None:
            return
        receiver = self.vehicle.gps.behind(own, now_ns)
        source: PositionSource = "dead_reckoning"
        sigma_m = sender.uncertainty_m(now_ns)
        if self.vehicle.has_our_position:
            source = "place_fixes"
        elif receiver is not None:
            source, sigma_m = receiver.source, receiver.accuracy_m or self.vehicle.accuracy_m(now_ns)
        self.history.add(replace(own, sigma_m=sigma_m, source=source))

    def _answer(self, message: Message) -> None:
        now_ns = self._clock_ns()
        is_answer = message.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_ACK
        if is_answer and message.target_component not in (0, self._component_id):
            return
        self._send(self.protocol.answer(message, now_ns))
        if is_answer:
            self.positions.read_acknowledgement(message.command, message.result, now_ns)

    @property
    def _velocity_aid(self) -> str | None:
        return velocity_aid(self.vehicle, self.positions.set_without_gps)

    def _notice_aid(self, now_ns: int) -> None:
        """Whether something besides our positions is known to measure the autopilot's velocity, and whether we do.

        Where no positions are sent its parameters are not requested, and nothing of ours can come back.
        """
        is_by_gps = self.vehicle.gps.state(now_ns) == "healthy" and not self._estimator.ignores_gps
        self.vehicle.is_aided = is_by_gps or not self.positions.enabled or self._is_aided(now_ns)
        is_px4 = self.vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4
        self.vehicle.is_aided_by_camera = (
            is_px4 and not is_by_gps and self.velocity.is_on and self._velocity_aid == VISION
        )

    def _is_aided(self, now_ns: int) -> bool:
        """Whether anything besides GPS measures it; the camera of ours only while it sees the road."""
        aid = self._velocity_aid
        return aid not in (None, NO_AID) and not (aid == VISION and self.velocity.is_silent(now_ns))

    def send_velocity(self, speed: CameraSpeed) -> None:
        """Send the autopilot what the camera measured, if nothing speaks against it."""
        if self.state == "up" and self.velocity.is_on:
            self._send(self.velocity.send(speed, self._velocity_aid, self._clock_ns()))

    def _warn_without_velocity_aid(self, now_ns: int) -> None:
        """Once in a session, where none is known."""
        if self._has_warned or not self.positions.enabled:
            return
        aid = self._velocity_aid
        if aid == NO_AID:
            self._warn("Lookback: the autopilot has no velocity aid")
        elif aid is None and self.protocol.parameters.are_over(self.vehicle, now_ns):
            self._warn("Lookback: velocity aid not known, assuming none")
        else:
            return
        self._has_warned = True

    def _send_due(self, now_ns: int) -> None:
        self._send(self.protocol.heartbeat(self._system_status, now_ns))
        self._send(self.home.due(now_ns))
        if self.state != "up":
            return
        if self._session != self.vehicle.session:
            self._session = self.vehicle.session
            self.protocol.new_session()
            self._has_warned = False
            self.positions.new_session()
            self.history.clear()
        if self.vehicle.is_doubled != self._was_doubled:
            self._was_doubled = self.vehicle.is_doubled
            why = DOUBLED if self._was_doubled else ""
            self._record(LinkChanged(self.state, why))
            if why:
                self._warn(f"Lookback: {why}")
        self._send(self.protocol.requests(self._clock_ns()))
        self._warn_without_velocity_aid(now_ns)
        self._send(self.positions.follow_up(now_ns))
        self._send(self.positions.doubted_gps.due(now_ns))
        self._send(self._texts.due(now_ns))

    def _send(self, messages: list[Message]) -> None:
        for message in messages:
            self._port.send(message)
        self._notice_loss()

    def _notice_loss(self) -> None:
        if not self._port.is_open and (self.state != "closed" or self._port.why_closed):
            self.vehicle.reset_link()
            self._set_state("closed", self._port.why_closed)

    def _set_state(self, state: Literal["closed", "waiting", "up"], why: str = "") -> None:
        if state == self.state:
            return
        self.state = state
        if state == "up":
            self._port.peer_answered()
        else:
            self._port.peer_silent()
        log.info("link %s %s", state, why)
        self._record(LinkChanged(state, why))


def open_port(config: TelemetryConfig, link: LinkConfig, number: int, clock_ns: Callable[[], int]) -> Port:
    """The port of a link, not opened yet; ConfigError for a malformed connection, or a key that cannot be used."""
    signer = None
    where = "[[telemetry.links]] connection" if number else "[telemetry] connection"
    if link.signing_key:
        signer = Signer(load_key(link.signing_key), Path(f"{config.signing_clock}.{number}"), number, clock_ns=clock_ns)
    codec = MavlinkCodec(config.system_id or FIRST_SYSTEM_ID, config.component_id, signer)
    return Port(parse_connection(link.connection, where), codec, clock_ns)
