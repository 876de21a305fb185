"""Requests for the way home against an autopilot that answers by the mission protocol."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import east_north_of
from edge.telemetry.codec import MavlinkCodec
from edge_plugins.home import HomeConfig
from edge_plugins.home.home_requests import HomeAnswered
from edge_plugins.home.route import RoutePlan
from tests.plugins.home.home_requests import (
    ACCEPTED,
    DENIED,
    DRIVING_ITSELF,
    FAILED,
    IN_PROGRESS,
    REJECTED,
    accepted,
    acknowledgements,
    asked,
    command,
    finished,
    results,
)
from tests.telemetry.rig import OpenRig, Rig


def test_the_mission_is_uploaded_verified_and_acknowledged(home: Rig) -> None:
    asked(home)
    assert results(home)[0] == IN_PROGRESS
    *_, ack = acknowledgements(home)
    assert (ack.result, ack.result_param2) == (ACCEPTED, len(home.autopilot.mission.items))
    assert (ack.target_system, ack.target_component) == (1, 1)
    waypoints = home.autopilot.mission.waypoints_deg
    vehicle = home.connection.vehicle.position(home.now_ns)
    assert vehicle is not None
    assert waypoints[0] == pytest.approx((vehicle.lat_deg, vehicle.lon_deg), abs=2e-4)
    assert len(waypoints) > 2
    speeds = [item.param2 for item in home.autopilot.mission.items if item.command == 178]
    assert speeds == [2.5]
    (record,) = home.journalled(HomeAnswered)
    assert record.verified
    assert record.text.startswith("uploaded and verified: ")


def test_nothing_else_is_commanded(home: Rig) -> None:
    """No command but requests for messages and streams leaves us: no mode, no arming, no start."""
    asked(home)
    home.run(5.0)
    assert {one.command for one in home.received("COMMAND_LONG")} <= {511, 512}
    kinds = {entry.message.get_type() for entry in home.autopilot.received}
    assert not kinds & {"SET_MODE", "COMMAND_INT", "RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL"}


def test_the_way_home_begins_at_its_first_item(home: Rig) -> None:
    """A real PX4 that had driven a mission of 13 items began the uploaded one at its last."""
    mission = home.autopilot.mission
    mission.items = [
        mavlink.MAVLink_mission_item_int_message(1, 1, number, 3, 16, 0, 1, 0, 0, 0, 0, -274000000, 1530000000, 0)
        for number in range(13)
    ]
    mission.current = 12
    assert asked(home)[-1] == ACCEPTED
    assert len(mission.waypoints_deg) > 2
    assert mission.ahead_deg == mission.waypoints_deg


def test_the_same_way_home_begins_at_its_first_item_again(home: Rig) -> None:
    """PX4 does not look at which item is marked in a mission that it has already."""
    way = RoutePlan("drive 1", ((-27.4772, 153.0283), (-27.4762, 153.0283)), (0.0, 110.0), 50, ())
    home.home.plan = lambda start, places: way
    for number in (1, 2):
        home.autopilot.send(command())
        assert home.run(10.0, accepted(home, number))
        mission = home.autopilot.mission
        assert mission.ahead_deg == mission.waypoints_deg
        mission.current = len(mission.items) - 1  # it has been driven


def test_a_vehicle_that_drives_itself_keeps_its_mission(home: Rig) -> None:
    home.autopilot.base_mode = DRIVING_ITSELF
    home.run(1.5)
    assert asked(home, 2.0) == [REJECTED]
    assert not home.received("MISSION_COUNT")
    home.autopilot.base_mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    home.run(4.0)  # no heartbeat may contradict it
    home.autopilot.send(command())
    assert home.run(10.0, lambda: results(home)[-1] == ACCEPTED)


def test_no_mission_is_uploaded_before_the_mode_is_known(home: Rig) -> None:
    """One heartbeat that says that it does not drive itself may be a stranger's."""
    home.crash()
    home.autopilot.received.clear()
    home.connect()
    assert home.run(4.0, lambda: home.connection.state == "up")
    assert asked(home, 1.0) == [REJECTED]
    assert home.journalled(HomeAnswered)[-1].text == "no way home: the mode is not known yet"


def test_a_vehicle_that_begins_to_drive_itself_ends_the_upload(home: Rig) -> None:
    home.wire.loses = lambda message: message.get_type() == "MISSION_ITEM_INT" and message.seq == 2
    home.autopilot.send(command())
    home.run(0.5)
    home.autopilot.base_mode = DRIVING_ITSELF
    assert home.run(20.0, finished(home))
    assert results(home)[-1] == FAILED
    assert "select Manual" in home.journalled(HomeAnswered)[-1].text
    assert home.autopilot.mission.items == []


