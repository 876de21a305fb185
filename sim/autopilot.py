"""A simulated autopilot at the other end of a MAVLink link, for a pose that somebody else moves.

It speaks as the real ones were seen to: heartbeats always, streams when they are asked for, answers to TIMESYNC and
to position estimates; and it records all that it receives. Its position estimate follows fixes, so that what a
companion computer sends can be judged by where the vehicle then believes to be.
"""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import pymap3d
from pymavlink.dialects.v20 import common as mavlink

from edge.errors import LinkLost
from edge.telemetry.codec import MavlinkCodec, Message
from edge.telemetry.link import Link
from sim import ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, Pose
from sim.dead_reckoning import DeadReckoning

Firmware: TypeAlias = Literal["ardupilot", "px4"]

HEARTBEAT_S = 1.0
STEP_S = 0.01
EXTERNAL_POSITION_ESTIMATE = 43003
COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)
SILENT = -1
LAG_S = 0.5  # ArduPilot's guess for a send time that is not on its boot clock


@dataclass(frozen=True)
class Received:
    """One message that arrived, at CLOCK_MONOTONIC seconds."""

    time_s: float
    message: Message


@dataclass(frozen=True)
class Reset:
    """An accepted position fix, and the estimate's distance from the truth before and after it."""

    time_s: float
    error_before_m: float
    error_after_m: float


