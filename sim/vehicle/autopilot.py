"""A simulated autopilot on a MAVLink link, for a vehicle whose pose is given.

It behaves as real ones were recorded: heartbeats always, streams on request, answers to TIMESYNC, commands and
positions. It keeps all messages that it receives. Its position estimate uses fixes, so that a companion computer can be
judged by the estimate's error. `sim.vehicle.firmware` has the differences between firmware.
"""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import LinkLost
from edge.telemetry.codec import FusionStatus, MavlinkCodec, Message
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE, GPS_DOUBT_NAME, SENSOR_ENABLE
from edge.telemetry.link import Link
from sim import Pose
from sim.vehicle.attitude import AttitudeEstimate
from sim.vehicle.autopilot_messages import ENCODERS, AutopilotSnapshot
from sim.vehicle.estimator import Estimator, OdometryErrors
from sim.vehicle.firmware import FIRMWARES, parameters_of
from sim.vehicle.gps import NO_FIX, GpsReport
from sim.vehicle.mission_store import KINDS, MissionStore
from sim.vehicle.position_inputs import SET_WITHOUT_GPS, InputContext, PositionInputs, Reset, east_north_m
from sim.vehicle.px4_modes import NO_AID_TIMEOUT, NO_AID_US, FlightMode, custom_mode

__all__ = ["EXTERNAL_POSITION_ESTIMATE", "SILENT", "MessageArrival", "Reset", "SimulatedAutopilot"]

HEARTBEAT_S = 1.0
STEP_S = 0.01
COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)
SILENT = -1
BOOTS_S = 2.7
"""From a reset of ArduPilot to its first message, as recorded."""


@dataclass(frozen=True)
class MessageArrival:
    """One message that arrived, at CLOCK_MONOTONIC seconds."""

    time_s: float
    message: Message


