"""What the autopilot reports about its vehicle: identity, time and position; `vehicle_motion` is how it moves.

No I/O: messages and the time come in as arguments.
"""

from __future__ import annotations

import logging
import math
import struct
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from edge.geodesy import VehiclePosition, moved
from edge.telemetry.boot_clock import BootClock
from edge.telemetry.codec import EkfStatusReport, Message
from edge.telemetry.confirmation import JUMP_MS, AnotherClock, Modes, Origin, Origins
from edge.telemetry.gps import Gps
from edge.telemetry.position_history import Alternation
from edge.telemetry.position_messages import autopilot_name
from edge.telemetry.vehicle_motion import POSITIONS_APART_S, VehicleMotion, signed_speed

LINK_TIMEOUT_NS = 5_000_000_000
POSITION_FRESH_NS = 2_000_000_000
ACCURACY_FRESH_NS = 3_000_000_000
DOUBLED = "two autopilots have the same ids"
POSITIONS = (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
HEADING_UNKNOWN = 65535
PX4_INTEGERS = {mavlink.MAV_PARAM_TYPE_INT32: "<i", mavlink.MAV_PARAM_TYPE_UINT32: "<I"}

log = logging.getLogger(__name__)


class Vehicle(VehicleMotion):
    """The one vehicle on a link, known by its heartbeats; messages of all others are ignored.

    Noise on a serial line passes MAVLink's checksum now and then, so two heartbeats of the same autopilot make a
    link, and only messages of that system and of component 1 count.
    """

    def __init__(self, system_id: int = 0) -> None:
        """system_id: the only one whose heartbeats count; 0 is the first that is heard."""
        super().__init__()
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
        self._version_ns = 0  # when it arrived
        self._origins, self._another_clock = Origins(), AnotherClock()
        self.is_doubled = False
        """Whether another autopilot sends with the same ids: then nothing is known of either."""
        self._alternation, self._local_alternation = Alternation(), Alternation()
        self._heard_ns: dict[int, int] = {}  # heartbeats, by system
        self._message_ns: dict[int, int] = {}  # of this session, by message id
        self._clock = BootClock()
        self._newest_boot_ms = -1
        self._timesync_sent_ns = 0
        self._position: VehiclePosition | None = None
        self.gps = Gps()
        self._accuracy: tuple[int, float] | None = None
        self._handlers: dict[int, Callable[[Message, int], object]] = {
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._read_global_position,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._read_local_position,
            mavlink.MAVLINK_MSG_ID_ODOMETRY: self._read_odometry,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._read_attitude,
            mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE: self._read_wheels,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: lambda hud, now_ns: self._add_speed(now_ns, hud.groundspeed, source=4),
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._read_gps,
            mavlink.MAVLINK_MSG_ID_GPS2_RAW: self._read_gps,
            EkfStatusReport.id: lambda ekf, now_ns: self.gps.read_filter(ekf.flags, self.autopilot, now_ns),
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: lambda status, now_ns: self.gps.read_sensors(
                status.onboard_control_sensors_present, now_ns
            ),
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: lambda time, now_ns: self._read_boot_time(time.time_boot_ms, now_ns),
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
        if reader is not None and (not self.is_doubled or message.get_msgId() in POSITIONS):
            reader(message, now_ns)
            self._notice_double(now_ns)
        return True

    def _notice_double(self, now_ns: int) -> None:
        if any(one.is_found(now_ns) for one in (self._alternation, self._local_alternation)) != self.is_doubled:
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
        self._end_leg(is_same_vehicle=is_same_vehicle)
        self._newest_boot_ms = -1
        self.gps = Gps()
        self._accuracy = self._position = None
        if not self._another_clock.has_begun_by(self._version_ns):  # a version may come before the reboot is sure
            self.version = None
        self._origins, self._another_clock = Origins(), AnotherClock()

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
        before, self._position = self._position, now
        self._move(before, now)

    def _read_local_position(self, message: Message, now_ns: int) -> None:
        stamp_ns = self._read_boot_time(message.time_boot_ms, now_ns)
        if stamp_ns is None:
            return
        at = stamp_ns, *moved(0.0, 0.0, message.y, message.x), 0.0, None
        self._local_alternation.add(VehiclePosition(*at, 0.0, message.vy, message.vx), now_ns)
        if self.is_doubled:
            return
        self._origins.add_local(stamp_ns, message.y, message.x)
        own = self.position(now_ns)
        heading_deg = own.heading_deg if own else None
        self._add_speed(stamp_ns, signed_speed(message.vy, message.vx, heading_deg), source=0)
        if self._position is None or stamp_ns - self._position.stamp_ns > POSITIONS_APART_S * 1e9:
            self._add_velocity(stamp_ns, message.vy, message.vx, heading_deg)

    def _read_attitude(self, message: Message, now_ns: int) -> None:
        stamp_ns = self._read_boot_time(message.time_boot_ms, now_ns)
        if stamp_ns is not None:
            self._turn(stamp_ns, message.pitchspeed, message.yawspeed)

    def _read_odometry(self, message: Message, now_ns: int) -> None:
        # Its time may be of any clock; its velocity is in the body's frame, of which the horizontal length matters.
        self._add_speed(now_ns, signed_speed(message.vy, message.vx, 0.0), source=2)

    def _read_wheels(self, message: Message, now_ns: int) -> None:
        """Cumulative meters of up to 16 wheels. The mean, since both sides turn against each other on the spot."""
        stamp_ns = self._read_boot_time(message.time_usec // 1000, now_ns)
        if stamp_ns is None:
            return
        driven_m = sum(message.distance[: message.count]) / max(message.count, 1)
        self._turn_wheels(stamp_ns, driven_m)

    def _read_estimator(self, message: Message, now_ns: int) -> None:
        self.gps.read_filter(message.flags, self.autopilot, now_ns)
        if math.isfinite(message.pos_horiz_accuracy) and message.pos_horiz_accuracy > 0:
            self._accuracy = now_ns, message.pos_horiz_accuracy

    def _read_origin(self, message: Message, now_ns: int) -> None:
        if message.latitude or message.longitude:
            origin = Origin(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1000)
            self._origins.add(origin, self.position(now_ns), now_ns)

    def _read_version(self, message: Message, now_ns: int) -> None:
        self._version_ns = now_ns
        self.version = message.flight_sw_version >> 24, message.flight_sw_version >> 16 & 0xFF

    def _read_parameter(self, message: Message, now_ns: int) -> None:
        value, layout = float(message.param_value), PX4_INTEGERS.get(message.param_type)
        if self.autopilot == mavlink.MAV_AUTOPILOT_PX4 and layout:
            # PX4 puts the bytes of an integer where the float goes; ArduPilot converts.
            value = float(struct.unpack(layout, struct.pack("<f", value))[0])
        if math.isfinite(value):
            self.parameters[str(message.param_id).rstrip("\0")] = value

    def _read_gps(self, message: Message, now_ns: int) -> None:
        self.gps.receivers[message.get_msgId() == mavlink.MAVLINK_MSG_ID_GPS2_RAW].read(message, now_ns)

    def _read_timesync(self, message: Message, now_ns: int) -> None:
        boot_ns = message.tc1 or message.ts1  # the latter: the autopilot's own request, stamped when it was sent
        if self._is_of_another_clock(boot_ns // 1_000_000, now_ns):
            return
        if message.tc1 == 0:
            self._clock.add_stamp(boot_ns, now_ns)
        elif message.ts1 == self._timesync_sent_ns:
            self._clock.add_answer(message.ts1, message.tc1, now_ns)
