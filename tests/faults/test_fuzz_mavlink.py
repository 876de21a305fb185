"""MAVLink frames with good checksums and any content at all, from anybody: read, or left alone."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import TelemetryConfig
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.signing import EPOCH_S, TICKS_PER_S, Signer
from sim.vehicle.pty_link import open_pty

KINDS = {number: kind for number, kind in mavlink.mavlink_map.items() if 0 <= number < 2**24}
READ = (0, 1, 2, 24, 32, 33, 49, 74, 77, 111, 147, 148, 230, 331, 9000, 30)
TURN_NS = 20_000_000

Case = tuple[int, int, int, bytes]


def frame(system: int, component: int, number: int, payload: bytes) -> bytes:
    """A MAVLink 2 frame by the book, not by the codec under test."""
    body = bytes([len(payload), 0, 0, 0, system, component]) + number.to_bytes(3, "little") + payload
    checksum = mavlink.x25crc(body + bytes([KINDS[number].crc_extra])).crc
    return b"\xfd" + body + int(checksum).to_bytes(2, "little")


HEARTBEAT = frame(1, 1, 0, bytes([0, 0, 0, 0, 10, 3, 0, 4, 3]))


@pytest.mark.parametrize("cases", [150, pytest.param(10_000, marks=pytest.mark.soak)])
def test_any_content(cases: int, seed: int, figures: Callable[[str], None]) -> None:
    cable = open_pty()
    ticks = count(10**12, TURN_NS)
    now_ns = next(ticks)
    connection = AutopilotConnection(
        TelemetryConfig(connection=f"serial:{cable.device}:921600", emit="external_position"), lambda: now_ns
    )
    connected = 0

    def check(sent: list[Case]) -> None:
        nonlocal now_ns, connected
        for case in sent:
            cable.send(HEARTBEAT + frame(*case))
            now_ns = next(ticks)
            connection.poll()
            cable.receive()
            vehicle = connection.vehicle
            connected += vehicle.connected
            position, speed_mps = vehicle.position(now_ns), vehicle.motion.speed_mps(now_ns)
            assert position is None or math.isfinite(position.lat_deg + position.lon_deg + position.speed_mps)
            assert speed_mps is None or math.isfinite(speed_mps)
            assert math.isfinite(vehicle.motion.distance_m(now_ns) or 0.0)
            assert math.isfinite(vehicle.boot_time_s(now_ns) or 0.0)
            assert math.isfinite(vehicle.accuracy_m(now_ns) or 0.0)
            connection.position_due()

    number = st.one_of(st.sampled_from(READ), st.sampled_from(sorted(KINDS)))
    payload = st.one_of(
        st.binary(max_size=60),
        st.lists(st.sampled_from([b"\0\0\xc0\x7f", b"\0\0\x80\x7f", b"\xff" * 4, b"\0" * 4]), max_size=12).map(
            b"".join
        ),
    )
    case = st.tuples(st.sampled_from([1, 1, 1, 2, 255]), st.sampled_from([1, 1, 0, 191]), number, payload)
    limits = settings(max_examples=cases, deadline=10_000, database=None, suppress_health_check=list(HealthCheck))
    seeded(seed)(limits(given(st.lists(case, min_size=1, max_size=20))(check)))()
    connection.close()
    cable.close()
    figures(f"{cases} cases; connected after {connected} frames")
    assert connected > cases


def signed(key: bytes, link: int, timestamp: int, system: int, payload: bytes) -> bytes:
    """A signed heartbeat by the book."""
    body = bytes([len(payload), 1, 0, 0, system, 1]) + bytes(3) + payload
    checksum = mavlink.x25crc(body + bytes([KINDS[0].crc_extra])).crc
    whole = b"\xfd" + body + int(checksum).to_bytes(2, "little") + bytes([link]) + timestamp.to_bytes(6, "little")
    return whole + hashlib.sha256(key + whole).digest()[:6]


@pytest.mark.parametrize("cases", [150, pytest.param(10_000, marks=pytest.mark.soak)])
def test_any_signature(cases: int, tmp_path: Path, seed: int, figures: Callable[[str], None]) -> None:
    """With a key that is not ours, any time, cut short or with bits changed: none is read, and a good one still is."""
    ours, others, beat = bytes(range(32)), bytes(32), bytes([0, 0, 0, 0, 10, 3, 0, 4, 3])
    codec = MavlinkCodec(1, 191, Signer(ours, tmp_path / "clock", 0))
    newest = round((time.time() - EPOCH_S) * TICKS_PER_S)
    longest = read = refused = 0

    def check(sent: list[tuple[int, int, int, bytes, int, int]]) -> None:
        nonlocal longest, read, refused
        for link, timestamp, system, payload, cut, flip in sent:
            bad = bytearray(signed(others, link, timestamp, system, payload))
            bad[flip % len(bad)] ^= 1 << flip % 8
            assert codec.decode(bytes(bad[: len(bad) - cut])) == []
            refused += 1
        # What was cut short is waited for, for as long as it claims to be, and what looks like a beginning after it.
        for waited in range(200):
            if codec.decode(good()):
                longest = max(longest, waited)
                read += 1
                return
        raise AssertionError("no good one is read any more")

    def good() -> bytes:
        nonlocal newest
        newest = max(newest + 1, round((time.time() - EPOCH_S) * TICKS_PER_S))  # however long the test takes
        return signed(ours, 0, newest, 1, beat)

    case = st.tuples(
        st.integers(0, 255),
        st.one_of(st.integers(0, 2**48 - 1), st.sampled_from([0, 2**48 - 1, newest, newest + 1])),
        st.integers(0, 255),
        st.binary(min_size=1, max_size=9),
        st.one_of(st.just(0), st.integers(0, 30)),
        st.integers(0, 2**12),
    )
    limits = settings(max_examples=cases, deadline=10_000, database=None, suppress_health_check=list(HealthCheck))
    seeded(seed)(limits(given(st.lists(case, max_size=5))(check)))()
    figures(f"{refused} bad ones refused, after each few a good one read, the {longest}. after them at the latest")
    assert read >= cases