class SimulatedAutopilot:
    """System 1, component 1. Call `step()` often, or let `run()` do so."""

    def __init__(
        self,
        link: Link,
        pose_at: Callable[[float], Pose],
        clock_ns: Callable[[], int] = time.monotonic_ns,
        *,
        firmware: str = "ardupilot",
        system_id: int = 1,
        gps: bool = True,
        gps_fails_s: float = math.inf,
        has_origin: bool = True,
        drift_percent: float = 0.0,
        errors: OdometryErrors | None = None,
        gps_at: Callable[[float], GpsReport] = lambda now_s: GpsReport(),
        booted_before_s: float = 0.0,
        codec: MavlinkCodec | None = None,
    ) -> None:
        """`pose_at` takes seconds of `clock_ns`, which is CLOCK_MONOTONIC, so that frames and poses agree.

        firmware: a row of `sim.vehicle.firmware.FIRMWARES`. gps: whether there is a receiver with a fix; it fails at
        `gps_fails_s` of that clock. has_origin: whether it has an origin at boot, as after a start with
        GPS; else, where the firmware needs one, it has to be set. errors: of its odometry, or drift_percent as its
        scale. gps_at: the receiver's report. booted_before_s: how
        long ago it booted. codec: one that signs, for example.
        """
        self.gps = gps
        self._gps_at, self._gps_fails_s = gps_at, gps_fails_s
        self._booted_before_ns = round(booted_before_s * 1e9)
        self.loses: Callable[[Message, bool], bool] = lambda message, outgoing: False
        """Whether the link loses a message, which is the autopilot's own if outgoing."""
        self.received: list[MessageArrival] = []
        self.reject_fixes_with: int | None = None
        """A MAV_RESULT to answer every position estimate with instead of using it; SILENT for no answer, as PX4
        1.15."""
        self.base_mode = 0
        """MAV_MODE_FLAG bits of its heartbeats."""
        self.mode: FlightMode | None = None
        """The mode that was chosen on a PX4."""
        self.has_script = False
        """Whether firmware_config/lookback_gps.lua runs on it, with LKG_ACTION 1."""
        self._link = link
        self._pose_at = pose_at
        self._clock_ns = clock_ns
        self._firmware = FIRMWARES[firmware]
        self._errors = errors or OdometryErrors(scale=1.0 + drift_percent / 100)
        self.parameters = parameters_of(self._firmware, self._errors.source)
        """Value and MAV_PARAM_TYPE of those that it answers PARAM_REQUEST_READ with; of others it says nothing."""
        self.mission = MissionStore(is_ardupilot=self._firmware.can.home_is_item_0)
        self._codec = codec or MavlinkCodec(system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        now_s = clock_ns() / 1e9
        self._pose = pose_at(now_s)
        self._has_origin = has_origin or gps
        self.timesync_off_s = 0.0
        """By how much its answers to TIMESYNC are ahead of the clock that its messages are stamped with."""
        self.estimate = Estimator(self._pose, now_s, self._errors, self._firmware.noise)
        self._attitude = AttitudeEstimate(self._errors.seed)
        self.inputs = PositionInputs(self._firmware, self.estimate)
        self.inputs.is_aided_by_camera = self._errors.source == "camera"
        self._boot()
        self._boot_ns -= self._booted_before_ns

    @property
    def resets(self) -> list[Reset]:
        """Positions that moved the estimate at once."""
        return self.inputs.resets

    def reboot(self, silent_s: float = 0.0) -> None:
        """Boot again: the clock at 0, and no streams but HEARTBEAT and TIMESYNC; nothing is heard for `silent_s`.

        ArduPilot without GPS has no position then until an origin is set, and starts there, wherever the vehicle is.
        """
        self._has_origin = self._uses_gps
        self.estimate.boot()
        if self._firmware.selects_by != SENSOR_ENABLE:
            self.inputs.source_set = 1
        self._boot()
        self._deaf_until_s = self._clock_ns() / 1e9 + silent_s

    def _boot(self) -> None:
        self._boot_ns, self._deaf_until_s = self._clock_ns(), -math.inf
        self._report = NO_FIX
        self._started_m = self.estimate.east_m, self.estimate.north_m
        self._gps_lost_s = -math.inf
        self.origin_m = (0.0, 0.0) if self._has_origin or not self._firmware.needs_origin else None
        """Its filter's local zero, meters east and north of the simulation's; None while it has none."""
        self._period_s = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: HEARTBEAT_S,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._firmware.timesync_s,
        }
        self._due_s = dict.fromkeys(self._period_s, self._clock_ns() / 1e9)

    def run(self, stop: threading.Event) -> None:
        """Step until `stop` is set or the link is gone."""
        while not stop.is_set():
            try:
                select.select([self._link], [], [], STEP_S)
                self.step()
            except (LinkLost, OSError, ValueError):  # ValueError: select on a link that was closed meanwhile
                return

    def step(self) -> None:
        """One step: move, receive, send. Raises LinkLost when the link is gone."""
        now_s = self._clock_ns() / 1e9
        self._pose = self._pose_at(now_s)
        if now_s >= self._gps_fails_s:
            self.gps = False
        self._report = self._gps_at(now_s) if self.gps else NO_FIX
        self.estimate.update(self._pose, now_s, self._report.position(self._pose) if self._uses_gps else None)
        self._attitude.update(self._pose, now_s)
        if self._uses_gps:
            self._gps_lost_s = now_s
            self.origin_m = self.origin_m or (0.0, 0.0)
        received = self._codec.decode(self._link.receive())
        if now_s < self._deaf_until_s:
            return
        for message in received:
            if not self.loses(message, False):
                self.received.append(MessageArrival(now_s, message))
                self.handle(message)
        for message in self.mission.step(now_s):
            self.send(message)
        due = [message_id for message_id, due_s in self._due_s.items() if now_s >= due_s]
        for message_id in due:
            self._due_s[message_id] = max(self._due_s[message_id] + self._period_s[message_id], now_s)
        if due:
            snapshot = self._snapshot()
            self.send(*(one for one in (ENCODERS[message_id](snapshot) for message_id in due) if one is not None))

    @property
    def _uses_gps(self) -> bool:
        """GPS is in the first set of sources only."""
        return self._report.usable and self.inputs.source_set != SET_WITHOUT_GPS

    @property
    def _unaided_s(self) -> float:
        """Since position or velocity was measured last."""
        return 0.0 if self._uses_gps else self._clock_ns() / 1e9 - max(self._gps_lost_s, self.estimate.aided_s)

    @property
    def boot_s(self) -> float:
        """Seconds since boot, now."""
        return (self._clock_ns() - self._boot_ns) / 1e9

    @property
    def booted_s(self) -> float:
        """CLOCK_MONOTONIC at boot."""
        return self._boot_ns / 1e9

    @property
    def _timesync_ns(self) -> int:
        return self._clock_ns() - self._boot_ns + round(self.timesync_off_s * 1e9)

    def _send_kind(self, message_id: int) -> bool:
        """Send one message of that kind; False where there is nothing to send."""
        message = ENCODERS[message_id](self._snapshot())
        if message is not None:
            self.send(message)
        return message is not None

    def send(self, *messages: Message) -> None:
        """Send any messages, as the autopilot itself; those of one call leave together."""
        if data := b"".join(self._codec.encode(one) for one in messages if not self.loses(one, True)):
            self._link.send(data)

    def handle(self, message: Message) -> None:
        """Do what a message asks for, whoever sent it."""
        kind = message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            self.send(mavlink.MAVLink_timesync_message(self._timesync_ns, message.ts1))
        elif kind == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_SENSOR:
            self.inputs.sensor(message, self._moment())
        elif kind == mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE:
            self.inputs.vision(message, self._moment())
        elif kind in (mavlink.MAVLINK_MSG_ID_ODOMETRY, mavlink.MAVLINK_MSG_ID_VISION_POSITION_DELTA):
            self.inputs.velocity(message, self._moment())
        elif kind == mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN:
            self.set_origin(*east_north_m(message.latitude / 1e7, message.longitude / 1e7))
        elif kind == mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ and message.param_id in self.parameters:
            self._say_parameter(message.param_id)
        elif kind == mavlink.MAVLINK_MSG_ID_PARAM_SET and message.param_id in self.parameters:
            self.parameters[message.param_id] = message.param_value, self.parameters[message.param_id][1]
            self._say_parameter(message.param_id)
        elif kind == mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT and self.has_script:
            if message.name == GPS_DOUBT_NAME.decode() and message.value >= 1.0:
                self.inputs.source_set = SET_WITHOUT_GPS
        elif kind in COMMANDS and message.target_system in (0, self._codec.system_id):
            self._acknowledge(message, self._execute(message))
        elif kind in KINDS and (message.target_system, message.target_component) == (self._codec.system_id, 1):
            for answer in self.mission.handle(message, self._clock_ns() / 1e9):
                self.send(answer)

    def _say_parameter(self, name: str) -> None:
        value, kind = self.parameters[name]
        self.send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 0xFFFF))

    def _acknowledge(self, command: Message, result: int) -> None:
        if result == SILENT:
            return
        self.send(
            mavlink.MAVLink_command_ack_message(
                command.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
            )
        )

    def _execute(self, command: Message) -> int:
        """Execute a command; its MAV_RESULT."""
        if command.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_interval(int(command.param1), command.param2 / 1e6)
        if command.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            said = self._offers(int(command.param1)) and self._send_kind(int(command.param1))
            return int(mavlink.MAV_RESULT_ACCEPTED if said else mavlink.MAV_RESULT_FAILED)
        is_fix = command.command == EXTERNAL_POSITION_ESTIMATE
        if is_fix and command.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_INT and self.reject_fixes_with is not None:
            return self.reject_fixes_with
        result = self.inputs.command(command, self._moment())
        return SILENT if is_fix and not self._firmware.acknowledges else result

    def _offers(self, message_id: int) -> bool:
        of_the_other = (
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT
            if self._firmware.reports_accuracy
            else mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS
        )
        of_a_second = () if self._report.second else (mavlink.MAVLINK_MSG_ID_GPS2_RAW,)
        of_newer = () if self._firmware.selects_by == SENSOR_ENABLE else (FusionStatus.id,)
        return message_id in ENCODERS and message_id not in (of_the_other, *of_a_second, *of_newer)

    def _set_interval(self, message_id: int, period_s: float) -> int:
        if not self._offers(message_id):
            return int(mavlink.MAV_RESULT_FAILED)
        if period_s > 0:
            self._period_s[message_id] = period_s
            self._due_s[message_id] = self._clock_ns() / 1e9
        else:
            self._due_s.pop(message_id, None)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def set_origin(self, east_m: float, north_m: float) -> None:
        """Only the first origin is used: it is where the filter started to count from. It is sent to all."""
        if self.origin_m is not None:
            return
        self.origin_m = east_m, north_m
        self.estimate.shift(self.origin_m[0] - self._started_m[0], self.origin_m[1] - self._started_m[1])
        self._send_kind(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)

    def _moment(self) -> InputContext:
        gps_lost_s = math.inf if self._uses_gps else self._gps_lost_s
        return InputContext(self._clock_ns() / 1e9, self.boot_s, gps_lost_s, self.origin_m)

    def _snapshot(self) -> AutopilotSnapshot:
        return AutopilotSnapshot(
            firmware=self._firmware,
            boot_ns=self._clock_ns() - self._boot_ns,
            pose=self._pose,
            gps=self._report,
            uses_gps=self._uses_gps,
            is_fusion_on=self.inputs.source_set != SET_WITHOUT_GPS,
            estimate=self.estimate,
            attitude=self._attitude,
            origin_m=self.origin_m,
            has_wheels=self._errors.source == "wheels",
            base_mode=self.base_mode,
            custom_mode=custom_mode(self.mode, self._unaided_s, self.parameters.get(NO_AID_TIMEOUT, (NO_AID_US, 0))[0]),
        )
