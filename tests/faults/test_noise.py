"""Random bytes on the serial line: nothing comes of them."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import TelemetryConfig
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import MavlinkCodec
from sim.vehicle.pty_link import PtyLink

MB = 1_000_000
TURN_BYTES = 2048  # at 921600 baud, 20 ms


@pytest.mark.parametrize("megabytes", [20, pytest.param(100, marks=pytest.mark.soak)])
def test_the_line_is_noise(
    megabytes: int, cable: PtyLink, seed: int, proc: Any, figures: Callable[[str], None]
) -> None:
    rng = random.Random(seed)
    recorded: list[msgspec.Struct] = []
    now_ns = 10**12
    connection = AutopilotConnection(
        TelemetryConfig(connection=f"serial:{cable.device}:921600", emit="external_position"),
        lambda: now_ns,
        recorded.append,
    )
    began_s, sent, before = time.monotonic(), 0, 0
    states = set()
    while sent < megabytes * MB:
        assert cable.send(rng.randbytes(TURN_BYTES))
        sent += TURN_BYTES
        now_ns += 20_000_000
        connection.poll()
        cable.receive()
        states.add(connection.state)
        if not before and sent > MB:
            before = proc.resident_bytes()  # the parser and the queues have been used by now
    grown = proc.resident_bytes() - before
    connection.close()
    took_s = time.monotonic() - began_s
    figures(f"{sent / MB:.0f} MB of noise in {took_s:.0f} s; link {states}; RSS grew by {grown / MB:.2f} MB")
    assert states == {"waiting"}
    assert [type(record).__name__ for record in recorded] == ["LinkChanged"]
    assert not connection.vehicle.connected
    assert connection.vehicle.position(now_ns) is None
    assert connection.vehicle.motion.distance_m(now_ns) is None
    assert grown < 5 * MB


def test_frames_that_look_as_if_one_began_within_each_are_read_again_soon() -> None:
    """Heartbeats whose custom mode looks like the beginning of a frame as long as they are; the first one is cut."""
    beat = bytes(mavlink.MAVLink_heartbeat_message(10, 3, 0, 0x0009FD, 4, 3).pack(mavlink.MAVLink(None)))
    within = beat.index(b"\xfd\x09\x00", 1)
    codec = MavlinkCodec(1, 191)
    assert codec.decode(beat[within:]) == []
    read = [len(codec.decode(beat)) for _ in range(40)]
    assert sum(read[:10]) == 0
    assert sum(read[20:]) == 20
