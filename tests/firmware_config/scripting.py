"""A stand-in for ArduPilot's scripting API, which runs the Lua scripts and records what they call.

It has the functions that ArduPilot's documentation lists (libraries/AP_Scripting/docs/docs.lua), with their arguments;
a call of any other is an error. Messages are real: pymavlink makes and reads them.
"""

from __future__ import annotations

import struct
from collections import deque
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import MavlinkCodec

SCRIPTS = Path(__file__).parents[2] / "firmware_config"
CHANNEL, COPTER = 2, 2
LOW, MIDDLE, HIGH = 0, 1, 2
"""Of a switch."""
API = """
function(host)
  local function object(name, methods)
    local made = {}
    for method in methods:gmatch("[%w_]+") do
      made[method] = function(self, ...) assert(self == made, name .. ":" .. method); return host(name, method, ...) end
    end
    return made
  end
  param = object("param", "add_table add_param get")
  mavlink = object("mavlink", "init register_rx_msgid receive_chan send_chan")
  mission = object("mission", "num_commands set_current_cmd")
  vehicle = object("vehicle", "set_mode get_mode has_ekf_failsafed")
  battery = object("battery", "has_failsafed")
  arming = object("arming", "is_armed")
  rc = object("rc", "get_aux_cached has_valid_input")
  gcs = object("gcs", "send_text")
  ahrs = object("ahrs", "set_posvelyaw_source_set get_posvelyaw_source_set")
  gps = object("gps", "primary_sensor status horizontal_accuracy")
  FWVersion = object("FWVersion", "type")
  io, os, package, require, dofile, loadfile = nil, nil, nil, nil, nil, nil
end
"""


class Scripting:
    """ArduPilot as the script sees it; `step` calls what the script asked to be called."""

    def __init__(self, script: str, period_ms: int, switch: int | None = LOW, **parameters: float) -> None:
        runtime = pytest.importorskip("lupa.lua53").LuaRuntime(unpack_returned_tuples=True, encoding=None)
        self._period_ms = period_ms
        self.parameters: dict[str, float] = {"SYSID_THISMAV": 1.0}
        self.set_up = parameters
        self.switch = switch
        """As the receiver sends it; None before it has ever been heard."""
        self.is_received = True
        """Whether the receiver is heard; if not, ArduPilot keeps what it read last, also for 0.2 s afterwards."""
        self.failsafe = ""
        self.mode = 0
        self._cached, self._debounced = switch, 0
        self.armed = True
        self.items = 0
        self.modes: list[int] = []
        self.sets: list[int] = []
        """Of sources, which the script selected."""
        self.source_set = 0
        """The one in use, from 0 on."""
        self.gps_fix_type, self.gps_accuracy_m = 0, 0.7
        self.texts: list[str] = []
        self.sent: list[Any] = []
        self.arrived: deque[bytes] = deque()
        self.registered: set[int] = set()
        self.refuses_mode = False
        self.has_long_ids = False
        """Whether system IDs have 32 bits, as in later versions."""
        self._codec = MavlinkCodec(1, 1)
        runtime.eval(API)(self._call)
        self._next, found_ms = runtime.execute((SCRIPTS / script).read_bytes())
        assert found_ms == period_ms

    def step(self, times: int = 1) -> None:
        for _ in range(times):
            self._debounced = self._debounced + 1 if self.is_received else 0
            self._cached = self.switch if self._debounced > 2 else self._cached
            self._next, period_ms = self._next()
            assert period_ms == self._period_ms, self.texts

    def receive(self, message: Any, system_id: int = 1, component_id: int = 191) -> None:
        """As `mavlink_message_t` lies in memory: checksum, header, payload with its zeros, checksum and signature."""
        if message.get_msgId() in self.registered:
            frame = MavlinkCodec(system_id, component_id).encode(message)
            header = frame[:6] + b"\0" * (3 if self.has_long_ids else 0) + frame[6:10]
            payload = frame[10 : 10 + frame[1]].ljust(257, b"\0")
            self.arrived.append(b"\0\0" + header + payload + b"\0" * (27 if self.has_long_ids else 22))

    def heartbeat(self, **sender: int) -> None:
        self.receive(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), **sender)

    def answer(self, result: int, items: int = 0, command: int = 31014, to: int = 1, **sender: int) -> None:
        self.receive(mavlink.MAVLink_command_ack_message(command, result, 0, items, 1, to), **sender)

    def _call(self, name: bytes, method: bytes, *args: Any) -> Any:
        return getattr(self, f"_{name.decode()}_{method.decode()}")(*args)

    def _param_add_table(self, key: int, prefix: bytes, count: int) -> bool:
        assert 0 < key <= 200
        self._prefix, self._count = prefix.decode(), count
        return True

    def _param_add_param(self, key: int, number: int, name: bytes, default: float) -> bool:
        assert 1 <= number <= self._count
        full = self._prefix + name.decode()
        assert len(full) <= 16
        self.parameters[full] = self.set_up.get(full, float(default))
        return True

    def _param_get(self, name: bytes) -> float | None:
        return self.parameters.get(name.decode())

    def _mavlink_init(self, first: int, second: int) -> None:
        assert 1 <= first <= 25
        assert 1 <= second <= 25

    def _mavlink_register_rx_msgid(self, message_id: int) -> bool:
        self.registered.add(message_id)
        return True

    def _mavlink_receive_chan(self) -> Any:
        return (self.arrived.popleft(), CHANNEL, 0) if self.arrived else None

    def _mavlink_send_chan(self, channel: int, message_id: int, payload: bytes) -> bool:
        assert (channel, message_id, len(payload)) == (CHANNEL, 76, 33)
        *params, command, system, component, confirmation = struct.unpack("<7fHBBB", payload)
        self.sent.append(mavlink.MAVLink_command_long_message(system, component, command, confirmation, *params))
        return True

    def _mission_num_commands(self) -> int:
        return self.items

    def _mission_set_current_cmd(self, index: int) -> bool:
        return 0 < index < self.items

    def _vehicle_set_mode(self, mode: int) -> bool:
        assert isinstance(mode, int)
        self.modes += [] if self.refuses_mode else [mode]
        return not self.refuses_mode

    def _vehicle_get_mode(self) -> int:
        return self.mode

    def _vehicle_has_ekf_failsafed(self) -> bool:
        return self.failsafe == "ekf"

    def _battery_has_failsafed(self) -> bool:
        return self.failsafe == "battery"

    def _arming_is_armed(self) -> bool:
        return self.armed

    def _rc_get_aux_cached(self, function: float) -> int | None:
        assert 300 <= function <= 307
        return self._cached

    def _rc_has_valid_input(self) -> bool:
        return self.is_received

    def _gcs_send_text(self, severity: int, text: bytes) -> None:
        assert 0 <= severity <= 7
        assert len(text) <= 50
        self.texts.append(text.decode())

    def _ahrs_set_posvelyaw_source_set(self, number: int) -> None:
        self.sets.append(number)
        self.source_set = number

    def _ahrs_get_posvelyaw_source_set(self) -> int:
        return self.source_set

    def _gps_primary_sensor(self) -> int:
        return 0

    def _gps_status(self, receiver: int) -> int:
        return self.gps_fix_type

    def _gps_horizontal_accuracy(self, receiver: int) -> float:
        return self.gps_accuracy_m

    def _FWVersion_type(self) -> int:  # noqa: N802
        return COPTER
