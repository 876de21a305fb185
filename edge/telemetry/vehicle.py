"""What the autopilot reports about its vehicle: identity, time and position; `vehicle_velocity` is how fast.

No I/O: messages and the time come in as arguments.
"""

from __future__ import annotations

import logging
import math
import struct
from collections import deque
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import VehiclePosition
from edge.localization import AutopilotState, DeadReckoning, GpsFix
from edge.telemetry.codec import FusionStatus, Message
from edge.telemetry.session import ARMED, FINDS_ITS_WAY, Modes, Origin, Session
from edge.telemetry.vehicle_velocity import LOCAL, POSITIONS_APART_S, VehicleVelocity, signed_speed

LINK_TIMEOUT_NS = 5_000_000_000
POSITION_FRESH_NS = 2_000_000_000
LINK_SILENT_NS = 300_000_000
"""Autopilots send positions at 10 Hz, as was requested. Of 5,673 positions of 43 recorded drives, two were sent after
so long a silence, both to an autopilot that was rebooting."""
ACCURACY_FRESH_NS = 3_000_000_000
POSITIONS = (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
HEADING_UNKNOWN = 65535
TURNS, TURNS_NS = 3, 10_000_000_000
"""How often within TURNS_NS stamps of two clocks come in turns, before two autopilots are found: a single one reboots
once in that time."""
FIRST_SYSTEM_ID = 1
INTEGERS = {mavlink.MAV_PARAM_TYPE_INT32: "<i", mavlink.MAV_PARAM_TYPE_UINT32: "<I"}

log = logging.getLogger(__name__)


class Vehicle:
    """The one vehicle on a link, known by its heartbeats; messages of all others are ignored.

    Noise on a serial line passes MAVLink's checksum now and then, so two heartbeats of the same autopilot make a
    link, and only messages of that system and of component 1 count.
    """

    def __init__(self, system_id: int = 0, odometry_from: tuple[int, ...] = ()) -> None:
        """system_id: the only one whose heartbeats count; 0 is the first that is heard.

        odometry_from: system and component whose ODOMETRY counts; () is nobody's.
        """
        self._only_system_id, self._odometry_from = system_id, odometry_from
        self.system_id: int | None = None
        self.connected = False
        self.session = Session()
        """Another one when the link comes up and when the autopilot reboots: streams must be requested again."""
        self.motion = DeadReckoning()
        """The distance driven and the displacement, of all sessions."""
        self.velocity = VehicleVelocity(self.motion)
        self.is_doubled = False
        """Whether another autopilot sends with the same ids, by its clock: what has its stamps is ignored. Nor is any
        position sent, which both would take."""
        self.fuses_poses = False
        """Whether it gets keypoint poses as measurements."""
        self._has_warned = False
        self._turns_ns: deque[int] = deque(maxlen=TURNS)
        self._heard_ns, self._read_ns = 0, 0
        self._beats_ns: dict[int, int] = {}  # heartbeats, by system
        self._modes = Modes()

    def handle(self, message: Message, now_ns: int) -> bool:
        """Read one message that was received at `now_ns`; True when it is from the vehicle."""
        is_own = self._handle(message, now_ns)
        if is_own:
            self._heard_ns = now_ns
        return is_own

    def _handle(self, message: Message, now_ns: int) -> bool:
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_ODOMETRY:
                self._read_odometry(message, now_ns)
            return False
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return self._read_heartbeat(message, now_ns)
        if not self.connected or message.get_srcSystem() != self.system_id:
            return False
        self.session.heard_ns[message.get_msgId()] = now_ns
        kind = message.get_msgId()
        if kind in READERS:
            stamp_ns = self._stamp_ns(message, now_ns) if kind in STAMPS else now_ns
            if stamp_ns is not None:
                READERS[kind](self, message, stamp_ns, now_ns)
            self._notice_double(now_ns)
        return True

    def _notice_double(self, now_ns: int) -> None:
        turns_ns = self._turns_ns
        is_found = len(turns_ns) == TURNS and max(turns_ns[-1] - turns_ns[0], now_ns - turns_ns[-1]) <= TURNS_NS
        if is_found != self.is_doubled:
            self.is_doubled = is_found
            log.error("system %s is %s", self.system_id, "two autopilots" if is_found else "one autopilot again")

    @property
    def target_id(self) -> int:
        """The system that messages are for; the default of autopilots, until the vehicle's own is known."""
        return self.system_id or FIRST_SYSTEM_ID

    @property
    def drives_itself(self) -> bool | None:
        """Whether it is armed, in a mode in which it finds its own way; None where the mode is not known."""
        return self._modes.are(ARMED, FINDS_ITS_WAY)

    @property
    def is_armed(self) -> bool | None:
        """Whether its motors are; None where that is not known."""
        return self._modes.are(ARMED)

    def expire(self, now_ns: int) -> None:
        """All that has come was read. The link is down when nothing has come for five seconds.

        Without heartbeats alone, only the mode is not known: all else that is known is by messages that still come.
        """
        self._read_ns = now_ns
        if not self.connected or now_ns - self._beats_ns[self.system_id or 0] <= LINK_TIMEOUT_NS:
            return
        self._modes = Modes()
        if now_ns - self._heard_ns > LINK_TIMEOUT_NS:
            log.warning("system %s has sent nothing for %d s", self.system_id, LINK_TIMEOUT_NS // 10**9)
            self.reset_link()

    def reset_link(self) -> None:
        """Two heartbeats are needed again; the distance driven so far stays."""
        self.connected = False
        self._beats_ns.clear()

    def boot_time_s(self, monotonic_ns: int) -> float | None:
        """Seconds since the autopilot's boot at that moment of CLOCK_MONOTONIC; None until it has reported its time."""
        boot_ns = self.session.clock.boot_ns(monotonic_ns)
        return None if boot_ns is None else boot_ns / 1e9

    def boot_ms(self, monotonic_ns: int) -> int:
        """The same in whole milliseconds, 0 where it is not known."""
        return round((self.boot_time_s(monotonic_ns) or 0.0) * 1000)

    def position(self, now_ns: int) -> VehiclePosition | None:
        """The autopilot's own position, None when it has none or the newest is over two seconds old."""
        newest = self.session.position
        return newest if newest is not None and now_ns - newest.stamp_ns <= POSITION_FRESH_NS else None

    def accuracy_m(self, now_ns: int) -> float | None:
        """Horizontal accuracy of its position as the autopilot reports it, None where it does not (ArduPilot)."""
        stamp_ns, meters = self.session.accuracy or (0, None)
        return meters if now_ns - stamp_ns <= ACCURACY_FRESH_NS else None

    def gps_fix(self, stamp_ns: int, now_ns: int) -> GpsFix | None:
        """Where GPS puts the vehicle at a moment, None without GPS."""
        return self.session.gps.fix(self.position(now_ns), stamp_ns, now_ns)

    def own(self, now_ns: int) -> AutopilotState:
        """All that the position estimator needs of it, as of now."""
        position, gps, motion = self.position(now_ns), self.session.gps, self.motion
        return AutopilotState(
            gps=gps.state(now_ns),
            gps_why=gps.why(now_ns),
            gps_sigma_m=gps.bound_m(position, now_ns),
            position=position,
            motion=None if position is None else motion.displacement(position.stamp_ns),
            scale=self.velocity.shown.scale,
            accuracy_m=self.accuracy_m(now_ns),
            speed_mps=motion.speed_mps(now_ns),
            driven_m=motion.driven_m(now_ns),
            is_aided=self.velocity.aid.is_any,
            drives_itself=self.drives_itself,
            fuses_poses=self.fuses_poses,
            is_doubled=self.is_doubled,
            is_clock_known=self.session.clock.is_known and self._read_ns - self._heard_ns <= LINK_SILENT_NS,
        )

    def _read_heartbeat(self, message: Message, now_ns: int) -> bool:
        sender = message.get_srcSystem()
        only_id = self.system_id if self.connected else self._only_system_id
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID or only_id not in (0, sender):
            return False
        before_ns, self._beats_ns[sender] = self._beats_ns.get(sender), now_ns
        if not self.connected and before_ns is not None and now_ns - before_ns <= LINK_TIMEOUT_NS:
            is_same_vehicle = sender == self.system_id
            self.connected, self.system_id = True, sender
            self.session.autopilot, self.session.kind = message.autopilot, message.type
            self._modes = Modes()
            self._start_session(is_same_vehicle=is_same_vehicle)
            log.info("link up: system %d, %s", sender, self.session.firmware.name)
        if self.connected:
            self._modes.add(message.base_mode, now_ns)
        return self.connected

    def _start_session(self, *, is_same_vehicle: bool) -> None:
        before = self.session
        self.session = Session(before.number + 1, before.autopilot, before.kind)
        self.velocity.end_leg(is_same_vehicle=is_same_vehicle)

    def _stamp_ns(self, message: Message, now_ns: int) -> int | None:
        """Add a message's stamp to the boot clock; returns the same moment on CLOCK_MONOTONIC.

        None, and the message must not be used, where the stamp is of another clock: a reboot is not sure yet.
        """
        clock = self.session.clock
        boot_ms = clock.unwrapped_ms(STAMPS[message.get_msgId()](message), now_ns)
        has_position = message.get_msgId() == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
        stamp_ns = clock.read_stamp(boot_ms, now_ns, has_position=has_position)
        if stamp_ns is not None and clock.took_turns:
            self._turns_ns.append(now_ns)
        if stamp_ns is not None or not clock.has_ended(now_ns):
            return stamp_ns
        log.warning("the autopilot has rebooted: its clock jumped to %d ms", boot_ms)
        self._start_session(is_same_vehicle=True)
        return self.session.clock.read_stamp(boot_ms, now_ns)

    def _read_global_position(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        if message.lat == 0 and message.lon == 0:
            return  # ArduPilot without an origin: neither a position nor a speed
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
        before, self.session.position = self.session.position, now
        self.velocity.move(before, now)

    def _read_local_position(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        self.session.local_m = message.y, message.x
        own = self.position(now_ns)
        heading_deg = own.heading_deg if own else None
        self.velocity.add_speed(stamp_ns, signed_speed(message.vy, message.vx, heading_deg), LOCAL)
        newest = self.session.position
        if newest is None or stamp_ns - newest.stamp_ns > POSITIONS_APART_S * 1e9:
            self.velocity.add_velocity(stamp_ns, message.vy, message.vx, heading_deg)

    def _read_odometry(self, message: Message, now_ns: int) -> None:
        """By another program beside the vehicle, in its own time; its yaw may be the autopilot's, and is not used."""
        sender = message.get_srcSystem(), message.get_srcComponent()
        if sender != self._odometry_from:
            if not self._has_warned:
                self._has_warned = True
                log.warning("ODOMETRY of %d:%d is ignored: [telemetry] odometry_from names who sends it", *sender)
            return
        if not (self.connected and message.quality >= 0):
            return
        if message.child_frame_id == mavlink.MAV_FRAME_BODY_FRD and math.isfinite(message.vx + message.vy):
            self.velocity.use_odometry(now_ns, message.vx, -message.vy, None)
        elif not self._has_warned:
            self._has_warned = True
            log.warning(
                "ODOMETRY of component %d is ignored: it needs a velocity in child_frame_id %d (body, "
                "forward-right-down)",
                message.get_srcComponent(),
                mavlink.MAV_FRAME_BODY_FRD,
            )

    def _read_filter(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        self.session.gps.read_filter(message.flags, self.session.firmware.gps_glitch, now_ns)

    def _read_estimator(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        self._read_filter(message, stamp_ns, now_ns)
        if math.isfinite(message.pos_horiz_accuracy) and message.pos_horiz_accuracy > 0:
            self.session.accuracy = now_ns, message.pos_horiz_accuracy

    def _read_origin(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        if message.latitude or message.longitude:
            self.session.origin = Origin(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1000)

    def _read_version(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        self.session.version = message.flight_sw_version >> 24, message.flight_sw_version >> 16 & 0xFF

    def _read_parameter(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        value, layout = float(message.param_value), INTEGERS.get(message.param_type)
        if self.session.firmware.integers_as_bytes and layout:
            value = float(struct.unpack(layout, struct.pack("<f", value))[0])
        if math.isfinite(value):
            self.session.parameters[str(message.param_id).rstrip("\0")] = value

    def _read_gps(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        receivers, is_second = self.session.gps.receivers, message.get_msgId() == mavlink.MAVLINK_MSG_ID_GPS2_RAW
        fix_ns = self.session.clock.monotonic_ns(int(message.time_usec) * 1000)
        receivers[is_second].read(message, now_ns, fix_ns)
        first = receivers[0]
        if not is_second and first.is_good and first.state(now_ns) == "healthy":
            self.velocity.shown.add_fix(now_ns, first.at)

    def _read_fusion(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        self.session.gps.is_fusion_on = bool(message.intended[0])

    def _read_sensors(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        self.session.gps.read_sensors(message.onboard_control_sensors_present, now_ns)

    def _read_timesync(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        self.session.clock.read_timesync(message.tc1, message.ts1, now_ns)

    def _read_motion(self, message: Message, stamp_ns: int, now_ns: int) -> None:
        self.velocity.read(message, stamp_ns, now_ns, rates_follow_gps=self.session.firmware.rates_follow_gps)


READERS: dict[int, Callable[[Vehicle, Message, int, int], object]] = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Vehicle._read_global_position,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Vehicle._read_local_position,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Vehicle._read_motion,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: Vehicle._read_motion,
    mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE: Vehicle._read_motion,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: Vehicle._read_motion,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Vehicle._read_gps,
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: Vehicle._read_gps,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: Vehicle._read_filter,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: Vehicle._read_estimator,
    FusionStatus.id: Vehicle._read_fusion,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Vehicle._read_sensors,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: lambda vehicle, message, stamp_ns, now_ns: None,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: Vehicle._read_timesync,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: Vehicle._read_origin,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: Vehicle._read_version,
    mavlink.MAVLINK_MSG_ID_PARAM_VALUE: Vehicle._read_parameter,
}
"""Of each message that is read, by its id; gets its moment on CLOCK_MONOTONIC, and when it arrived."""
STAMPS: dict[int, Callable[[Message], int]] = {
    **dict.fromkeys(
        (*POSITIONS, mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME),
        lambda message: int(message.time_boot_ms),
    ),
    **dict.fromkeys(
        (mavlink.MAVLINK_MSG_ID_RAW_IMU, mavlink.MAVLINK_MSG_ID_WHEEL_DISTANCE),
        lambda message: int(message.time_usec // 1000),
    ),
}
"""Milliseconds since boot of each message that has them."""
