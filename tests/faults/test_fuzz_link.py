"""A stranger sends whatever he likes to an unsigned link: no turn of it stalls, and nothing is raised."""

from __future__ import annotations

import math
import random
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from hypothesis import HealthCheck, Verbosity, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st
from hypothesis.errors import FlakyFailure
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import Config, GatesConfig, TelemetryConfig
from edge.localization import PlaceFix
from edge.telemetry.autopilot import AutopilotConnection
from edge_plugins.home import HomeConfig
from edge_plugins.home.home_requests import HomeRequests
from edge_plugins.home.route import RoutePlan
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import PtyLink, open_pty
from tests.faults.test_fuzz_mavlink import HEARTBEAT, KINDS, frame
from tests.telemetry.rig import ToldEstimator
from tests.udp_port import free_port

STALL_S = 1.0
HOME = mavlink.MAVLink_command_long_message(1, 191, 31014, 0, 1, 5665, 0, 0, 0, 0, 0).pack(mavlink.MAVLink(None, 255))
WAY = RoutePlan("drive 1", tuple((-27.47 - 1e-4 * row, 153.02) for row in range(40)), (0.0, 440.0), 50, ())
Step: TypeAlias = tuple[str, Any]


def _damaged(data: bytes, end: int, bit: int) -> bytes:
    bad = bytearray(data)
    bad[bit % len(bad)] ^= 1 << bit % 8
    return bytes(bad[: max(1, len(bad) - end)])


byte, word = st.integers(0, 255), st.integers(0, 2**32 - 1)
boot_ms = st.one_of(st.integers(990_000, 1_020_000), word)
degrees = st.one_of(st.integers(-274_710_000, -274_700_000), st.integers(-(2**31), 2**31 - 1))
number = st.one_of(st.integers(0, 45), st.integers(0, 65_535))
real = st.floats(width=32)


def say(kind: Any, *fields: Any) -> Any:
    """A message of one kind with any of those values, as the autopilot or somebody else would send it."""
    sender = st.tuples(st.sampled_from([1, 1, 1, 2, 255]), st.sampled_from([1, 1, 1, 191]))
    return st.builds(
        lambda ids, values: bytes(kind(*values).pack(mavlink.MAVLink(None, *ids))), sender, st.tuples(*fields)
    )


one, us, mission = st.just(1), st.sampled_from([191, 191, 0]), st.sampled_from([0, 0, 0, 1, 255])
forged = st.one_of(
    say(mavlink.MAVLink_heartbeat_message, byte, st.sampled_from([3, 12, 8]), byte, word, byte, one),
    say(
        mavlink.MAVLink_global_position_int_message,
        boot_ms,
        degrees,
        degrees,
        degrees,
        degrees,
        *[st.integers(-32768, 32767)] * 3,
        number,
    ),
    say(mavlink.MAVLink_local_position_ned_message, boot_ms, *[real] * 6),
    say(mavlink.MAVLink_system_time_message, word, boot_ms),
    say(mavlink.MAVLink_timesync_message, *[st.integers(-(2**63), 2**63 - 1)] * 2),
    say(mavlink.MAVLink_wheel_distance_message, word, byte, st.lists(st.floats(), min_size=16, max_size=16)),
    say(mavlink.MAVLink_gps_global_origin_message, degrees, degrees, degrees),
    say(
        mavlink.MAVLink_gps_raw_int_message,
        word,
        byte,
        degrees,
        degrees,
        degrees,
        *[number] * 4,
        byte,
        degrees,
        word,
        word,
    ),
    say(mavlink.MAVLink_sys_status_message, word, word, word, *[number] * 2, st.just(0), st.just(0), *[number] * 6),
    say(mavlink.MAVLink_estimator_status_message, word, number, *[real] * 8),
    say(
        mavlink.MAVLink_param_value_message,
        st.sampled_from([b"EK3_SRC1_VELXY", b"WENC_TYPE", b"EKF2_EV_CTRL"]),
        real,
        byte,
        number,
        number,
    ),
    say(
        mavlink.MAVLink_command_long_message,
        one,
        us,
        st.sampled_from([31010, 31014, 512]),
        byte,
        st.sampled_from([0.0, 1.0]),
        st.sampled_from([5665.0, 0.0]),
        *[real] * 5,
    ),
    say(mavlink.MAVLink_command_ack_message, st.sampled_from([31010, 42007, 511, 512, 43003]), byte),
    say(mavlink.MAVLink_mission_count_message, one, us, number, mission),
    say(mavlink.MAVLink_mission_request_int_message, one, us, number, mission),
    say(
        mavlink.MAVLink_mission_item_int_message,
        one,
        us,
        number,
        byte,
        number,
        byte,
        byte,
        *[real] * 4,
        degrees,
        degrees,
        real,
        mission,
    ),
    say(mavlink.MAVLink_mission_ack_message, one, us, byte, mission),
    say(mavlink.MAVLink_mission_current_message, number),
)
any_frame = st.builds(frame, st.just(1), st.just(1), st.sampled_from(sorted(KINDS)), st.binary(max_size=60))
cut = st.builds(_damaged, forged, st.integers(0, 40), st.integers(0, 4095))
noise = st.builds(
    lambda pattern, size: (pattern * size)[:size],
    st.one_of(st.binary(min_size=1, max_size=12), st.sampled_from([b"\xfd\xff", b"\xfe\x21\x00", b"\xfd\x09\x00\x00"])),
    st.integers(1, 60_000),
)
sent = st.tuples(st.one_of(forged, forged, any_frame, cut, noise), st.sampled_from([1, 1, 1, 10, 300]))
STEPS: Any = st.one_of(
    st.tuples(st.just("send"), sent),
    st.tuples(st.just("send"), sent),
    st.tuples(st.just("wait"), st.sampled_from([0.02, 0.3, 1.0, 4.0, 60.0])),
    st.tuples(st.just("home"), st.none()),
    st.tuples(st.just("gone"), st.none()),
)


