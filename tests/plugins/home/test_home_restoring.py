"""The mission that a way home replaced is kept, and given back after a kill or on request."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge_plugins.home.home_requests import Answer, HomeAnswered
from tests.plugins.home.home_requests import (
    DRIVING_ITSELF,
    OLD,
    stop_at_item,
)
from tests.telemetry.rig import OpenRig, Rig


def kill_in_mid_upload(rig: Rig) -> None:
    """End our side without a word, after some of the items were replaced; then start it again."""
    stop_at_item(rig, 3)
    rig.crash()
    rig.wire.loses = None
    rig.connect()


@pytest.fixture
def of_pilot(open_home: OpenRig) -> Rig:
    """An ArduPilot with a mission of the pilot's."""
    rig = open_home()
    rig.autopilot.mission.items = list(OLD)
    return rig


@pytest.mark.parametrize(("firmware", "left"), [("ardupilot", 0), ("px4", 30)])
def test_a_daemon_that_ends_in_mid_upload_leaves_no_mixture(open_home: OpenRig, firmware: str, left: int) -> None:
    """ArduPilot has replaced some of the 30 old items by then; PX4 has still all of them."""
    rig = open_home(firmware=firmware)
    rig.autopilot.mission.items = list(OLD)
    stop_at_item(rig, 3)
    rig.connection.close()
    rig.autopilot.step()
    assert rig.autopilot.mission.items == OLD[:left]
    assert rig.journalled(HomeAnswered)[-1].text == "no way home: Lookback ended"


def test_after_a_kill_in_mid_upload_the_mixture_is_cleared_and_the_old_mission_given_back(of_pilot: Rig) -> None:
    kill_in_mid_upload(of_pilot)
    assert len(of_pilot.autopilot.mission.items) > 3, "a mixture"
    assert of_pilot.run(30.0, lambda: of_pilot.autopilot.mission.items == [])
    of_pilot.run(5.0)
    texts = "".join(one.text for one in of_pilot.received("STATUSTEXT"))
    assert "Lookback: upload cut off, do not start the mission" in texts
    assert of_pilot.journalled(HomeAnswered)[-1].text == (
        "mission checked: a mission that was cut off is cleared; `lookback home --restore` uploads the one before"
    )
    answers: list[Answer] = []
    of_pilot.home.ask(answers.append, restore=True)
    assert of_pilot.run(20.0, lambda: answers[-1].is_final)
    assert answers[-1].text == "restored and verified: the mission that was replaced, 30 items"
    assert [item.x for item in of_pilot.autopilot.mission.items[1:]] == [item.x for item in OLD[1:]]
    of_pilot.crash()
    of_pilot.connect()
    of_pilot.run(5.0)
    assert "cut off" not in "".join(one.text for one in of_pilot.received("STATUSTEXT")[-2:]), "it is settled"


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_the_pilot_s_mission_is_given_back_after_two_uploads(open_home: OpenRig, firmware: str) -> None:
    rig = open_home(firmware=firmware)
    rig.autopilot.mission.items = list(OLD)
    answers: list[Answer] = []
    for restore in (False, False, True):
        rig.home.ask(answers.append, restore=restore)
        assert rig.run(20.0, lambda: answers[-1].is_final)
        assert answers[-1].is_accepted, answers[-1].text
    assert [item.x for item in rig.autopilot.mission.items[1:]] == [item.x for item in OLD[1:]]


def test_an_item_whose_altitude_is_the_autopilot_s_choice_is_given_back_after_a_restart(of_pilot: Rig) -> None:
    land = mavlink.MAVLink_mission_item_int_message(1, 1, 30, 3, 21, 0, 1, 0, 0, 0, math.nan, 0, 0, math.nan)
    of_pilot.autopilot.mission.items = [*OLD, land]
    answers: list[Answer] = []
    for restore in (False, True):
        of_pilot.home.ask(answers.append, restore=restore)
        assert of_pilot.run(20.0, lambda: answers[-1].is_final)
        assert answers[-1].is_accepted, answers[-1].text
        of_pilot.crash()
        of_pilot.connect()
        of_pilot.run(5.0)
    assert math.isnan(of_pilot.autopilot.mission.items[-1].z)


def test_a_mission_that_the_pilot_wrote_after_the_kill_stays(of_pilot: Rig) -> None:
    kill_in_mid_upload(of_pilot)
    other = [mavlink.MAVLink_mission_item_int_message(1, 1, n, 3, 16, 0, 1, 0, 0, 0, 0, 5 * n, 7, 0) for n in range(4)]
    of_pilot.run(10.0)  # the upload has timed out
    of_pilot.crash()
    of_pilot.connect()
    of_pilot.autopilot.mission.items = list(other)
    of_pilot.run(20.0)
    assert of_pilot.autopilot.mission.items == other


def test_a_mixture_is_not_cleared_while_the_vehicle_drives_itself(of_pilot: Rig) -> None:
    before = of_pilot.autopilot.base_mode
    kill_in_mid_upload(of_pilot)
    of_pilot.autopilot.base_mode = DRIVING_ITSELF
    mixture = list(of_pilot.autopilot.mission.items)
    of_pilot.run(20.0)
    assert of_pilot.autopilot.mission.items == mixture
    of_pilot.autopilot.base_mode = before
    assert of_pilot.run(30.0, lambda: of_pilot.autopilot.mission.items == [])


def test_nothing_is_restored_where_nothing_was_replaced(home: Rig) -> None:
    answers: list[Answer] = []
    home.home.ask(answers.append, restore=True)
    assert answers[-1].text == "not restored: no mission is known that was replaced"
