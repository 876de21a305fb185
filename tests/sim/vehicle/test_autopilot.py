"""The simulated autopilot, spoken to by pymavlink as a companion computer would."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import MavlinkCodec
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from sim.vehicle.pty_link import PtyLink, open_pty

SPEED_MPS = 5.0


@dataclass
class Bench:
    """An autopilot on its end of a pseudo-terminal, and a companion on the other, in one thread and simulated time."""

    firmware: Any = "ardupilot"
    gps: bool = True
    drift_percent: float = 0.0
    now_ns: int = 1_000_000_000_000
    heard: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.autopilot_end = open_pty()
        self.companion_end = CompanionEnd(self.autopilot_end)
        self.codec = MavlinkCodec(1, 191)
        self.autopilot = SimulatedAutopilot(
            self.autopilot_end,
            straight_line(SPEED_MPS, 30.0, self.now_ns / 1e9),
            lambda: self.now_ns,
            firmware=self.firmware,
            gps=self.gps,
            drift_percent=self.drift_percent,
        )

    def drive(self, seconds: float, step_s: float = 0.01) -> None:
        for _ in range(round(seconds / step_s)):
            self.now_ns += round(step_s * 1e9)
            self.autopilot.step()
            self.heard += self.codec.decode(self.companion_end.receive())

    def send(self, message: Any) -> None:
        self.companion_end.send(self.codec.encode(message))
        self.drive(0.05)

    def of(self, name: str) -> list[Any]:
        return [message for message in self.heard if message.get_type() == name]

    def send_fix(
        self, pose: Pose, *, age_s: float = 0.0, z: float = math.nan, frame: int = 0, clock_s: Any = None
    ) -> int:
        lat_deg, lon_deg = pose.geodetic()
        send_s = self.autopilot.boot_s if clock_s is None else clock_s
        position = round(lat_deg * 1e7), round(lon_deg * 1e7)
        self.send(mavlink.MAVLink_command_int_message(1, 1, frame, 43003, 0, 0, send_s, age_s, 5.0, 0.0, *position, z))
        return int(self.of("COMMAND_ACK")[-1].result)


class CompanionEnd:
    """The device side of the pseudo-terminal, read and written as files."""

    def __init__(self, pty: PtyLink) -> None:
        from edge.telemetry.link import SerialLink

        self._link = SerialLink(pty.device, 921600)
        self.receive, self.send, self.close = self._link.receive, self._link.send, self._link.close


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    bench = Bench(**getattr(request, "param", {}))
    yield bench
    bench.companion_end.close()
    bench.autopilot_end.close()


def test_only_heartbeats_and_timesync_until_streams_are_asked_for(bench: Bench) -> None:
    bench.drive(4.5)
    assert {message.get_type() for message in bench.heard} == {"HEARTBEAT", "TIMESYNC"}
    assert len(bench.of("HEARTBEAT")) == 5


def test_streams_come_at_the_rate_that_was_asked_for_until_a_reboot(bench: Bench) -> None:
    bench.send(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 33, 100_000, 0, 0, 0, 0, 0))
    assert bench.of("COMMAND_ACK")[-1].result == mavlink.MAV_RESULT_ACCEPTED
    bench.heard.clear()
    bench.drive(4.0)
    positions = bench.of("GLOBAL_POSITION_INT")
    assert len(positions) == pytest.approx(40, abs=1)
    assert math.hypot(positions[-1].vx, positions[-1].vy) == pytest.approx(100 * SPEED_MPS, abs=1)
    bench.autopilot.reboot()
    bench.heard.clear()
    bench.drive(4.0)
    assert not bench.of("GLOBAL_POSITION_INT")


def test_timesync_is_answered_on_the_boot_clock(bench: Bench) -> None:
    bench.drive(2.0)
    bench.send(mavlink.MAVLink_timesync_message(0, 123456789))
    answer = next(message for message in bench.of("TIMESYNC") if message.tc1)
    assert answer.ts1 == 123456789
    assert answer.tc1 == pytest.approx(2.01e9, abs=1e6)


@pytest.mark.parametrize("bench", [{"gps": False, "drift_percent": 3.0}], indirect=True)
def test_without_gps_the_estimate_drifts_and_a_fix_resets_it(bench: Bench) -> None:
    bench.drive(40.0)
    assert bench.autopilot.estimate.error_m == pytest.approx(0.03 * 40.0 * SPEED_MPS, rel=0.01)
    # Exposed a second ago, five meters back: the age must carry it to where the vehicle is now.
    exposed = straight_line(SPEED_MPS, 30.0, 0.0)(39.0)
    assert bench.send_fix(exposed, age_s=1.0) == mavlink.MAV_RESULT_ACCEPTED
    reset = bench.autopilot.resets[-1]
    assert reset.error_before_m > 5.9
    assert reset.error_after_m < 0.3


@pytest.mark.parametrize("bench", [{"gps": False}], indirect=True)
def test_a_send_time_off_the_boot_clock_costs_half_a_second_of_travel(bench: Bench) -> None:
    bench.drive(10.0)
    bench.send_fix(straight_line(SPEED_MPS, 30.0, 0.0)(10.0), clock_s=0.0)
    assert bench.autopilot.resets[-1].error_after_m == pytest.approx(0.5 * SPEED_MPS, abs=0.1)


@pytest.mark.parametrize(
    ("bench", "fix", "result"),
    [
        ({"gps": False}, {"z": 0.0}, mavlink.MAV_RESULT_DENIED),
        ({"gps": False}, {"frame": 6}, mavlink.MAV_RESULT_DENIED),
        ({"gps": True}, {}, mavlink.MAV_RESULT_FAILED),
        ({"gps": True, "firmware": "px4"}, {}, mavlink.MAV_RESULT_ACCEPTED),
    ],
    indirect=["bench"],
)
def test_refusals(bench: Bench, fix: dict[str, Any], result: int) -> None:
    bench.drive(2.0)
    assert bench.send_fix(straight_line(SPEED_MPS, 30.0, 0.0)(2.0), **fix) == result


def test_a_fix_as_command_long_is_unsupported(bench: Bench) -> None:
    bench.send(mavlink.MAVLink_command_long_message(1, 1, 43003, 0, 0, 0, 5, 0, -27.0, 153.0, math.nan))
    assert bench.of("COMMAND_ACK")[-1].result == mavlink.MAV_RESULT_UNSUPPORTED
