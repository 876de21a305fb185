"""The simulated autopilot against what the real ones were recorded to say, and against the table of what they do."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.localization import PlaceFix
from edge.telemetry import encoders
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.encoders import MessageContext
from edge.telemetry.session import Origin
from sim import ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from sim.vehicle.estimator import OdometryErrors
from sim.vehicle.firmware import FIRMWARES
from sim.vehicle.px4_modes import MODES, NO_AID_TIMEOUT
from tests.tlog import messages_of

RECORDED = {"ardupilot": "ardurover-4.6.3-nogps", "px4": "px4-1.18-agp"}
SPEED_MPS = 5.0
START_NS = 1_000_000_000_000
NAN = math.nan


class Wire:
    """A link without a cable: what one end sends, the other finds."""

    def __init__(self) -> None:
        self.inbox, self.outbox = bytearray(), bytearray()

    def receive(self) -> bytes:
        data = bytes(self.inbox)
        self.inbox.clear()
        return data

    def send(self, data: bytes) -> bool:
        self.outbox += data
        return True

    def fileno(self) -> int:
        raise OSError

    def close(self) -> None:
        pass


class Rover:
    """An autopilot that drives north, and what it said, with the time of each message."""

    def __init__(self, firmware: str, **options: Any) -> None:
        self.now_ns = START_NS
        self.wire = Wire()
        pose_at = straight_line(SPEED_MPS, 0.0, START_NS / 1e9)
        self.autopilot = SimulatedAutopilot(self.wire, pose_at, lambda: self.now_ns, firmware=firmware, **options)
        self.ours, self.reader = MavlinkCodec(1, 191), MavlinkCodec(1, 191)
        self.heard: list[tuple[float, Any]] = []

    def drive(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.now_ns += 10_000_000
            self.autopilot.step()
            said, self.wire.outbox = bytes(self.wire.outbox), bytearray()
            self.heard += [((self.now_ns - START_NS) / 1e9, message) for message in self.reader.decode(said)]

    def tell(self, message: Any) -> int | None:
        """Send a message; the result of the acknowledgement, if there is one."""
        before = len(self.of("COMMAND_ACK"))
        self.wire.inbox += self.ours.encode(message)
        self.drive(0.02)
        answers = self.of("COMMAND_ACK")[before:]
        return int(answers[0].result) if answers else None

    def of(self, name: str) -> list[Any]:
        return [message for _, message in self.heard if message.get_type() == name]

    def fix(self, north_m: float = 0.0, sigma_m: float = 3.0) -> PlaceFix:
        """Where the vehicle is, and `north_m` further."""
        truth = straight_line(SPEED_MPS, 0.0, START_NS / 1e9)(self.now_ns / 1e9 + north_m / SPEED_MPS)
        lat_deg, lon_deg = truth.geodetic()
        return PlaceFix(self.now_ns, 1, lat_deg, lon_deg, 0.0, sigma_m, sigma_m, "forward", "same", 1.2)

    def sending(self, age_s: float = 0.0) -> MessageContext:
        return MessageContext(1, self.autopilot.boot_s, age_s)

    def tell_fix(self, north_m: float = 0.0, age_s: float = 0.0) -> int | None:
        return self.tell(encoders.external_position(self.fix(north_m), self.sending(age_s)))


def recorded(shared: Path, name: str) -> Iterator[tuple[float, Any]]:
    for now_ns, messages in messages_of(shared / "autopilot" / f"{name}.tlog"):
        for message in messages:
            if (message.get_srcSystem(), message.get_srcComponent()) == (1, 1):
                yield now_ns / 1e9, message


def facts(said: list[tuple[float, Any]]) -> dict[str, Any]:
    """What a companion's programmer relies on, read off in the same way from both."""
    of: dict[str, list[tuple[float, Any]]] = {}
    for at_s, message in said:
        of.setdefault(message.get_type(), []).append((at_s, message))
    requests_s = [at_s for at_s, message in of["TIMESYNC"] if message.tc1 == 0]
    lost = next(m for _, m in of["GPS_RAW_INT"] if m.fix_type < 2)
    first = of["GLOBAL_POSITION_INT"][0][1]
    clocks_s, booted_s = [], math.nan
    for at_s, message in said:  # one clock against the other where they are neighbors, since both may drift
        if message.get_type() == "GLOBAL_POSITION_INT":
            booted_s = at_s - message.time_boot_ms / 1e3
        elif message.get_type() == "TIMESYNC" and message.tc1 == 0 and not math.isnan(booted_s):
            clocks_s.append(at_s - message.ts1 / 1e9 - booted_s)
    return {
        "autopilot": of["HEARTBEAT"][0][1].autopilot,
        "heartbeats_s": round(float(np.median(np.diff([at_s for at_s, _ in of["HEARTBEAT"]]))), 0),
        "timesync_s": float(f"{np.median(np.diff(requests_s)):.0e}"),
        "timesync_of_boot_clock": max(map(abs, clocks_s)) < 0.1,
        "position_before_an_origin": (first.lat, first.lon) == (0, 0),
        "gps_lost": (lost.lat, lost.lon, lost.satellites_visible) == (0, 0, 0),
        "fix_answers": sorted({m.result for _, m in of.get("COMMAND_ACK", []) if m.command == 43003}),
        "answers_are_for": {
            (m.target_system, m.target_component) for _, m in of.get("COMMAND_ACK", []) if m.command == 43003
        },
        "reports_accuracy": "ESTIMATOR_STATUS" in of,
    }


