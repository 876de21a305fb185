"""What is found of an autopilot's velocity that nothing measures, by lines, halts, and what a vehicle can do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge.localization.velocity_error import VelocityError

S = 10**9


class Unaided:
    """A vehicle at 8 m/s whose reported velocity grows by `grows_mps2` the way it heads; it uses a frame each 2 m."""

    def __init__(self, grows_mps2: float = 0.15) -> None:
        self.error, self.grows_mps2 = VelocityError(length=40), grows_mps2
        self.time_s = self.along_m = self.wrong_mps = self.wrong_east_mps = 0.0

    def drive(self, seconds: float, *, heading_deg: float = 0.0, believed: bool = True, drive: object = 1) -> None:
        """Along a drive of the map."""
        heading_rad = math.radians(heading_deg)
        sin, cos = math.sin(heading_rad), math.cos(heading_rad)
        for _ in range(round(seconds * 4)):
            self.time_s += 0.25
            self.wrong_mps += 0.25 * self.grows_mps2 * cos
            self.wrong_east_mps += 0.25 * self.grows_mps2 * sin
            self.along_m += 0.25 * 8.0
            reported_mps = 8.0 * sin + self.wrong_east_mps, 8.0 * cos + self.wrong_mps
            self.error.predict(round(self.time_s * S), heading_rad, reported_mps)
            self.error.add_frame(round(self.time_s * S))
            if believed:
                self.error.use_line(drive, self.along_m - 19.5 * 2.0, 78.0)

    def brake(self) -> None:
        """From 8 m/s, at 4 m/s^2."""
        for speed_mps in np.arange(7.0, 0.0, -1.0):
            self.time_s += 0.25
            self.wrong_mps += 0.25 * self.grows_mps2
            self.error.predict(round(self.time_s * S), 0.0, (0.0, speed_mps + self.wrong_mps))

    def stand(self, seconds: float, *, is_noticed: bool = True) -> None:
        for _ in range(round(seconds * 4)):
            self.time_s += 0.25
            self.wrong_mps += 0.25 * self.grows_mps2
            self.error.predict(round(self.time_s * S), 0.0, (0.0, self.wrong_mps))
            if is_noticed:
                self.error.use_halt(round(self.time_s * S), (0.0, self.wrong_mps))

    @property
    def off_mps(self) -> float:
        return self.error.error_mps[1] - self.wrong_mps


def test_lines_say_what_a_velocity_is_wrong_by() -> None:
    vehicle = Unaided()
    vehicle.drive(30.0)
    assert vehicle.wrong_mps == pytest.approx(4.5)
    assert abs(vehicle.off_mps) < 0.7
    vehicle.drive(60.0)
    assert abs(vehicle.off_mps) < 0.2


def test_without_lines_it_is_ever_less_certain() -> None:
    vehicle = Unaided()
    vehicle.drive(30.0, believed=False)
    assert 0.0 < vehicle.error.error_mps[1] < vehicle.wrong_mps, "the vehicle may also have accelerated"
    assert abs(vehicle.off_mps) < vehicle.error.sigma_mps
    assert vehicle.error.sigma_mps > 3.5


def test_once_it_is_known_it_goes_on_without_lines_for_a_while() -> None:
    vehicle = Unaided()
    vehicle.drive(60.0)
    vehicle.drive(20.0, believed=False)
    assert abs(vehicle.off_mps) < min(1.0, 2 * vehicle.error.sigma_mps)


def test_what_a_line_from_before_a_turn_says_is_of_the_way_that_it_headed_then() -> None:
    vehicle, off_mps = Unaided(grows_mps2=0.3), []
    vehicle.drive(20.0, believed=False)
    for _ in range(60):
        vehicle.drive(0.25, heading_deg=90.0)
        off_mps.append(abs(vehicle.error.error_mps[0] - vehicle.wrong_east_mps))
    assert vehicle.off_mps == pytest.approx(0.0, abs=0.1)
    assert max(off_mps) < 1.5


def test_a_halt_says_all_of_it_but_two_frames_that_are_alike_do_not() -> None:
    vehicle, unnoticed = Unaided(), Unaided()
    for one in (vehicle, unnoticed):
        one.drive(15.0, believed=False)
        one.brake()
        assert abs(one.off_mps) < 2 * one.error.sigma_mps, "braking is not all error"
    vehicle.stand(0.5)
    unnoticed.stand(0.5, is_noticed=False)
    assert vehicle.error.error_mps == unnoticed.error.error_mps
    assert vehicle.error.sigma_mps == unnoticed.error.sigma_mps
    vehicle.stand(3.0)
    assert vehicle.error.sigma_mps < 0.2
    assert abs(vehicle.off_mps) < 0.2


def test_what_the_velocity_is_to_the_left_is_error() -> None:
    """It drives north, and its filter goes ever faster to the northwest."""
    error = VelocityError(length=40)
    for quarter in range(240):
        wrong_mps = 0.1 * quarter / 4
        error.predict(quarter * S // 4, 0.0, (-wrong_mps, 8.0 + wrong_mps))
    east_mps, north_mps = error.error_mps
    assert east_mps == pytest.approx(-6.0, abs=0.3)
    assert 0.0 < north_mps < 6.0, "the vehicle may also have accelerated"
    assert error.sigma_mps > 6.0, "what it is ahead, only lines can say"


@pytest.mark.parametrize("pulled_m", [0.0, 20.0])
def test_a_jump_of_the_velocity_is_error_where_a_position_of_ours_was_sent(pulled_m: float) -> None:
    """2 m/s within half a second, as recorded after a position that was 9 to 32 m from the autopilot's own."""
    error = VelocityError(length=40)
    velocity_mps = [8.0] * 40 + [9.0, 10.0, 10.0, 10.0]
    for quarter, north_mps in enumerate(velocity_mps):
        is_pulled = quarter >= 40 and pulled_m > 0
        error.predict(quarter * S // 4, 0.0, (0.0, north_mps), pulled_m if is_pulled else 0.0)
    assert error.error_mps[1] == pytest.approx(1.8 if pulled_m else 0.8, abs=0.2)
    assert abs(error.error_mps[1] - 2.0) < 2 * error.sigma_mps, "whose it is remains uncertain without one"


def test_a_pull_neither_stalls_it_nor_is_a_line_that_spans_the_pull_believed() -> None:
    """As recorded: 13 m/s within half a second after a position that was 160 m off; true at 8 m/s all the time."""
    error, along_m, odometer_m, due_m = VelocityError(length=40), 0.0, 0.0, 0.0
    found, used = [], 0
    for tenth in range(1200):
        wrong_mps = min(0.01 * tenth, 10.0) if tenth < 1000 else 10.0 - min(2.6 * (tenth - 999), 13.0)
        error.predict(tenth * S // 10, 0.0, (0.0, 8.0 + wrong_mps), 160.0 if 1000 <= tenth < 1010 else 0.0)
        along_m += 0.8
        odometer_m += 0.1 * max(0.0, 8.0 + wrong_mps - error.error_mps[1])
        if odometer_m >= due_m:
            due_m = odometer_m + 2.0
            error.add_frame(tenth * S // 10)
            error.use_line(1, along_m - 19.5 * 2.4, 39 * 2.4)
            used += tenth > 1000
        if tenth > 1000:
            found.append((error.error_mps[1] - wrong_mps, error.sigma_mps))
    off_mps, sigma_mps = np.abs(np.array(found)).T
    assert used > 60, "of 160 m"
    assert (off_mps < 2 * sigma_mps).all()
    assert off_mps.max() < 2.0


def test_a_vehicle_that_accelerates_gives_its_velocity_no_error_that_counts() -> None:
    """From 8 to 14 m/s within 4 s, while positions that were alike its own were sent."""
    error = VelocityError(length=40)
    for quarter in range(80):
        north_mps = 8.0 + min(max(quarter - 40, 0) * 0.375, 6.0)
        error.predict(quarter * S // 4, 0.0, (0.0, north_mps), 1.0)
    assert abs(error.error_mps[1]) < error.sigma_mps


def test_a_line_on_another_drive_is_no_jump_of_the_odometer() -> None:
    vehicle = Unaided(grows_mps2=0.0)
    vehicle.drive(40.0)
    vehicle.along_m += 500.0
    vehicle.drive(10.0, drive=2)
    assert abs(vehicle.off_mps) < 0.3
    vehicle.along_m -= 70.0
    vehicle.drive(10.0, drive=2)
    assert abs(vehicle.off_mps) < 0.3, "nor is one far away on the same"


def test_while_something_measures_the_velocity_nothing_is_wrong_with_it() -> None:
    vehicle = Unaided()
    vehicle.drive(60.0)
    vehicle.error.begin()
    assert vehicle.error.error_mps == (0.0, 0.0)
    assert vehicle.error.sigma_mps == pytest.approx(0.1)
