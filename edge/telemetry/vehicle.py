"""What the autopilot reports about its vehicle: identity, time, position, and how far it has driven.

No I/O: messages and the time come in as arguments.
"""

from __future__ import annotations

import logging
import math
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from pymavlink.dialects.v20 import common as mavlink

from edge.geodesy import VehiclePosition, east_north_of
from edge.localization import PULLED_NS, DeadReckoning, Displacement, ReportedMotion
from edge.telemetry.boot_clock import BootClock
from edge.telemetry.codec import EkfStatusReport, Message
from edge.telemetry.confirmation import JUMP_MS, AnotherClock, Modes, Origin, Origins
from edge.telemetry.gps import Gps
from edge.telemetry.position_history import Alternation
from edge.telemetry.position_messages import autopilot_name

LINK_TIMEOUT_NS = 5_000_000_000
POSITION_FRESH_NS = 2_000_000_000
ACCURACY_FRESH_NS = 3_000_000_000
WHEELS_APART_NS = 2_500_000_000
MOST_SHARE, SLOW_MPS = 0.5, 2.0
"""Of the speed, but at least of SLOW_MPS: by which a velocity that nothing measures may be uncertain to be of use."""
STAYS, LEAST_DRIFT = 0.37, 0.05
"""How much of that stays over a line, since it changes within seconds: with it, positions on simulated drives are about
as wrong as they say. And the least share of a distance by which it may be wrong."""
MAY_BE = 0.5
"""Standard deviations of a speed that nothing measures, at which frames are used where it seems to be less: one in 4 m
at a deviation of 2 m/s and a true speed of 8."""
SPEED_FRESH_NS = 5_000_000_000
"""How long a speed of the wheels holds, and an error that was found: that comes with each used frame."""
POSITIONS_APART_S = 0.5
PULLS_KEPT = 16
"""More than are sent within PULLED_NS."""
ALIKE_MPS, ALIKE = 0.5, 0.1
"""By how much the velocity between two positions may differ from the reported one, and by which share of it."""
DOUBLED = "two autopilots have the same ids"
HEADING_UNKNOWN = 65535
PX4_INTEGERS = {mavlink.MAV_PARAM_TYPE_INT32: "<i", mavlink.MAV_PARAM_TYPE_UINT32: "<I"}
BACKWARDS_COS = -0.5  # of the angle between velocity and heading; a multirotor may fly to the side

log = logging.getLogger(__name__)