@st.composite
def step(draw: st.DrawFn) -> Step:
    """One of the above, under a name of its own: hypothesis warns of a longer one."""
    return draw(STEPS)  # type: ignore[no-any-return]


class Stranger:
    """His end of the link, which may go and come again; `connection` is what the daemon is given."""

    def __init__(self, kind: str) -> None:
        self._kind, self._port = kind, 0
        self._socket: socket.socket | None = None
        self.cable: PtyLink | None = open_pty() if kind == "serial" else None
        if self.cable is not None:
            self.connection = f"serial:{self.cable.device}:921600"
            return
        self._port = free_port(socket.SOCK_STREAM if kind == "tcpin" else socket.SOCK_DGRAM)
        self.connection = f"{kind}:127.0.0.1:{self._port}"

    def send(self, data: bytes) -> None:
        if self.cable is not None:
            self.cable.send(data)
            return
        try:
            if self._socket is None:
                stream = self._kind == "tcpin"
                self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM if stream else socket.SOCK_DGRAM)
                self._socket.setblocking(False)
                self._socket.connect_ex(("127.0.0.1", self._port))  # waits for nobody, where the queue is full
            self._socket.send(data)
        except BlockingIOError:  # its buffer is full
            pass
        except OSError:  # nobody listens
            self.go()

    def receive(self) -> None:
        """Reads what was sent to him, so that nothing waits for him."""
        try:
            if self._socket is not None:
                while self._socket.recv(65_536):
                    pass
        except OSError:
            pass

    def go(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def close(self) -> None:
        self.go()
        if self.cable is not None:
            self.cable.close()


class Turns:
    """The link as the daemon uses it, on the computer's clock, which a step may put ahead; and its longest turn."""

    def __init__(self, kind: str, folder: Path) -> None:
        self.longest_s, self._ahead_ns = 0.0, 0
        self.stranger = Stranger(kind)
        config = TelemetryConfig(
            connection=self.stranger.connection, emit="external_position", journal=str(folder / "events.jsonl")
        )
        home = HomeConfig(enabled=True, speed_mps=2.5)
        gates = GatesConfig(with_gps=True, risk=1.0)
        self.drive = ToldEstimator(Config(gates=gates))
        self.link = AutopilotConnection(config, self.clock_ns, gates=gates, drive=self.drive)
        self.home = HomeRequests(home, self.link)
        self.link.serve(self.home)
        self.home.plan = lambda start, places: WAY
        self.autopilot: SimulatedAutopilot | None = None
        if self.stranger.cable is not None:
            pose = Pose(0.0, 0.0, 0.0, 5.0, 0.0)
            self.autopilot = SimulatedAutopilot(self.stranger.cable, lambda now_s: pose, self.clock_ns)
        self.turn()  # opens it
        for _ in range(40):  # an autopilot that drives: its streams, or just its heartbeats
            self.run("wait", 0.1)
            if self.autopilot is None:
                self.run("send", (HEARTBEAT, 1))

    def clock_ns(self) -> int:
        return time.monotonic_ns() + self._ahead_ns

    def run(self, what: str, value: Any) -> None:
        if what == "send":
            data, times = value
            for _ in range(times):
                self.stranger.send(data)
        elif what == "wait":
            self._ahead_ns += round(value * 1e9)
        elif what == "home":
            self.stranger.send(HOME)
        else:
            self.stranger.go()
        self.turn()

    def turn(self) -> None:
        if self.autopilot is not None:
            self.autopilot.step()
        else:
            self.stranger.receive()
        with self._timed():
            self.link.poll()
            now_ns = self.clock_ns()
            limits = self.link.position_due()
            if limits is not None:
                fix = PlaceFix(
                    now_ns, 1, -27.4705, 153.02, 0.0, 3.0, 2.0, "reverse", "same", 1.3, matches=20, confidence=0.9
                )
                self.link.report_own()
                self.drive.offer(now_ns, fix, self.link.vehicle.motion.displacement(now_ns))
                self.link.send_position(self.drive.fix(now_ns, limits))
            self.link.set_system_status(4)
            assert self.link.status().state == self.link.state
            own = self.link.vehicle.own(now_ns)
            position, speed_mps = own.position, own.speed_mps
            self.link.vehicle.motion.distance_m(now_ns)
            self.link.vehicle.gps_fix(now_ns, now_ns)
        assert position is None or math.isfinite(position.lat_deg + position.lon_deg + position.speed_mps)
        assert speed_mps is None or math.isfinite(speed_mps)

    @contextmanager
    def _timed(self) -> Iterator[None]:
        began_s, waited_s = time.monotonic(), waited_for_a_processor_s()
        yield
        took_s = time.monotonic() - began_s - (waited_for_a_processor_s() - waited_s)
        self.longest_s = max(self.longest_s, took_s)
        assert took_s < STALL_S, f"a turn stalled for {took_s:.2f} s"

    def close(self) -> None:
        self.link.close()
        self.stranger.close()


def waited_for_a_processor_s() -> float:
    """How long this thread could have run, while others did: no fault of the link."""
    return int(Path("/proc/thread-self/schedstat").read_text().split()[1]) / 1e9


@pytest.mark.parametrize(("cases", "lasts_s"), [(8, 0.0), pytest.param(40, 3600.0, marks=pytest.mark.soak)])
def test_no_turn_stalls(cases: int, lasts_s: float, tmp_path: Path, seed: int, figures: Callable[[str], None]) -> None:
    until_s, rng = time.monotonic() + lasts_s, random.Random(seed)
    longest, turns, ups = 0.0, 0, 0
    pauses: list[str] = []

    def check(kind: str, steps: list[Step]) -> None:
        nonlocal longest, turns, ups
        run = Turns(kind, tmp_path)
        try:
            for what, value in steps:
                run.run(what, value)
                ups += run.link.state == "up"
        finally:
            run.close()
        longest, turns = max(longest, run.longest_s), turns + len(steps)

    limits = settings(
        max_examples=cases,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
        verbosity=Verbosity.quiet,
    )
    kinds = st.sampled_from(["serial", "udpin", "tcpin"])
    fuzz = given(kinds, st.lists(step(), min_size=10, max_size=60))
    while True:
        round_seed = rng.randrange(2**32)
        try:
            seeded(round_seed)(limits(fuzz(check)))()
        except FlakyFailure as failure:  # the same input does it no more: the computer paused
            pauses.append(str(failure.exceptions[0]))
        if time.monotonic() >= until_s:
            break
    figures(
        f"{turns} turns in {lasts_s / 60:.0f} min, up in {ups}; the longest {longest:.3f} s; not repeated: {pauses}"
    )
    assert len(pauses) <= lasts_s // 600
    assert all("stalled" in pause for pause in pauses)
    assert ups > turns // 4
