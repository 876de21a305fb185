"""The vehicle's own motion as a witness of GPS, by messages: rates of gyros, wheels, and ODOMETRY of other programs."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.localization.dead_reckoning import GyroReading
from edge.telemetry.vehicle import Vehicle
from tests.common import S
from tests.telemetry.speaker import Speaker

ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
RATE_RADPS, SPEED_MPS = 0.05, 4.0


def odometry(
    ahead_mps: float, right_mps: float = 0.0, frame: int = mavlink.MAV_FRAME_BODY_FRD, quality: int = 90
) -> Any:
    unknown = [math.nan] * 21
    where = 0, mavlink.MAV_FRAME_LOCAL_FRD, frame, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0]
    return mavlink.MAVLink_odometry_message(
        *where, ahead_mps, right_mps, 0.0, 0.0, 0.0, 0.0, unknown, unknown, 0, 0, quality
    )


class Circle:
    """A vehicle in a circle; its autopilot turns its heading away from it, as EKF3 behind a GPS that is spoofed."""

    def __init__(self, autopilot: int, odometry_from: tuple[int, ...] = ()) -> None:
        self.vehicle, self.speaker = Vehicle(odometry_from=odometry_from), Speaker()
        self.autopilot, self.now_ns = autopilot, 0
        for _ in range(2):
            self.now_ns += S
            self.vehicle.handle(self.speaker.heartbeat(autopilot), self.now_ns)

    def drive(self, seconds: float = 20.0, beside: Speaker | None = None, sent: Any = None, raw: bool = True) -> None:
        """beside: sends `sent`, where it is not None; without it the vehicle has wheels."""
        for step in range(round(20 * seconds)):
            self.now_ns += S // 20
            boot_ms, turned_deg = self.now_ns // 1_000_000, math.degrees(RATE_RADPS * step / 20)
            rates = 0.0, 0.0, RATE_RADPS - 0.01 * (self.autopilot == ARDUPILOT)  # a bias that follows GPS
            self._say(mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, *rates))
            if raw:
                turns = 0, 0, round(RATE_RADPS * 1000)
                self._say(mavlink.MAVLink_raw_imu_message(boot_ms * 1000, 0, 0, -1000, *turns, 0, 0, 0))
            if step % 2 == 0:
                heading_deg = (turned_deg - min(8.0, step / 20)) % 360
                at = -270_000_000, 1_530_000_000, 0, 0, 0, 0, 0
                self._say(mavlink.MAVLink_global_position_int_message(boot_ms, *at, round(heading_deg * 100) % 36000))
            if beside is None and step % 4 == 0:
                driven_m = [SPEED_MPS * self.now_ns / 1e9] * 2 + [0.0] * 14
                self._say(mavlink.MAVLink_wheel_distance_message(boot_ms * 1000, 2, driven_m))
            elif beside is not None and sent is not None:
                self.vehicle.handle(beside.say(sent), self.now_ns)

    def _say(self, message: Any) -> None:
        self.vehicle.handle(self.speaker.say(message), self.now_ns)

    @property
    def own(self) -> GyroReading | None:
        return self.vehicle.velocity.without_gps.at(self.now_ns)


def test_wheels_go_by_the_gyros_of_ardupilot_whatever_its_filter_makes_of_them() -> None:
    one = Circle(ARDUPILOT)
    one.drive()
    assert one.own is not None and one.own.gyros is not None
    assert math.degrees(one.own.gyros.compass_rad) == pytest.approx(-8.0, abs=0.5)


@pytest.mark.parametrize(("autopilot", "is_known"), [(ARDUPILOT, False), (PX4, True)])
def test_without_raw_rates_only_px4_has_a_witness(autopilot: int, is_known: bool) -> None:
    """Its bias was seen not to follow a GPS that is spoofed; that of EKF3 was seen to."""
    one = Circle(autopilot)
    one.drive(raw=False)
    assert (one.own is not None) == is_known


@pytest.mark.parametrize("component", [(1, 197), (255, 190)])
def test_odometry_of_another_program_is_a_speed_without_gps(component: tuple[int, int]) -> None:
    one = Circle(PX4, component)
    one.drive(beside=Speaker(*component), sent=odometry(SPEED_MPS))
    assert one.own is not None


@pytest.mark.parametrize(
    ("component", "sent"),
    [
        pytest.param((1, 191), odometry(SPEED_MPS), id="our own"),
        pytest.param((1, 1), odometry(SPEED_MPS), id="the autopilot's"),
        pytest.param((2, 197), odometry(SPEED_MPS), id="of another vehicle"),
        pytest.param((1, 196), odometry(SPEED_MPS), id="of another component"),
        pytest.param((255, 197), odometry(SPEED_MPS), id="of a ground station"),
        pytest.param((1, 197), odometry(math.nan), id="no number"),
        pytest.param((1, 197), odometry(SPEED_MPS, frame=mavlink.MAV_FRAME_LOCAL_NED), id="not of the body"),
        pytest.param((1, 197), odometry(SPEED_MPS, quality=-1), id="failed"),
    ],
)
def test_other_odometry_is_none(component: tuple[int, int], sent: Any) -> None:
    one = Circle(PX4, (1, 197))
    one.drive(beside=Speaker(*component), sent=sent)
    assert one.own is None


def with_gps(seconds: int, wheels: float, lost_s: float = math.inf, **fix: Any) -> Vehicle:
    """To the north with a receiver four times a second, 0.2 s late, and wheels once a second; lost_s: no fix then."""
    vehicle, speaker = Vehicle(), Speaker()
    for now_s in range(1, 3):
        vehicle.handle(speaker.heartbeat(ARDUPILOT), now_s * S)
    at = {
        "fix_type": 3,
        "lon": 1_530_000_000,
        "alt": 0,
        "eph": 80,
        "epv": 0,
        "vel": 0,
        "cog": 0,
        "satellites_visible": 9,
    }
    for step in range(4 * seconds):
        now_ns = 3 * S + step * S // 4
        if step % 4 == 0:
            driven_m = [wheels * SPEED_MPS * step / 4] * 2 + [0.0] * 14
            message = mavlink.MAVLink_wheel_distance_message(now_ns // 1000, 2, driven_m)
            vehicle.handle(speaker.say(message), now_ns)
        lat = round(-270_000_000 + SPEED_MPS * (step / 4 - 0.2) / 0.011057)
        fix |= {"fix_type": 1} if step / 4 >= lost_s else {}
        message = mavlink.MAVLink_gps_raw_int_message(now_ns // 1000, **{**at, "lat": lat, **fix})
        vehicle.handle(speaker.say(message), now_ns + 1000)
    return vehicle


@pytest.mark.parametrize("lost_s", [math.inf, 10.0])
@pytest.mark.parametrize("wheels", [0.92, 1.0, 1.03])
def test_a_receiver_shows_by_what_the_wheels_are_wrong(wheels: float, lost_s: float) -> None:
    """A receiver that has lost its fix stays where it was."""
    scale = with_gps(12, wheels, lost_s).own(15 * S).scale
    assert scale is not None
    assert abs(scale.mean - (1 / wheels - 1)) < scale.sigma < 0.035


@pytest.mark.parametrize("fix", [{"fix_type": 2}, {"eph": 9999}])
def test_one_without_a_good_fix_shows_nothing_of_the_wheels(fix: dict[str, Any]) -> None:
    assert with_gps(20, 1.03, **fix).own(23 * S).scale is None
