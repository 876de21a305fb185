"""The Lua script for ArduPilot, run in Lua against a stand-in for ArduPilot's bindings."""

from __future__ import annotations

import struct
from collections import deque
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("lupa")

from edge.telemetry import encoders
from edge.telemetry.codec import MavlinkCodec

SCRIPT = Path(__file__).parents[2] / "firmware_config" / "lookback_gps.lua"
COPTER, RTL_OF_COPTER = 2, 6


def as_structure(wire: bytes, wide: bool) -> bytes:
    """A message of MAVLink 2 as ArduPilot's mavlink_message_t; wide: with system IDs of 32 bits."""
    length, sysid, compid = wire[1], wire[5], wire[6]
    head = struct.pack("<HBBBBB", 0, wire[0], length, wire[2], wire[3], wire[4])
    head += struct.pack("<IB" if wide else "<BB", sysid, compid) + wire[7:10]
    return (head + wire[10 : 10 + length]).ljust(299 if wide else 291, b"\0")


class ArduPilot:
    """What the script can call, and what it did. action: LKG_ACTION, which the pilot has set."""

    def __init__(self, action: int, wide: bool = False) -> None:
        # The same Lua as ArduPilot's, where it is there.
        runtime = pytest.importorskip("lupa.lua53")
        self.lua = runtime.LuaRuntime(encoding=None)
        self.parameters = {b"LKG_ACTION": action, b"SYSID_THISMAV": 1}
        self.sets: list[int] = []
        self.modes: list[int] = []
        self.texts: list[bytes] = []
        self._wide, self._waiting = wide, deque[bytes]()
        self._codec = MavlinkCodec(1, 191)
        table, names = self.lua.table_from, self.lua.globals()
        names[b"param"] = table(
            {b"add_table": lambda *_: True, b"add_param": self._add, b"get": lambda _, name: self.parameters.get(name)}
        )
        names[b"mavlink"] = table(
            {b"init": lambda *_: None, b"register_rx_msgid": lambda *_: True, b"receive_chan": self._receive}
        )
        names[b"ahrs"] = table({b"set_posvelyaw_source_set": lambda _, number: self.sets.append(number)})
        names[b"vehicle"] = table({b"set_mode": lambda _, mode: self.modes.append(mode)})
        names[b"FWVersion"] = table({b"type": lambda _: COPTER})
        names[b"gcs"] = table({b"send_text": lambda _, severity, text: self.texts.append(text)})
        self._update, _ = self.lua.execute(SCRIPT.read_bytes())

    def _add(self, _: Any, key: int, number: int, name: bytes, value: float) -> bool:
        self.parameters.setdefault(b"LKG_" + name, int(value))
        return True

    def _receive(self, _: Any) -> bytes | None:
        return self._waiting.popleft() if self._waiting else None

    def silence(self, seconds: int) -> None:
        """Nothing is heard."""
        for _ in range(5 * seconds):
            self._update()

    def hears(self, doubt: float | None, times: int = 1, component: int = 191, system: int = 1) -> None:
        """Lookback's values, `times` seconds long."""
        codec = MavlinkCodec(system, component)
        for _ in range(times):
            for message in encoders.gps_values(doubt, 40.0, 1000):
                self._waiting.append(as_structure(codec.encode(message), self._wide))
            self._update()


@pytest.mark.parametrize("wide", [False, True])
def test_it_selects_the_second_set_and_the_first_again(wide: bool) -> None:
    autopilot = ArduPilot(action=1, wide=wide)
    autopilot.hears(0.0, 5)
    autopilot.hears(1.0, 2)
    assert autopilot.sets == []
    autopilot.hears(1.0, 5)
    assert autopilot.sets == [1]
    autopilot.hears(None, 10)
    autopilot.hears(0.5, 10)
    assert autopilot.sets == [1], "not known is not agreed"
    autopilot.hears(0.0, 3)
    assert autopilot.sets == [1, 0]
    assert autopilot.modes == []


@pytest.mark.parametrize(
    ("action", "sets", "modes"), [(0, [], []), (2, [], [RTL_OF_COPTER]), (3, [1], [RTL_OF_COPTER])]
)
def test_the_pilot_chooses_what_it_does(action: int, sets: list[int], modes: list[int]) -> None:
    autopilot = ArduPilot(action)
    autopilot.hears(1.0, 10)
    assert (autopilot.sets, autopilot.modes) == (sets, modes)
    assert any(text.startswith(b"GPS is wrong") for text in autopilot.texts)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize(("system", "component"), [(1, 1), (2, 191), (191, 1)])
def test_values_of_others_are_ignored(wide: bool, system: int, component: int) -> None:
    """Also of the Lookback of another vehicle on the same radio."""
    autopilot = ArduPilot(action=3, wide=wide)
    autopilot.hears(1.0, 10, component, system)
    assert (autopilot.sets, autopilot.modes) == ([], [])


def test_a_lookback_that_falls_silent_is_named_and_changes_nothing() -> None:
    autopilot = ArduPilot(action=1)
    autopilot.silence(60)
    assert autopilot.texts == [], "there is nothing to say without an action"
    autopilot.hears(1.0, 5)
    autopilot.silence(50)
    assert autopilot.sets == [1], "GPS was wrong"
    assert autopilot.texts[1:] == [b"Lookback is silent, GPS was wrong"] * 2
    autopilot.hears(0.0, 5)
    assert autopilot.sets == [1, 0], "it is back, and GPS agrees"
