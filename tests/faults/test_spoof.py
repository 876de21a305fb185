"""A signed link under attack: nothing is acted on that the autopilot has not signed now, and what it has signed is."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import TelemetryConfig
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.signing import Signer
from sim import Pose
from sim.vehicle.pty_link import open_pty

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
TURN_NS = 20_000_000
NORTH = Pose(0.0, 0.0, 0.0, 5.0, 0.0)
SOUTH = Pose(0.0, -5_000.0, 180.0, 99.0, 0.0)
"""Where and how fast an attacker would have the vehicle be."""
HOUR_S = 3600.0


@pytest.mark.parametrize("rounds", [300, pytest.param(10_000, marks=pytest.mark.soak)])
def test_attacks_on_a_signed_link(rounds: int, tmp_path: Path, seed: int, figures: Callable[[str], None]) -> None:
    rng = random.Random(seed)
    now_ns = 10**12
    (tmp_path / "key").write_bytes(KEY)
    (tmp_path / "key").chmod(0o600)
    # Our wall clock is the machine's; the vehicle's runs with the test's clock from the same moment.
    start_s = time.time() - now_ns / 1e9

    def clock_ns() -> int:
        return now_ns

    def signer(name: str, key: bytes, ahead_s: float = 0.0) -> Signer:
        return Signer(key, tmp_path / name, 0, lambda: start_s + now_ns / 1e9 + ahead_s)

    cable = open_pty()
    connection = AutopilotConnection(
        TelemetryConfig(
            connection=f"serial:{cable.device}:921600",
            signing_key=str(tmp_path / "key"),
            signing_clock=str(tmp_path / "clock"),
        ),
        clock_ns,
    )

    def vehicle(pose: Pose, codec_signer: Signer | None) -> Sender:
        return Sender(pose, MavlinkCodec(1, 1, codec_signer))

    good = vehicle(NORTH, signer("good", KEY))
    attackers: dict[str, Sender] = {
        "unsigned": vehicle(SOUTH, None),
        "another key": vehicle(SOUTH, signer("forger", OTHER)),
        "future-dated": vehicle(SOUTH, signer("future", OTHER, ahead_s=HOUR_S)),
        "stale": vehicle(SOUTH, signer("stale", KEY, ahead_s=-HOUR_S)),
    }
    old: list[bytes] = []
    ups = 0
    for _ in range(rounds):
        now_ns += TURN_NS * 5
        frames = good.frames(now_ns)
        for frame in frames:
            cable.send(frame)
        connection.poll()
        ups += connection.state == "up"
        name = rng.choice([*attackers, "replayed", "altered"])
        if name == "replayed" and old:
            cable.send(rng.choice(old))
        elif name == "altered" and old:
            altered = bytearray(frames[0] if frames else old[-1])
            altered[rng.randrange(10, len(altered))] ^= 1 << rng.randrange(8)
            cable.send(bytes(altered))
        elif name in attackers:
            for frame in attackers[name].frames(now_ns)[:1]:
                cable.send(frame)
        connection.poll()
        old += frames
        cable.receive()
        position, speed_mps = connection.vehicle.position(now_ns), connection.vehicle.motion.speed_mps(now_ns)
        assert position is None or position.lat_deg > -27.48, name
        assert speed_mps is None or speed_mps == pytest.approx(5.0, abs=0.02), name
    assert connection.state == "up"
    assert connection.vehicle.position(now_ns) is not None
    connection.close()
    cable.close()
    figures(f"{rounds} rounds of six attacks; up in {ups} of them, nothing acted on")
    assert ups > rounds - 30


class Sender:
    """What an autopilot at a pose would send: heartbeats and positions, as frames."""

    def __init__(self, pose: Pose, codec: MavlinkCodec) -> None:
        self._codec = codec
        self._pose = pose
        self._next = 0

    def frames(self, now_ns: int) -> list[bytes]:
        lat_deg, lon_deg = self._pose.geodetic()
        self._next += 1
        messages: list[Any] = [
            mavlink.MAVLink_global_position_int_message(
                now_ns // 10**6,
                round(lat_deg * 1e7),
                round(lon_deg * 1e7),
                alt=0,
                relative_alt=0,
                vx=round(self._pose.speed_mps * 100),
                vy=0,
                vz=0,
                hdg=0,
            )
        ]
        if self._next % 5 == 0:
            messages.insert(0, mavlink.MAVLink_heartbeat_message(10, 3, 0, 0, 4, 3))
        return [self._codec.encode(message) for message in messages]