class Vehicle:
    """The one vehicle on a link, known by its heartbeats; messages of all others are ignored.

    Noise on a serial line passes MAVLink's checksum now and then, so two heartbeats of the same autopilot make a
    link, and only messages of that system and of component 1 count.
    """

    def __init__(self, system_id: int = 0) -> None:
        """system_id: the only one whose heartbeats count; 0 is the first that is heard."""
        self._only_system_id = system_id
        self.system_id: int | None = None
        self.autopilot: int | None = None
        self.kind: int | None = None
        """MAV_TYPE of the vehicle, None until connected."""
        self._modes = Modes()
        self.parameters: dict[str, float] = {}
        """Those that the autopilot has sent in this session."""
        self.connected = False
        self.session = 0
        """Counts up when the link comes up and when the autopilot reboots: streams must be requested again."""
        self.version: tuple[int, int] | None = None
        """Major and minor of the firmware, None until AUTOPILOT_VERSION arrived."""
        self._origins, self._another_clock = Origins(), AnotherClock()
        self.is_doubled = False
        """Whether another autopilot sends with the same ids: then nothing is known of either."""
        self._alternation = Alternation()
        self._heard_ns: dict[int, int] = {}  # heartbeats, by system
        self._message_ns: dict[int, int] = {}  # of this session, by message id
        self._clock = BootClock()
        self._newest_boot_ms = -1
        self._timesync_sent_ns = 0
        self._motion = DeadReckoning()
        self._position: VehiclePosition | None = None
        self.gps = Gps()
        self._accuracy: tuple[int, float] | None = None
        self._wheels: tuple[int, float] | None = None
        self._wheel_speed: tuple[int, float] | None = None
        self._error: tuple[int, tuple[float, float]] | None = None
        self._error_sigma_mps = 0.0
        self._pulls: deque[tuple[int, float]] = deque(maxlen=PULLS_KEPT)
        """When positions of ours were sent, and how far they were from the autopilot's own."""
        self._velocity_mps, self._heading_rad = (0.0, 0.0), 0.0
        self.is_aided = True
        """Whether something besides our positions measures the autopilot's velocity. Where nothing does, the vehicle
        moves ahead at the speed of its wheels, or at that velocity less the error that was found from places."""
        self.has_our_position = False
        """Whether a position that we sent may have moved the autopilot's own since GPS bounded it last."""
        self._handlers: dict[int, Callable[[Message, int], None]] = {
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._read_global_position,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._read_local_position,
            mavlink.MAVLINK_MSG_ID_ODOMETRY: self._read_odometry,
            mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE: self._read_wheels,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._read_vfr_hud,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._read_first_gps,
            mavlink.MAVLINK_MSG_ID_GPS2_RAW: self._read_second_gps,
            EkfStatusReport.id: self._read_ekf_status,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._read_sensors,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._read_system_time,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._read_timesync,
            mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._read_estimator,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._read_origin,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._read_version,
            mavlink.MAVLINK_MSG_ID_PARAM_VALUE: self._read_parameter,
        }

    def handle(self, message: Message, now_ns: int) -> bool:
        """Read one message that was received at `now_ns`; True when it is from the vehicle."""
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
            return False
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return self._read_heartbeat(message, now_ns)
        if not self.connected or message.get_srcSystem() != self.system_id:
            return False
        self._message_ns[message.get_msgId()] = now_ns
        reader = self._handlers.get(message.get_msgId())
        if reader is not None and (not self.is_doubled or reader == self._read_global_position):
            reader(message, now_ns)
            self._notice_double(now_ns)
        return True

    def _notice_double(self, now_ns: int) -> None:
        if self._alternation.is_found(now_ns) != self.is_doubled:
            self.is_doubled = not self.is_doubled
            log.error("system %s is %s", self.system_id, "two autopilots" if self.is_doubled else "one autopilot again")
            self._start_session(is_same_vehicle=False)

    @property
    def drives_itself(self) -> bool | None:
        """Whether it is armed, in a mode in which it finds its own way; None where the mode is not known."""
        return self._modes.drives_itself

    @property
    def origin(self) -> Origin | None:
        """The origin of its local frame, None until it is known: it may have none."""
        return self._origins.known

    def heard_ns(self, message_id: int) -> int | None:
        """When a message came last in this session, None before the first."""
        return self._message_ns.get(message_id)

    def expire(self, now_ns: int) -> None:
        """The link is down when no heartbeat has come for five seconds."""
        if self.connected and now_ns - self._heard_ns[self.system_id or 0] > LINK_TIMEOUT_NS:
            log.warning("system %s has sent no heartbeat for %d s", self.system_id, LINK_TIMEOUT_NS // 10**9)
            self.reset_link()

    def reset_link(self) -> None:
        """Two heartbeats are needed again; the distance driven so far stays."""
        self.connected = False
        self._heard_ns.clear()

    def timesync_sent(self, now_ns: int) -> None:
        """Our TIMESYNC request, stamped `now_ns`, was sent."""
        self._timesync_sent_ns = now_ns

    def boot_time_s(self, monotonic_ns: int) -> float | None:
        """Seconds since the autopilot's boot at that moment of CLOCK_MONOTONIC; None until it has reported its time."""
        boot_ns = self._clock.boot_ns(monotonic_ns)
        return None if boot_ns is None else boot_ns / 1e9

    def distance_m(self, stamp_ns: int) -> float | None:
        """Meters driven since the first report, at the moment of a frame; None when no speed is known around it."""
        return self._motion.distance_m(stamp_ns)

    def motion(self, stamp_ns: int, now_ns: int) -> ReportedMotion:
        """What was reported of the motion, at the moment of a frame."""
        is_measured = self._is_speed_measured(now_ns)
        pulled_m = max((off_m for sent_ns, off_m in self._pulls if now_ns - sent_ns <= PULLED_NS), default=0.0)
        return ReportedMotion(self.distance_m(stamp_ns), is_measured, self._velocity_mps, self._heading_rad, pulled_m)

    def expect_pull(self, off_m: float, now_ns: int) -> None:
        """A position of ours is sent, so far from the autopilot's own."""
        self.has_our_position = True
        self._pulls.append((now_ns, off_m))

    def _is_speed_measured(self, now_ns: int) -> bool:
        return self.is_aided or _newest(self._wheel_speed, now_ns) is not None

    def use_velocity_error(self, error_mps: tuple[float, float], sigma_mps: float, now_ns: int) -> None:
        """What the velocity is wrong by, and one standard deviation of that ahead; of use while nothing measures it."""
        self._error, self._error_sigma_mps = (now_ns, error_mps), sigma_mps

    @property
    def distance_gaps(self) -> int:
        """How often the reports of speed paused for so long that the distance driven meanwhile is not known."""
        return self._motion.gaps

    def driven_m(self, now_ns: int) -> float | None:
        """Meters driven up to the newest report; None when no speed has come for a second."""
        return None if self._motion.speed_mps(now_ns) is None else self._motion.total_m

    def displacement(self, stamp_ns: int) -> Displacement | None:
        """Meters east and north at the moment of a frame, by the autopilot's own velocity."""
        moved = self._motion.displacement(stamp_ns)
        if moved is None or self._is_speed_measured(stamp_ns):
            return moved
        share = self._error_sigma_mps / max(self._motion.speed_mps(stamp_ns) or 0.0, SLOW_MPS)
        return replace(moved, drift=max(STAYS * share, LEAST_DRIFT)) if share <= MOST_SHARE else None

    def speed_mps(self, now_ns: int) -> float | None:
        """Ground speed, None when the newest is over a second old."""
        return self._motion.speed_mps(now_ns)

    def position(self, now_ns: int) -> VehiclePosition | None:
        """The autopilot's own position, None when it has none or the newest is over two seconds old."""
        if self._position is None or now_ns - self._position.stamp_ns > POSITION_FRESH_NS:
            return None
        return self._position

    def accuracy_m(self, now_ns: int) -> float | None:
        """Horizontal accuracy of its position as the autopilot reports it, None where it does not (ArduPilot)."""
        if self._accuracy is None or now_ns - self._accuracy[0] > ACCURACY_FRESH_NS:
            return None
        return self._accuracy[1]

    def _read_heartbeat(self, message: Message, now_ns: int) -> bool:
        sender = message.get_srcSystem()
        only_id = self.system_id if self.connected else self._only_system_id
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID or only_id not in (0, sender):
            return False
        before_ns, self._heard_ns[sender] = self._heard_ns.get(sender), now_ns
        if not self.connected and before_ns is not None and now_ns - before_ns <= LINK_TIMEOUT_NS:
            is_same_vehicle = sender == self.system_id
            self.connected, self.system_id = True, sender
            self.autopilot, self.kind = message.autopilot, message.type
            self._modes = Modes()
            self._start_session(is_same_vehicle=is_same_vehicle)
            log.info("link up: system %d, %s", sender, autopilot_name(message.autopilot))
        if self.connected:
            self._modes.add(message.base_mode, now_ns)
        return self.connected

    def _start_session(self, *, is_same_vehicle: bool) -> None:
        self.session += 1
        self._message_ns.clear()
        self.parameters.clear()
        self._clock = BootClock()
        self._motion.end_leg(is_same_vehicle=is_same_vehicle)
        self._newest_boot_ms = -1
        self.gps = Gps()
        self._pulls.clear()
        self._accuracy = self._wheels = self._wheel_speed = self._error = self._position = None
        self.is_aided = True
        self._origins, self._another_clock, self.version = Origins(), AnotherClock(), None

    def _read_boot_time(self, boot_ms: int, now_ns: int, *, has_position: bool = False) -> int | None:
        """Add a message's stamp to the boot clock; returns the same moment on CLOCK_MONOTONIC.

        None, and the message must not be used, where the stamp is of another clock: a reboot is not sure yet.
        """
        boot_ms = self._clock.unwrapped_ms(boot_ms, now_ns)
        if self._is_of_another_clock(boot_ms, now_ns):
            if not self._another_clock.is_sure(now_ns, has_position=has_position):
                return None
            if not self.is_doubled:
                log.warning("the autopilot has rebooted: its clock jumped to %d ms", boot_ms)
            self._start_session(is_same_vehicle=not self.is_doubled)
        elif self._another_clock.contradict():
            self._alternation.notice(now_ns)
        self._newest_boot_ms = max(boot_ms, self._newest_boot_ms)
        self._clock.add_stamp(boot_ms * 1_000_000, now_ns)
        return min(self._clock.monotonic_ns(boot_ms * 1_000_000) or now_ns, now_ns)

    def _is_of_another_clock(self, boot_ms: int, now_ns: int) -> bool:
        """Whether it is before the newest stamp, or ahead of the clock, by more than messages overtake each other."""
        boot_ns = self._clock.boot_ns(now_ns)
        is_ahead = boot_ns is not None and boot_ms > boot_ns / 1e6 + JUMP_MS
        return is_ahead or boot_ms < self._newest_boot_ms - JUMP_MS

    def _read_global_position(self, message: Message, now_ns: int) -> None:
        stamp_ns = self._read_boot_time(message.time_boot_ms, now_ns, has_position=True)
        if stamp_ns is None or (message.lat == 0 and message.lon == 0):
            return  # the latter: ArduPilot without an origin, neither a position nor a speed
        speed_mps = math.hypot(message.vx, message.vy) / 100
        heading_deg = None if message.hdg == HEADING_UNKNOWN else message.hdg / 100
        now = VehiclePosition(
            stamp_ns,
            message.lat / 1e7,
            message.lon / 1e7,
            message.alt / 1000,
            heading_deg,
            speed_mps,
            message.vx / 100,
            message.vy / 100,
        )
        self._alternation.add(now, now_ns)
        if self.is_doubled:
            return
        self._add_speed(stamp_ns, signed_speed(now.east_mps, now.north_mps, heading_deg), source=1)
        before, self._position = self._position, now
        found_mps = self._east_north_mps(before, now)
        self._add_velocity(stamp_ns, *found_mps, heading_deg, (now.east_mps, now.north_mps))

    def _east_north_mps(self, before: VehiclePosition | None, now: VehiclePosition) -> tuple[float, float]:
        """Velocity by two positions, while no position of ours has moved them; else, and over jumps, as reported.

        Without GPS, ArduPilot's positions drift by a third of the angle by which its velocity does (recorded on Rover
        4.6.3: median 0.4 and 1.0 deg), since its compass corrects them afterwards.
        """
        reported = now.east_mps, now.north_mps
        apart_s = 0.0 if before is None else (now.stamp_ns - before.stamp_ns) / 1e9
        if before is None or self.has_our_position or not 0 < apart_s <= POSITIONS_APART_S:
            return reported
        moved_m = east_north_of(now.lat_deg, now.lon_deg, (before.lat_deg, before.lon_deg))
        by_positions = moved_m[0] / apart_s, moved_m[1] / apart_s
        return by_positions if math.dist(by_positions, reported) <= ALIKE_MPS + ALIKE * now.speed_mps else reported

    def _read_local_position(self, message: Message, now_ns: int) -> None:
        stamp_ns = self._read_boot_time(message.time_boot_ms, now_ns)
        if stamp_ns is None:
            return
        self._origins.add_local(stamp_ns, message.y, message.x)
        own = self.position(now_ns)
        heading_deg = own.heading_deg if own else None
        self._add_speed(stamp_ns, signed_speed(message.vy, message.vx, heading_deg), source=0)
        if self._position is None or stamp_ns - self._position.stamp_ns > POSITIONS_APART_S * 1e9:
            self._add_velocity(stamp_ns, message.vy, message.vx, heading_deg)

    def _read_odometry(self, message: Message, now_ns: int) -> None:
        # Its time may be of any clock; its velocity is in the body's frame, of which the horizontal length matters.
        self._add_speed(now_ns, signed_speed(message.vy, message.vx, 0.0), source=2)

    def _read_wheels(self, message: Message, now_ns: int) -> None:
        """Cumulative meters of up to 16 wheels. The mean, since both sides turn against each other on the spot."""
        stamp_ns = self._read_boot_time(message.time_usec // 1000, now_ns)
        if stamp_ns is None:
            return
        driven_m = sum(message.distance[: message.count]) / max(message.count, 1)
        before, self._wheels = self._wheels, (stamp_ns, driven_m)
        if before is not None and 0 < stamp_ns - before[0] <= WHEELS_APART_NS:
            self._wheel_speed = stamp_ns, (driven_m - before[1]) / (stamp_ns - before[0]) * 1e9
            self._motion.add_speed(*self._wheel_speed, source=3)

    def _read_vfr_hud(self, message: Message, now_ns: int) -> None:
        self._add_speed(now_ns, message.groundspeed, source=4)

    def _add_speed(self, stamp_ns: int, speed_mps: float, source: int) -> None:
        """A speed by the autopilot's estimate, which counts only where something aids that."""
        if self.is_aided:
            self._motion.add_speed(stamp_ns, speed_mps, source)

    def _add_velocity(
        self,
        stamp_ns: int,
        east_mps: float,
        north_mps: float,
        heading_deg: float | None,
        reported_mps: tuple[float, float] | None = None,
    ) -> None:
        """A velocity by the autopilot's estimate; where nothing aids that, only what is known of it ahead counts."""
        self._velocity_mps = east_mps, north_mps
        if heading_deg is not None:
            self._heading_rad = math.radians(heading_deg)
        if not self.is_aided:
            sin, cos = math.sin(self._heading_rad), math.cos(self._heading_rad)
            speed_mps = _newest(self._wheel_speed, stamp_ns)
            if speed_mps is None and self._error is not None and stamp_ns - self._error[0] <= SPEED_FRESH_NS:
                east_error_mps, north_error_mps = self._error[1]
                speed_mps = (east_mps - east_error_mps) * sin + (north_mps - north_error_mps) * cos
                # As fast as it may well be, or it would use no frame that could say that it does not stand.
                self._motion.add_speed(stamp_ns, max(speed_mps, MAY_BE * self._error_sigma_mps), source=1)
            if speed_mps is None or heading_deg is None:
                return
            east_mps, north_mps = speed_mps * sin, speed_mps * cos
            reported_mps = None
        self._motion.add_velocity(stamp_ns, east_mps, north_mps, reported_mps)

    def _read_estimator(self, message: Message, now_ns: int) -> None:
        self.gps.read_filter(message.flags, self.autopilot, now_ns)
        if math.isfinite(message.pos_horiz_accuracy) and message.pos_horiz_accuracy > 0:
            self._accuracy = now_ns, message.pos_horiz_accuracy

    def _read_origin(self, message: Message, now_ns: int) -> None:
        if message.latitude or message.longitude:
            origin = Origin(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1000)
            self._origins.add(origin, self.position(now_ns), now_ns)

    def _read_version(self, message: Message, now_ns: int) -> None:
        self.version = message.flight_sw_version >> 24, message.flight_sw_version >> 16 & 0xFF

    def _read_parameter(self, message: Message, now_ns: int) -> None:
        value, layout = float(message.param_value), PX4_INTEGERS.get(message.param_type)
        if self.autopilot == mavlink.MAV_AUTOPILOT_PX4 and layout:
            # PX4 puts the bytes of an integer where the float goes; ArduPilot converts.
            value = float(struct.unpack(layout, struct.pack("<f", value))[0])
        if math.isfinite(value):
            self.parameters[str(message.param_id).rstrip("\0")] = value

    def _read_first_gps(self, message: Message, now_ns: int) -> None:
        self.gps.receivers[0].read(message, now_ns)

    def _read_second_gps(self, message: Message, now_ns: int) -> None:
        self.gps.receivers[1].read(message, now_ns)

    def _read_ekf_status(self, message: Message, now_ns: int) -> None:
        self.gps.read_filter(message.flags, self.autopilot, now_ns)

    def _read_sensors(self, message: Message, now_ns: int) -> None:
        self.gps.read_sensors(message.onboard_control_sensors_present, now_ns)

    def _read_system_time(self, message: Message, now_ns: int) -> None:
        self._read_boot_time(message.time_boot_ms, now_ns)

    def _read_timesync(self, message: Message, now_ns: int) -> None:
        boot_ns = message.tc1 or message.ts1  # the latter: the autopilot's own request, stamped when it was sent
        if self._is_of_another_clock(boot_ns // 1_000_000, now_ns):
            return
        if message.tc1 == 0:
            self._clock.add_stamp(boot_ns, now_ns)
        elif message.ts1 == self._timesync_sent_ns:
            self._clock.add_answer(message.ts1, message.tc1, now_ns)


def _newest(speed: tuple[int, float] | None, now_ns: int) -> float | None:
    """A speed of some moment in m/s, None where it is too old."""
    return None if speed is None or now_ns - speed[0] > SPEED_FRESH_NS else speed[1]


def signed_speed(east_mps: float, north_mps: float, heading_deg: float | None) -> float:
    """Ground speed, negative where the vehicle moves backwards; a heading that is not known says nothing."""
    speed_mps, heading_rad = math.hypot(east_mps, north_mps), math.radians(heading_deg or 0.0)
    ahead_mps = east_mps * math.sin(heading_rad) + north_mps * math.cos(heading_rad)
    return -speed_mps if heading_deg is not None and ahead_mps < BACKWARDS_COS * speed_mps else speed_mps
