"""The connection to the autopilot: port, vehicle, requests and positions, joined into what the daemon polls."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import Config, GatesConfig, LinkConfig, TelemetryConfig
from edge.geodesy import PositionSource
from edge.journal.records import LinkChanged, Record
from edge.localization import (
    GPS_HEALTHY,
    TWO_AUTOPILOTS,
    AutopilotState,
    Discontinuity,
    Fix,
    FixFeedback,
    FixRequest,
    NoFix,
    PlaceFix,
    PositionEstimator,
)
from edge.telemetry import LinkStatus
from edge.telemetry.codec import MavlinkCodec, Message
from edge.telemetry.encoders import CARRIERS
from edge.telemetry.firmware import GPS_SET
from edge.telemetry.link import parse_connection
from edge.telemetry.link_protocol import Requests, VelocityAid
from edge.telemetry.people import GpsNews, PeopleLink, Publisher, ReportLink
from edge.telemetry.port import Port
from edge.telemetry.position_history import PositionHistory
from edge.telemetry.position_sender import DOUBTED, PositionSender, level_m
from edge.telemetry.session import Session
from edge.telemetry.stated_position import StatedPositions
from edge.telemetry.steering import Steering, SteeringMonitor
from edge.telemetry.vehicle import FIRST_SYSTEM_ID, Vehicle
from edge.telemetry.vehicle_velocity import slip
from edge.telemetry.wheel_store import WheelStore, in_percent

DRAIN_S = 0.1  # what a serial port has not sent yet is lost when it is closed
RESTORE_TRIES = 3
GPS_SPEED_NS = 500_000_000  # older, the speed is of another moment
log = logging.getLogger(__name__)


class Service(Protocol):
    """Messages that are exchanged with the autopilot for another purpose than positions: a mission, for one."""

    def read(self, message: Message, now_ns: int, *, is_for_us: bool) -> list[Message]:
        """Read a message of any component on the autopilot's link; the messages that are due because of it.

        is_for_us: addressed to this very component.
        """

    def due(self, now_ns: int) -> list[Message]:
        """What is due now, once a turn."""

    def abandon(self, now_ns: int) -> list[Message]:
        """The last messages: this program ends."""


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
        drive: PositionEstimator | None = None,
    ) -> None:
        """record: writes a record of what happens (`Journal.write`). ConfigError for a wrong connection or key.

        drive: gets what the autopilot reports and does; None: one without maps.
        """
        self.config, self.clock_ns, self.record = config, clock_ns, record
        self.state: Literal["closed", "waiting", "up"] = "closed"
        self.vehicle = vehicle = Vehicle(config.system_id, config.odometry_from)
        self.requests = Requests(config, vehicle)
        self._unplaced: Session | None = None  # in which that was said
        self._port = open_port(config, LinkConfig(config.connection, config.signing_key), 0, clock_ns)
        self._people = PeopleLink(self._port, vehicle)
        self._report_links = [
            ReportLink(open_port(config, link, number, clock_ns), vehicle, record)
            for number, link in enumerate(config.links, start=1)
        ]
        self.drive = drive = drive or PositionEstimator(Config(gates=gates))
        publisher = Publisher(record, self._warn)
        self.positions = PositionSender(config, gates, vehicle, drive, publisher)
        if config.emit != "report":  # a run before this one may have sent a position
            drive.update(clock_ns(), FixFeedback(None))
        self._wheels = WheelStore(config.journal, vehicle, lambda: drive.state.gps.state in DOUBTED)
        self._own: AutopilotState | None = None
        self.velocity_aid = VelocityAid(vehicle, publisher, sends=False)
        self._gps_news, self._steering = GpsNews(publisher), SteeringMonitor(vehicle, publisher)
        self.stated = StatedPositions(vehicle, drive, publisher)
        self._service: Service | None = None
        self.history = PositionHistory(clock_ns)
        """Its own positions at exposures, each with its accuracy and source."""
        self._was_doubled = False

    def use_camera_motion(self, *, sends: bool) -> None:
        """A camera measures the vehicle's motion, for which its turns are requested.

        sends: its velocity is sent, unless [telemetry] emit forbids. If that ends, nothing else is assumed to be.
        """
        self.requests = Requests(self.config, self.vehicle, asks_attitude=True)
        self.velocity_aid.sends = sends and self.config.emit != "report"

    @property
    def why_closed(self) -> str:
        """Why there is no port, "" while there is none yet."""
        return self._port.why_closed if self.state == "closed" else ""

    def judge_gps(self) -> None:
        """The places say something of GPS now."""
        news = self._gps_news.publish(self.drive.state.gps)
        is_ignored = news == "faulty" and self.drive.state.ignores_gps
        if is_ignored and not self.velocity_aid.is_known(self.clock_ns()):
            self._warn("Lookback: no velocity aid, sends no position")
        elif is_ignored and not self.positions.selects_sources:
            self.positions.sources.warn_that_gps_stays()
        _, missing = self.vehicle.velocity.witness(self.clock_ns())
        if news == "inconsistent" and missing:
            self._warn(f"Lookback: who is right? no {missing}")

    @property
    def why_no_position(self) -> str:
        """Why no position is sent, for people; "" while one is, and without a link."""
        why = self.positions.why_none(self.clock_ns()) if self.state == "up" else ""
        # By its receivers it is healthy, and "GPS faulty" is said beside it.
        return "the autopilot uses it" if self.gps_fault and why == GPS_HEALTHY else why

    @property
    def gps_fault(self) -> str:
        """What is wrong with GPS by the places, for people; "" where nothing is. How far it is off is in `status`."""
        return "GPS faulty" if self.drive.state.gps.state == "faulty" else ""

    def gps_motion(self) -> tuple[float | None, float]:
        """Speed by the autopilot, m/s, while a healthy GPS without a fault aids it, else None; and its lateral share.

        The share: velocity to the right of the heading over that along it.
        """
        now_ns = self.clock_ns()
        own, is_healthy = self.vehicle.position(now_ns), self.vehicle.session.gps.state(now_ns) == "healthy"
        is_good = is_healthy and not self.gps_fault
        if own is None or not is_good or now_ns - own.stamp_ns > GPS_SPEED_NS or own.heading_deg is None:
            return None, 0.0
        to_the_right = slip(own.east_mps, own.north_mps, own.heading_deg)
        return (None, 0.0) if to_the_right is None else (own.speed_mps, to_the_right)

    @property
    def steering(self) -> Steering:
        """By what the vehicle steers; unknown where no autopilot is heard."""
        return self._steering.state if self.state == "up" else Steering()

    def status(self) -> LinkStatus:
        """The link, and what the autopilot says of itself, for people."""
        now_ns, verdict, sent = self.clock_ns(), self.drive.state.gps, self.positions.use.newest
        position, gps = self.vehicle.position(now_ns), self.vehicle.session.gps
        along_m, cross_track_m = level_m(sent.fix.level) if sent else (None, None)
        scale, steering = self.vehicle.velocity.shown.scale, self.steering
        left = {name: self._port.sent[name] for name in CARRIERS if name in self._port.sent}
        return LinkStatus(
            state=self.state,
            connection=self.config.connection,
            emit=self.config.emit,
            lat_deg=position.lat_deg if position else None,
            lon_deg=position.lon_deg if position else None,
            heading_deg=position.heading_deg if position else None,
            speed_mps=self.vehicle.motion.speed_mps(now_ns),
            gps=gps.state(now_ns),
            gps_why=gps.why(now_ns),
            velocity_aid=self.velocity_aid.without_gps,
            wheels=in_percent(scale) if scale else None,
            gps_verdict=verdict.state,
            gps_off_m=verdict.distance_m,
            gps_off=verdict.where,
            gps_doubt=verdict.doubt,
            gps_use=steering.gps,
            steers_by=steering.by,
            reckoned_m=steering.reckoned_m,
            sent={name: count for name, (count, _) in left.items()},
            sent_ns=max((at_ns for _, at_ns in left.values()), default=None) if sent else None,
            sent_sigma_m=round(sent.place.sigma_m, 2) if sent else None,
            confirmed_ns=self.positions.use.confirmed_ns,
            level_along_m=along_m,
            level_cross_track_m=cross_track_m,
        )

    @property
    def _links(self) -> list[PeopleLink]:
        return [self._people, *self._report_links]

    def set_system_status(self, status: int) -> None:
        """MAV_STATE of our heartbeats from now on, on every link."""
        for link in self._links:
            link.system_status = status

    def speak_as(self, kind: int) -> None:
        """MAV_TYPE of our heartbeats from now on, on every link."""
        for link in self._links:
            link.kind = kind

    def poll(self) -> None:
        """One turn: read what has arrived, and send what is due. Never raises LinkLost."""
        now_ns = self.clock_ns()
        if self._port.open_if_due(now_ns):
            self._update_state()
            self.vehicle.velocity.has_our_position = self.drive.state.rests_on_fixes
            self._receive(now_ns)
            self._update_aid(now_ns)
        self._people.send_heartbeat(now_ns)
        if self._port.is_open:
            self._send_due(now_ns)
        self._update_state()
        for link in self._report_links:
            link.poll(now_ns)

    def publish_place(self, fix: PlaceFix) -> None:
        """Publish a place on every link: a line of text at most every five seconds, and values to plot."""
        now_ns = self.clock_ns()
        for link in self._links if self.state == "up" else self._report_links:
            link.publish_place(fix, now_ns)
        if self.requests.session is self.vehicle.session:
            self.requests.believe(fix)
        self._update_state()

    def position_due(self) -> FixRequest | None:
        """What holds for the position that is due to the autopilot, by [telemetry] emit; None while none is."""
        return self.positions.due(self.clock_ns()) if self.state == "up" else None

    def send_position(self, answer: Fix | NoFix) -> bool:
        """Send the autopilot the position that was due, or publish why there is none; True if it was sent."""
        messages = self.positions.send(answer, self.clock_ns())
        self.send(messages)
        return bool(messages)

    def report_own(self) -> None:
        """What the autopilot reports, to the estimator, where it is something new."""
        now_ns = self.clock_ns()
        own = self.vehicle.own(now_ns)
        if own != self._own:
            self._own = own
            self.drive.update(now_ns, own)

    def status_text(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Queue a line for the pilot on every link; at most two a second are sent, and of many only the newest."""
        for link in self._links:
            link.put(text, severity)

    def say_now(self, text: str, severity: int) -> None:
        """Send a heartbeat and a line on every link at once, even where no peer was heard: before the program ends."""
        for link in self._links:
            link.say_now(text, severity, self.clock_ns())
        time.sleep(DRAIN_S)

    def restore_sources(self) -> None:
        """Have the autopilot use GPS again, if we may have taken it away; waits for the answer.

        Not unless GPS is consistent with the places: the vehicle would follow it as soon as this program ends.
        """
        if self.drive.state.ignores_gps:  # it agreed before, and has been declared faulty since
            return
        for _ in range(RESTORE_TRIES):
            messages = self.positions.sources.restore(self.clock_ns()) if self.state == "up" else []
            if not messages:
                break
            self.send(messages)
            time.sleep(DRAIN_S)
            self._receive(self.clock_ns())

    def close(self) -> None:
        """Close the links; more than once is harmless, and poll() would open them again."""
        self.restore_sources()
        abandoned = self._service.abandon(self.clock_ns()) if self._service else []
        self.send(abandoned)
        if abandoned:
            time.sleep(DRAIN_S)
        for link in self._links:
            link.port.close()

    def serve(self, service: Service) -> None:
        """Let it exchange messages on the autopilot's link as well. RuntimeError where another one does."""
        if self._service:
            raise RuntimeError("the link has a service; a plug-in's is its attribute `service`")
        self._service = service

    def _warn(self, text: str) -> None:
        self.status_text(text, mavlink.MAV_SEVERITY_WARNING)

    def _receive(self, now_ns: int) -> None:
        for message in self._port.receive():
            if self.vehicle.handle(message, now_ns):
                self._port.codec.system_id = self.vehicle.system_id or self._port.codec.system_id
                self._update_state()
                self._answer(message)
                if message.get_msgId() == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                    self._keep_position(now_ns)
            if self._is_for_us(message):
                self.send(self.stated.read(message, now_ns))
            if self._service:
                self.send(self._service.read(message, now_ns, is_for_us=self._is_for_us(message)))
        self.vehicle.expire(now_ns)
        self._update_state()

    def _is_for_us(self, message: Message) -> bool:
        target = getattr(message, "target_system", None), getattr(message, "target_component", None)
        return target == (self.vehicle.system_id, self.config.component_id)

    def _keep_position(self, now_ns: int) -> None:
        """With its accuracy: of the receiver behind it, else of the filter."""
        vehicle = self.vehicle
        own = vehicle.position(now_ns)
        if own is None:
            return
        receiver = vehicle.session.gps.behind(own, now_ns)
        source: PositionSource = "dead_reckoning"
        sigma_m = self.drive.state.own_sigma_m
        if vehicle.velocity.has_our_position:
            source = "place_fixes"
        elif receiver is not None:
            source, sigma_m = receiver.source, receiver.accuracy_m or vehicle.accuracy_m(now_ns)
        self.history.add(replace(own, sigma_m=sigma_m, source=source))

    def _answer(self, message: Message) -> None:
        now_ns = self.clock_ns()
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
            self.positions.sources.read_text(message.text)
        is_answer = message.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_ACK
        if is_answer and message.target_component not in (0, self.config.component_id):
            return
        self.send(self.requests.answer(message, now_ns))
        if is_answer:
            self.positions.read_acknowledgement(message.command, message.result, now_ns)

    def _update_aid(self, now_ns: int) -> None:
        gps, positions = self.vehicle.session.gps.state(now_ns), self.positions
        is_by_gps = gps == "healthy" and not self.drive.state.ignores_gps
        may_be_fused = self.vehicle.session.gps.may_be_fused(is_selected=positions.sources.in_use == GPS_SET)
        self.vehicle.velocity.aid = self.velocity_aid.update(
            positions.sources.in_use,
            now_ns,
            is_by_gps=is_by_gps,
            may_be_gps=gps != "not healthy" and may_be_fused,
            is_needed=positions.enabled,
        )

    def _send_due(self, now_ns: int) -> None:
        if self._service:
            self.send(self._service.due(now_ns))
        if self.state != "up":
            return
        if self.requests.session is not self.vehicle.session:
            self.requests = Requests(self.config, self.vehicle, asks_attitude=self.requests.asks_attitude)
            self.positions.new_session()
            self.drive.update(now_ns, Discontinuity("reboot"))
            self.history.clear()
        if self.vehicle.is_doubled != self._was_doubled:
            self._was_doubled = self.vehicle.is_doubled
            why = TWO_AUTOPILOTS if self._was_doubled else ""
            self.record(LinkChanged(self.state, why))
            if why:
                self._warn(f"Lookback: {why}")
        self.send(self.requests.due(self.clock_ns()))
        if self.requests.waits_for_place and self._unplaced is not self.requests.session:
            self._unplaced = self.requests.session
            self._warn("Lookback: position not known, no origin set yet")
        if self.positions.enabled:
            self.velocity_aid.warn_without(all_came=self.requests.parameters.are_over(now_ns))
        self.report_own()
        if now_ns >= self._wheels.due_ns:
            self._wheels.keep(now_ns)
        self.send(self.positions.follow_up(now_ns, all_came=self.requests.parameters.are_over(now_ns)))
        is_selected = self.positions.sources.in_use == GPS_SET
        self._steering.update(now_ns, self.drive.state, self.positions.use.confirmed_ns, is_selected=is_selected)
        self.send(self._gps_news.values_due(self.drive.state.gps, self.vehicle.boot_ms(now_ns), now_ns))
        self._people.send_line(now_ns)

    def send(self, messages: list[Message]) -> None:
        """Send messages to the autopilot, as far as the port takes them."""
        self._people.send(messages)
        if not self._port.is_open:
            self._update_state()

    def _update_state(self) -> None:
        """Follow the port and the autopilot's heartbeats; each change is recorded."""
        state: Literal["closed", "waiting", "up"] = "closed"
        if self._port.is_open:
            state = "up" if self.vehicle.connected else "waiting"
        elif self.state != "closed" or self._port.why_closed:
            self.vehicle.reset_link()
        if state == self.state:
            return
        before, self.state = self.state, state
        if state == "up":
            self._port.peer_answered()
        else:
            self._port.peer_silent()
        why = self._port.why_closed if state == "closed" else ""
        if before == "closed" and state == "waiting":
            why = str(self._port.connection)
        log.info("link %s %s", state, why)
        self.record(LinkChanged(state, why))


def open_port(config: TelemetryConfig, link: LinkConfig, number: int, clock_ns: Callable[[], int]) -> Port:
    """The port of a link, not opened yet; ConfigError for a malformed connection, or a key that cannot be used."""
    signer = None
    where = "[[telemetry.links]] connection" if number else "[telemetry] connection"
    if link.signing_key:
        from edge.telemetry.signing import Signer, load_key  # which few links need

        signer = Signer(load_key(link.signing_key), Path(f"{config.signing_clock}.{number}"), number)
    codec = MavlinkCodec(config.system_id or FIRST_SYSTEM_ID, config.component_id, signer)
    return Port(parse_connection(link.connection, where), codec, clock_ns)