class SimulatedAutopilot:
    """System 1, component 1. Call `step()` often, or let `run()` do so."""

    def __init__(
        self,
        link: Link,
        pose_at: Callable[[float], Pose],
        clock_ns: Callable[[], int] = time.monotonic_ns,
        *,
        firmware: Firmware = "ardupilot",
        system_id: int = 1,
        gps: bool = True,
        drift_percent: float = 0.0,
    ) -> None:
        """`pose_at` takes seconds of `clock_ns`, which is CLOCK_MONOTONIC, so that frames and poses agree."""
        self.gps = gps
        self.received: list[Received] = []
        self.resets: list[Reset] = []
        self.refuse_fixes_with: int | None = None
        """A MAV_RESULT to answer every position estimate with, or SILENT as PX4 1.15 is, instead of heeding it."""
        self._link = link
        self._pose_at = pose_at
        self._clock_ns = clock_ns
        self._firmware = firmware
        self._codec = MavlinkCodec(system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        now_s = clock_ns() / 1e9
        self._pose = pose_at(now_s)
        self.estimate = DeadReckoning(self._pose, now_s, drift_percent)
        self._streams: dict[int, Callable[[], Message]] = {
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._timesync,
        }
        self.reboot()

    def reboot(self) -> None:
        """Start again: the boot clock at zero, and no streams but the heartbeat and TIMESYNC."""
        self._boot_ns = self._clock_ns()
        self._gps_lost_s = -math.inf
        timesync_s = 10.0 if self._firmware == "ardupilot" else 0.1
        self._period_s = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: HEARTBEAT_S, mavlink.MAVLINK_MSG_ID_TIMESYNC: timesync_s}
        self._due_s = dict.fromkeys(self._period_s, self._boot_ns / 1e9)

    def run(self, stop: threading.Event) -> None:
        """Step until `stop` is set or the link is gone."""
        while not stop.is_set():
            try:
                select.select([self._link], [], [], STEP_S)
                self.step()
            except (LinkLost, OSError, ValueError):  # ValueError: select on a link that was closed meanwhile
                return

    def step(self) -> None:
        """One turn: move, hear, speak. Raises LinkLost when the link is gone."""
        now_s = self._clock_ns() / 1e9
        self._pose = self._pose_at(now_s)
        self.estimate.update(self._pose, now_s, gps=self.gps)
        if self.gps:
            self._gps_lost_s = now_s
        for message in self._codec.decode(self._link.receive()):
            self.received.append(Received(now_s, message))
            self._obey(message)
        for message_id, due_s in list(self._due_s.items()):
            if now_s >= due_s:
                self._due_s[message_id] = max(due_s + self._period_s[message_id], now_s)
                self._send(self._streams[message_id]())

    @property
    def boot_s(self) -> float:
        """Seconds since boot, now."""
        return (self._clock_ns() - self._boot_ns) / 1e9

    def _send(self, message: Message) -> None:
        self._link.send(self._codec.encode(message))

    def _obey(self, message: Message) -> None:
        kind = message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            self._send(mavlink.MAVLink_timesync_message(self._clock_ns() - self._boot_ns, message.ts1))
        elif kind in COMMANDS and message.target_system in (0, self._codec.system_id):
            self._acknowledge(message, self._execute(message))

    def _acknowledge(self, command: Message, result: int) -> None:
        if result == SILENT:
            return
        self._send(
            mavlink.MAVLink_command_ack_message(
                command.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
            )
        )

    def _execute(self, command: Message) -> int:
        """Do what a command says; its MAV_RESULT."""
        if command.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_interval(int(command.param1), command.param2 / 1e6)
        if command.command != EXTERNAL_POSITION_ESTIMATE:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        if command.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        return self._accept_fix(command) if self.refuse_fixes_with is None else self.refuse_fixes_with

    def _set_interval(self, message_id: int, period_s: float) -> int:
        if message_id not in self._streams:
            return int(mavlink.MAV_RESULT_FAILED)
        if period_s > 0:
            self._period_s[message_id] = period_s
            self._due_s[message_id] = self._clock_ns() / 1e9
        else:
            self._due_s.pop(message_id, None)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _accept_fix(self, command: Message) -> int:
        """COMMAND_INT 43003: a hard horizontal reset to where the vehicle was, unless a rule is against it."""
        if self._firmware == "ardupilot":
            if command.frame != mavlink.MAV_FRAME_GLOBAL or not math.isnan(command.z):
                return int(mavlink.MAV_RESULT_DENIED)
            if self._clock_ns() / 1e9 - self._gps_lost_s < 1.0:
                return int(mavlink.MAV_RESULT_FAILED)
        now_s = self._clock_ns() / 1e9
        late_s = self.boot_s - command.param1
        exposure_s = now_s - command.param2 - (late_s if 0 <= late_s < LAG_S else LAG_S)
        east_m, north_m, _ = pymap3d.geodetic2enu(
            command.x / 1e7, command.y / 1e7, ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M
        )
        before_m = self.estimate.error_m
        self.estimate.reset(float(east_m), float(north_m), exposure_s)
        self.resets.append(Reset(now_s, before_m, self.estimate.error_m))
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _boot_ms(self) -> int:
        return (self._clock_ns() - self._boot_ns) // 1_000_000

    def _velocity(self) -> tuple[float, float]:
        """Metres a second, north and east."""
        heading_rad = math.radians(self._pose.heading_deg)
        return self._pose.speed_mps * math.cos(heading_rad), self._pose.speed_mps * math.sin(heading_rad)

    def _geodetic(self) -> tuple[int, int]:
        """The estimate in degrees x 1e7."""
        lat_deg, lon_deg, _ = pymap3d.enu2geodetic(
            self.estimate.east_m, self.estimate.north_m, 0.0, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M
        )
        return round(float(lat_deg) * 1e7), round(float(lon_deg) * 1e7)

    def _heartbeat(self) -> Message:
        autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA if self._firmware == "ardupilot" else mavlink.MAV_AUTOPILOT_PX4
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GROUND_ROVER, autopilot, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )

    def _timesync(self) -> Message:
        return mavlink.MAVLink_timesync_message(0, self._clock_ns() - self._boot_ns)

    def _global_position(self) -> Message:
        lat, lon = self._geodetic()
        north_mps, east_mps = self._velocity()
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms(),
            lat,
            lon,
            round(ORIGIN_ALT_M * 1000),
            0,
            round(north_mps * 100),
            round(east_mps * 100),
            0,
            round(self._pose.heading_deg * 100) % 36000,
        )

    def _local_position(self) -> Message:
        north_mps, east_mps = self._velocity()
        return mavlink.MAVLink_local_position_ned_message(
            self._boot_ms(), self.estimate.north_m, self.estimate.east_m, 0.0, north_mps, east_mps, 0.0
        )

    def _vfr_hud(self) -> Message:
        speed_mps = self._pose.speed_mps
        return mavlink.MAVLink_vfr_hud_message(
            speed_mps, speed_mps, round(self._pose.heading_deg) % 360, 0, ORIGIN_ALT_M, 0.0
        )

    def _gps_raw(self) -> Message:
        if not self.gps:
            return mavlink.MAVLink_gps_raw_int_message(0, mavlink.GPS_FIX_TYPE_NO_GPS, 0, 0, 0, 65535, 65535, 0, 0, 0)
        lat_deg, lon_deg = self._pose.geodetic()
        return mavlink.MAVLink_gps_raw_int_message(
            self._boot_ms() * 1000,
            mavlink.GPS_FIX_TYPE_3D_FIX,
            round(lat_deg * 1e7),
            round(lon_deg * 1e7),
            round(ORIGIN_ALT_M * 1000),
            70,
            110,
            round(self._pose.speed_mps * 100),
            round(self._pose.heading_deg * 100) % 36000,
            10,
        )

    def _system_time(self) -> Message:
        return mavlink.MAVLink_system_time_message(0, self._boot_ms())