@pytest.mark.parametrize(
    ("options", "result", "why"),
    [
        ({"home": HomeConfig()}, DENIED, "[home] enabled is false"),
        ({"home": HomeConfig(enabled=True, turning_radius_m=500.0)}, FAILED, "the vehicle points"),
        ({"home": HomeConfig(enabled=True, max_length_m=20.0)}, FAILED, "max_length_m is 20"),
    ],
)
def test_what_must_not_be_uploaded_is_not(open_home: OpenRig, options: Any, result: int, why: str) -> None:
    rig = open_home(**options)
    rig.autopilot.send(command())
    assert rig.run(2.0, finished(rig))
    assert results(rig) == [result]
    assert why in rig.journalled(HomeAnswered)[-1].text
    assert not rig.received("MISSION_COUNT")


def test_a_position_that_is_lost_is_no_start(home: Rig) -> None:
    home.wire.loses = lambda message: message.get_type() == "GLOBAL_POSITION_INT"
    home.run(3.0)
    assert asked(home, 2.0) == [REJECTED]
    assert home.journalled(HomeAnswered)[-1].text == "no way home: autopilot has no position"


@pytest.mark.parametrize("component_id", [0, 190, 1])
def test_a_broadcast_and_commands_for_others_are_ignored(home: Rig, component_id: int) -> None:
    home.autopilot.send(command(component_id))
    home.run(3.0)
    assert not acknowledgements(home)
    assert not home.received("MISSION_COUNT")


@pytest.mark.parametrize("params", [(0.0, 5665.0), (1.0, 0.0), (1.0, 1.0)])
def test_other_parameters_are_denied(home: Rig, params: tuple[float, float]) -> None:
    """Others use the command as well, with 1 for a spoofed GPS."""
    assert asked(home, 2.0, command(params=params)) == [DENIED]
    assert not home.received("MISSION_COUNT")


def test_a_repeated_command_starts_nothing_twice(home: Rig) -> None:
    home.autopilot.send(command())
    home.run(0.05)
    home.autopilot.send(command(confirmation=1))
    assert home.run(10.0, finished(home))
    home.autopilot.send(command(confirmation=2))
    home.run(3.0)
    assert results(home) == [IN_PROGRESS, IN_PROGRESS, ACCEPTED, ACCEPTED]
    assert len(home.received("MISSION_COUNT")) == 1
    assert len(home.journalled(HomeAnswered)) == 1


def test_a_second_asker_is_told_that_a_mission_is_being_uploaded(home: Rig) -> None:
    home.autopilot.send(command())
    home.run(0.05)
    home.wire.send(MavlinkCodec(255, 190).encode(command()))
    assert home.run(1.0, lambda: results(home)[-1] == REJECTED)
    assert home.journalled(HomeAnswered)[-1].text == "no way home: a mission is being uploaded"
    assert home.run(10.0, lambda: results(home)[-1] == ACCEPTED)


def test_the_pilot_reads_it(home: Rig) -> None:
    asked(home)
    home.run(5.0)
    texts = home.received("STATUSTEXT")
    (warning,) = [one for one in texts if one.severity == mavlink.MAV_SEVERITY_WARNING and "degrees" in one.text]
    assert re.fullmatch(r"Lookback: way home: turn first, \d{2,3} degrees off", warning.text)
    assert re.fullmatch(r"Lookback: way home ready, \d{3} m, \d+ waypoints", texts[-1].text)


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_a_route_of_the_config_is_uploaded_by_its_number(open_home: OpenRig, firmware: str) -> None:
    routes = ("1:end 1:0", "1:130 1:300")
    home = open_home(firmware=firmware, home=HomeConfig(enabled=True, routes=routes, max_start_m=60.0))
    assert asked(home, message=command(route=2.0))[-1] == ACCEPTED
    vehicle, mission = home.position, home.autopilot.mission
    ahead_m = [east_north_of(*at_deg, (vehicle.lat_deg, vehicle.lon_deg)) for at_deg in mission.waypoints_deg]
    assert np.hypot(*np.diff(ahead_m, axis=0).T).sum() == pytest.approx(170.0, abs=10.0)
    assert ahead_m[-1][0] > 100.0, "on, to the east"
    home.run(3.0)
    assert re.fullmatch(r"Lookback: route 2 ready, 1\d\d m, \d+ waypoints", home.received("STATUSTEXT")[-1].text)
    home.autopilot.send(command(route=1.0))
    assert home.run(2.0, lambda: results(home)[-1] == FAILED)
    assert "from where the way begins" in home.journalled(HomeAnswered)[-1].text


@pytest.mark.parametrize("number", [3.0, -1.0, 0.5, float("nan")])
def test_a_route_that_the_config_has_not_is_denied(open_home: OpenRig, number: float) -> None:
    home = open_home(home=HomeConfig(enabled=True, routes=("1:0 1:end", "1:end 1:0")))
    assert asked(home, 2.0, command(route=number)) == [DENIED]
    assert home.journalled(HomeAnswered)[-1].text == f"no route {number:g}: [home] routes has 2"
