"""A vehicle's wheels, learned over its drives: runs of the connection beside a simulated autopilot."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.localization import GpsVerdict
from sim.vehicle.estimator import OdometryErrors
from tests.files_written import wait_for_files
from tests.telemetry.rig import OpenRig, Rig

SHORT = 1 / 1.03 - 1
"""By which share wheels that measure 3 % too much are to be corrected."""


def drive(rig: Rig, seconds: float = 32.0) -> None:
    """From the start of our program to its end."""
    rig.run(seconds)
    wait_for_files()
    rig.crash()
    rig.connect()


@pytest.fixture
def rig(open_rig: OpenRig) -> Rig:
    """Wheels that measure 3 % too much."""
    return open_rig(errors=OdometryErrors(scale=1.03))


def test_two_drives_beside_a_receiver_show_what_the_wheels_are_worth_in_the_next(rig: Rig) -> None:
    """After as little as 3 s, in which that drive alone would not show it to 3 %."""
    drive(rig)
    drive(rig)
    rig.run(6.0)
    scale = rig.connection.vehicle.velocity.shown.scale
    assert scale is not None
    assert scale.mean == pytest.approx(SHORT, abs=0.01)
    assert scale.later < 0.025
    assert rig.connection.status().wheels == f"{100 * scale.mean:+.1f} % +- {100 * scale.later:.1f}"


def test_a_radius_that_was_corrected_by_what_drives_found_is_right(rig: Rig, open_rig: OpenRig) -> None:
    """Nothing is applied twice: neither in the next run, nor where the radius is set while this one runs."""
    drive(rig)
    drive(rig)
    corrected = open_rig(errors=OdometryErrors(scale=1.0))
    corrected.autopilot.handle(mavlink.MAVLink_param_set_message(1, 1, b"WENC_RADIUS", 0.1 / 1.03, 9))
    corrected.run(6.0)
    scale = corrected.connection.vehicle.velocity.shown.learned
    assert scale is not None
    assert scale.mean == pytest.approx(0.0, abs=0.01)
    assert scale.later < 0.025
    corrected.run(26.0)
    corrected.autopilot.handle(mavlink.MAVLink_param_set_message(1, 1, b"WENC_RADIUS", 0.1, 9))
    corrected.run(10.0)
    shown = corrected.connection.vehicle.velocity.shown
    assert shown.learned is not None
    assert shown.learned.mean == pytest.approx(SHORT, abs=0.01)
    assert shown.found is None, "it began anew"


def test_a_drive_whose_gps_is_doubted_teaches_nothing(rig: Rig) -> None:
    for _ in range(2):
        rig.run(1.0)
        rig.judge_gps(GpsVerdict("suspect", (0.0, 9.0), 0.6))
        drive(rig)
    rig.run(6.0)
    assert rig.connection.vehicle.velocity.shown.learned is None


def test_wheels_that_are_not_as_learned_are_noticed(
    rig: Rig, open_rig: OpenRig, caplog: pytest.LogCaptureFixture
) -> None:
    """Then this drive alone counts."""
    drive(rig)
    drive(rig)
    other = open_rig(errors=OdometryErrors(scale=1.2))
    other.run(32.0)
    shown = other.connection.vehicle.velocity.shown
    assert shown.scale is not None
    assert shown.scale.mean == pytest.approx(1 / 1.2 - 1, abs=0.02)
    assert "new tires?" in caplog.text


def test_a_damaged_file_costs_only_what_was_learned(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    drive(rig)
    drive(rig)
    rig.port.with_name("events.wheels").write_bytes(b"damaged\n{}")
    rig.connect()
    rig.run(6.0)
    assert rig.connection.vehicle.velocity.shown.learned is None
    assert "events.wheels: ignored" in caplog.text
