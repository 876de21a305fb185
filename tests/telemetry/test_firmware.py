"""Another autopilot is one more row of `FIRMWARES`: telemetry, plug-ins, doctor and simulator follow that."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import Config, TelemetryConfig
from edge.journal.records import PositionMessageChosen
from edge.telemetry.firmware import FIRMWARES, VISION, Firmware, Requirement
from edge_plugins.doctor.autopilot import check_autopilot, check_parameters
from edge_plugins.doctor.findings import DoctorContext
from sim.vehicle import firmware as simulated
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from sim.vehicle.estimator import OdometryErrors
from sim.vehicle.pty_link import open_pty
from tests.plugins.home import conftest
from tests.plugins.home.home_requests import ACCEPTED, command, finished, results
from tests.plugins.motion.test_velocity_sender import see
from tests.telemetry.rig import OpenRig

open_home = conftest.open_home
FIRST_ITEM = mavlink.MAV_CMD_NAV_WAYPOINT
HERON = Firmware(
    "Heron",
    takes=(((2, 1), "external_position"),),
    needs={"external_position": (Requirement("HN_POS", "else it ignores positions", "set it to 4", (4,)),)},
    aid_parameters=("HN_VEL",),
    aid=lambda parameters, heard, source_set: VISION if parameters.get("HN_VEL") else None,
    camera_velocity="ODOMETRY",
    home_is_item_0=True,
    gps_switch="sources",
)
NUMBER = mavlink.MAV_AUTOPILOT_SMACCMPILOT
PARAMETERS = dict.fromkeys(("HN_POS", "HN_VEL"), (1.0, mavlink.MAV_PARAM_TYPE_REAL32))


@pytest.fixture(autouse=True)
def heron(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third autopilot, and its simulation."""
    monkeypatch.setitem(FIRMWARES, NUMBER, HERON)
    row = replace(simulated.ARDUPILOT, name="heron", autopilot=NUMBER, version=(2, 1, 0))
    monkeypatch.setitem(simulated.FIRMWARES, "heron", row)


def test_it_gets_positions_and_the_cameras_velocity(open_rig: OpenRig) -> None:
    errors = OdometryErrors("camera")
    rig = open_rig(emit="auto", motion="send", firmware="heron", errors=errors, gps_fails_s=1006.0)
    rig.autopilot.parameters = PARAMETERS
    see(rig, 12.0)
    assert rig.journalled(PositionMessageChosen)[-1].why == "Heron 2.1 takes external_position"
    assert rig.send_position(rig.fix())
    assert rig.connection.velocity_aid.without_gps == VISION
    assert rig.received("ODOMETRY") and not rig.received("VISION_POSITION_DELTA")
    rig.run(1.0)
    assert rig.autopilot.inputs.resets


def test_it_gets_the_way_home_as_it_numbers_items(open_home: OpenRig) -> None:
    home = open_home(firmware="heron")
    home.autopilot.send(command())
    assert home.run(20.0, finished(home))
    assert results(home)[-1] == ACCEPTED
    assert home.received("MISSION_ITEM_INT")[0].command == FIRST_ITEM  # its own home position, not DO_CHANGE_SPEED


def test_the_doctor_knows_what_it_needs() -> None:
    link, stop = open_pty(), threading.Event()
    autopilot = SimulatedAutopilot(link, straight_line(5.0, 0.0, 0.0), firmware="heron")
    autopilot.parameters = PARAMETERS
    thread = threading.Thread(target=autopilot.run, args=(stop,))
    thread.start()
    telemetry = TelemetryConfig(connection=f"serial:{link.device}:921600", emit="auto")
    examined = DoctorContext(None, Path("/dev"), 10.0, config=Config(telemetry=telemetry))
    found = [*check_autopilot(examined), *check_parameters(examined)]
    stop.set()
    thread.join()
    link.close()
    words = "\n".join(str(one) for one in found)
    assert "Heron 2.1" in words
    assert "velocity without GPS: by a parameter it is vision, but no ODOMETRY is heard" in words
    beats = [one.message for one in autopilot.received if one.message.get_type() == "HEARTBEAT"]
    speakers = {(one.get_srcComponent(), one.type) for one in beats}
    assert speakers == {(mavlink.MAV_COMP_ID_MISSIONPLANNER, mavlink.MAV_TYPE_GCS)}, "no companion to miss"
    assert "HN_POS = 1: else it ignores positions" in words


@pytest.mark.parametrize(
    ("kind", "why"), [(mavlink.MAV_TYPE_GROUND_ROVER, "AHRS_OPTIONS is 0"), (mavlink.MAV_TYPE_HEXAROTOR, "")]
)
def test_a_copter_needs_nothing_that_keeps_its_filter(kind: int, why: str) -> None:
    """It read "positions unused" while its poses were fused."""
    ardupilot, set_up = FIRMWARES[mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA], {"AHRS_EKF_TYPE": 3.0, "AHRS_OPTIONS": 0.0}
    assert ardupilot.unused_because(set_up, "external_position", 1, kind) == why