def asked_for_everything(bench: Rover) -> None:
    for message_id in (33, 32, 24, 2, 230, 9000, 74):
        bench.tell(encoders.stream_request(1, message_id, 10.0))


def test_it_says_what_the_real_rover_was_recorded_to_say(shared: Path) -> None:
    """The same scene: no GPS from boot, a fix too early, an origin by the ground station, fixes while driving."""
    bench = Rover("ardupilot", gps=False, has_origin=False)
    asked_for_everything(bench)
    bench.drive(4.0)
    bench.tell_fix()
    bench.tell(encoders.set_origin(1, Origin(ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M)))
    bench.drive(40.0)
    bench.tell_fix()
    assert facts(bench.heard) == facts(list(recorded(shared, RECORDED["ardupilot"])))
    assert len(bench.of("GPS_GLOBAL_ORIGIN")) == 1


def test_it_says_what_the_real_px4_was_recorded_to_say(shared: Path) -> None:
    bench = Rover("px4")
    asked_for_everything(bench)
    bench.drive(20.0)
    bench.autopilot.gps = False
    bench.drive(20.0)
    told, real = facts(bench.heard), facts(list(recorded(shared, RECORDED["px4"])))
    # PX4's GPS_RAW_INT keeps its last position when the receiver is gone; ours, like ArduPilot's, has zeros.
    assert {**told, "gps_lost": None} == {**real, "gps_lost": None}


def test_only_heartbeats_and_timesync_until_streams_are_asked_for() -> None:
    bench = Rover("ardupilot")
    bench.drive(4.5)
    assert {message.get_type() for _, message in bench.heard} == {"HEARTBEAT", "TIMESYNC"}
    assert len(bench.of("HEARTBEAT")) == 5


def test_streams_come_at_the_rate_that_was_asked_for_until_a_reboot() -> None:
    bench = Rover("ardupilot")
    assert bench.tell(encoders.stream_request(1, 33, 10.0)) == mavlink.MAV_RESULT_ACCEPTED
    bench.heard.clear()
    bench.drive(4.0)
    positions = bench.of("GLOBAL_POSITION_INT")
    assert len(positions) == pytest.approx(40, abs=1)
    assert math.hypot(positions[-1].vx, positions[-1].vy) == pytest.approx(100 * SPEED_MPS, abs=1)
    bench.autopilot.reboot()
    bench.heard.clear()
    bench.drive(4.0)
    assert not bench.of("GLOBAL_POSITION_INT")


@pytest.mark.parametrize("changed", [{"z": 0.0}, {"frame": 6}])
def test_a_fix_with_an_altitude_or_of_another_frame_is_denied(changed: dict[str, Any]) -> None:
    bench = Rover("ardupilot", gps=False)
    bench.drive(2.0)
    command = encoders.external_position(bench.fix(), bench.sending())
    for name, value in changed.items():
        setattr(command, name, value)
    assert bench.tell(command) == mavlink.MAV_RESULT_DENIED


def test_a_send_time_off_the_boot_clock_costs_half_a_second_of_travel() -> None:
    bench = Rover("ardupilot", gps=False)
    bench.drive(10.0)
    bench.tell(encoders.external_position(bench.fix(), MessageContext(1, 0.0, 0.0)))
    assert bench.autopilot.resets[-1].error_after_m == pytest.approx(0.5 * SPEED_MPS, abs=0.1)


@pytest.mark.parametrize(
    ("firmware", "gps_s", "without_s", "result"),
    [
        ("ardupilot", 5.0, 0.5, mavlink.MAV_RESULT_FAILED),  # a GPS position within the last second
        ("ardupilot", 5.0, 1.5, mavlink.MAV_RESULT_ACCEPTED),
        ("ardupilot", 5.0, 75.0, mavlink.MAV_RESULT_ACCEPTED),
        ("ardupilot-plain", 5.0, 14.0, mavlink.MAV_RESULT_ACCEPTED),
        ("ardupilot-plain", 5.0, 16.0, mavlink.MAV_RESULT_FAILED),
        ("px4", 5.0, 0.0, mavlink.MAV_RESULT_ACCEPTED),
        ("px4-1.17", 5.0, 0.0, mavlink.MAV_RESULT_ACCEPTED),
        ("px4-1.16", 5.0, 0.0, mavlink.MAV_RESULT_TEMPORARILY_REJECTED),
        ("px4-1.16", 5.0, 1.0, mavlink.MAV_RESULT_ACCEPTED),
        ("px4-1.15", 5.0, 1.0, None),
    ],
)
def test_when_a_fix_is_taken(firmware: str, gps_s: float, without_s: float, result: int | None) -> None:
    bench = Rover(firmware)
    bench.drive(gps_s)
    bench.autopilot.gps = without_s == 0.0
    bench.drive(without_s)
    assert bench.tell_fix() == result


@pytest.mark.parametrize(
    ("firmware", "age_s", "off_m"),
    [("ardupilot", 2.0, 0.0), ("ardupilot", 5.0, 0.0), ("ardupilot", 7.0, 10.0), ("px4", 7.0, 0.0), ("px4", 15.0, 0.0)],
)
def test_ages_are_heeded_up_to_a_limit(firmware: str, age_s: float, off_m: float) -> None:
    bench = Rover(firmware)
    bench.drive(3.0)
    bench.autopilot.gps = False
    bench.drive(20.0)
    bench.tell_fix(north_m=-SPEED_MPS * age_s, age_s=age_s)
    assert bench.autopilot.resets[-1].error_after_m == pytest.approx(off_m, abs=0.3)


def test_only_px4_takes_a_long_command_and_in_steps_of_a_float() -> None:
    results = {}
    for firmware in ("ardupilot", "px4"):
        bench = Rover(firmware)
        bench.drive(3.0)
        fix = bench.fix()
        command = mavlink.MAVLink_command_long_message(
            1, 1, 43003, 0, bench.autopilot.boot_s, 0.0, 5.0, 0, fix.lat_deg, fix.lon_deg, NAN
        )
        results[firmware] = bench.tell(command), [reset.error_after_m for reset in bench.autopilot.resets]
    assert results["ardupilot"] == (mavlink.MAV_RESULT_UNSUPPORTED, [])
    assert results["px4"][0] == mavlink.MAV_RESULT_ACCEPTED
    assert 0.0 < results["px4"][1][0] < 1.0


def test_a_fix_500_m_wrong_is_accepted() -> None:
    for firmware in ("ardupilot", "px4"):
        bench = Rover(firmware)
        bench.drive(3.0)
        bench.autopilot.gps = False
        bench.drive(3.0)
        assert bench.tell_fix(north_m=500.0) == mavlink.MAV_RESULT_ACCEPTED
        assert bench.autopilot.resets[-1].error_after_m == pytest.approx(500.0, abs=1.0)


def test_a_plain_rover_accepts_and_does_not_move() -> None:
    bench = Rover("ardupilot-plain", drift_percent=20.0)
    bench.drive(3.0)
    bench.autopilot.gps = False
    bench.drive(10.0)
    off_m = bench.autopilot.estimate.error_m
    assert bench.tell_fix() == mavlink.MAV_RESULT_ACCEPTED
    assert off_m > 9
    assert bench.autopilot.estimate.error_m == pytest.approx(off_m, abs=0.1)


@pytest.mark.parametrize(("gps", "off_m"), [(True, 0.0), (False, 30.0)])
def test_a_sensor_30_m_wrong_is_ignored_while_gps_is_on(gps: bool, off_m: float) -> None:
    bench = Rover("px4")
    bench.drive(3.0)
    bench.autopilot.gps = gps
    for _ in range(50):
        bench.drive(0.2)
        bench.tell(encoders.global_position_sensor(bench.fix(north_m=30.0), bench.sending()))
    assert bench.autopilot.estimate.error_m == pytest.approx(off_m, abs=1.5)


def test_a_sensor_is_nothing_to_other_firmware() -> None:
    for firmware in sorted(set(FIRMWARES) - {"px4"}):
        bench = Rover(firmware)
        bench.drive(3.0)
        bench.autopilot.gps = False
        bench.drive(3.0)
        bench.tell(encoders.global_position_sensor(bench.fix(north_m=5.0), bench.sending()))
        assert not bench.autopilot.inputs.fused, firmware


def test_odometry_drifts_ahead_and_to_the_side_and_reports_its_own_speed() -> None:
    bench = Rover("ardupilot", gps=False, errors=OdometryErrors(scale=1.02, heading_deg=0.86))
    asked_for_everything(bench)
    bench.drive(40.0)
    estimate = bench.autopilot.estimate
    driven_m = (bench.now_ns - START_NS) / 1e9 * SPEED_MPS
    assert (estimate.north_m, estimate.east_m) == pytest.approx((1.02 * driven_m, 0.0153 * driven_m), rel=0.001)
    velocity = bench.of("LOCAL_POSITION_NED")[-1]
    assert (velocity.vx, velocity.vy) == pytest.approx((1.02 * SPEED_MPS, 0.0153 * SPEED_MPS), rel=0.001)
    wheels = bench.of("WHEEL_DISTANCE")
    turned_m = wheels[-1].distance[0] - wheels[0].distance[0]
    assert turned_m == pytest.approx(SPEED_MPS * (wheels[-1].time_usec - wheels[0].time_usec) / 1e6, rel=0.03)


def test_a_reboot_without_gps_ends_at_the_origin_wherever_the_vehicle_is() -> None:
    bench = Rover("ardupilot")
    bench.drive(2.0)
    bench.autopilot.gps = False
    bench.drive(60.0)
    bench.autopilot.reboot(silent_s=3.0)
    heard = len(bench.heard)
    bench.drive(2.0)
    assert len(bench.heard) == heard
    bench.drive(2.0)
    assert bench.autopilot.origin_m is None
    bench.tell(encoders.set_origin(1, Origin(ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M)))
    estimate = bench.autopilot.estimate
    assert math.hypot(estimate.east_m, estimate.north_m) < 5 * SPEED_MPS
    assert estimate.error_m > 50 * SPEED_MPS


def test_a_reboot_forgets_an_origin_that_was_set() -> None:
    bench = Rover("ardupilot", gps=False, has_origin=False)
    bench.tell(encoders.set_origin(1, Origin(ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M)))
    bench.drive(2.0)
    assert bench.tell_fix() == mavlink.MAV_RESULT_ACCEPTED
    bench.autopilot.reboot()
    bench.drive(2.0)
    assert bench.tell_fix() == mavlink.MAV_RESULT_FAILED


@pytest.mark.parametrize(
    ("source", "chosen", "timeout_us", "without_s", "is_in"),
    [
        ("none", "position", None, 4.0, "position"),
        ("none", "position", None, 6.0, "altitude"),
        ("none", "position", 10_000_000.0, 9.0, "position"),
        ("none", "mission", None, 6.0, "descend"),
        ("none", "stabilized", None, 60.0, "stabilized"),
        ("none", "manual", None, 60.0, "manual"),
        ("velocity sensor", "position", None, 60.0, "position"),
    ],
)
def test_a_px4_rover_without_navigation_leaves_position_for_altitude(
    source: Any, chosen: Any, timeout_us: float | None, without_s: float, is_in: Any
) -> None:
    """PX4#28108: a rover has no Altitude. A measured velocity, a longer timeout and modes without a position help."""
    bench = Rover("px4", errors=OdometryErrors(source))
    bench.autopilot.mode = chosen
    if timeout_us is not None:
        bench.autopilot.parameters[NO_AID_TIMEOUT] = timeout_us, mavlink.MAV_PARAM_TYPE_INT32
    bench.drive(3.0)
    assert mode_of(bench) == MODES[chosen]
    bench.autopilot.gps = False
    bench.drive(without_s + 1.0)  # a heartbeat a second
    assert mode_of(bench) == MODES[is_in]


def test_it_is_back_in_position_with_the_first_position() -> None:
    bench = Rover("px4", errors=OdometryErrors("none"))
    bench.autopilot.mode = "position"
    bench.drive(3.0)
    bench.autopilot.gps = False
    bench.drive(9.0)
    assert mode_of(bench) == MODES["altitude"]
    for _ in range(10):
        bench.tell(encoders.global_position_sensor(bench.fix(), bench.sending()))
        bench.drive(0.2)
    assert mode_of(bench) == MODES["position"]


def test_the_real_px4_fell_back_and_came_back_with_positions(shared: Path) -> None:
    """A quadcopter in Hold: GPS is off, and positions come ever more seldom."""
    beats = [m for _, m in recorded(shared, RECORDED["px4"]) if m.get_type() == "HEARTBEAT" and m.base_mode & 128]
    modes = [(one.custom_mode >> 16 & 0xFF, one.custom_mode >> 24) for one in beats]
    told = [mode for mode, before in zip(modes, [None, *modes], strict=False) if mode != before]
    assert told[1:5] == [MODES["hold"], MODES["descend"]] * 2


def mode_of(bench: Rover) -> tuple[int, int]:
    """Main mode and sub mode by the newest heartbeat."""
    mode = bench.of("HEARTBEAT")[-1].custom_mode
    return mode >> 16 & 0xFF, mode >> 24
