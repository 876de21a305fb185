"""The mission that a way home replaced is kept as a file of waypoints, also after a kill."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge_plugins.home.home_requests import HomeAnswered
from tests.plugins.home.home_requests import (
    DRIVING_ITSELF,
    OLD,
    accepted,
    command,
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


def written(rig: Rig) -> list[list[str]]:
    """The lines of the file of waypoints that the newest answer names."""
    named = re.fullmatch(r".*; the mission before it: (\S+)", rig.journalled(HomeAnswered)[-1].text)
    assert named is not None
    header, *rows = Path(named[1]).read_text(encoding="utf-8").splitlines()
    assert header == "QGC WPL 110"
    return [row.split("\t") for row in rows]


def test_after_a_kill_in_mid_upload_the_mixture_is_cleared_and_the_old_mission_named(of_pilot: Rig) -> None:
    kill_in_mid_upload(of_pilot)
    assert len(of_pilot.autopilot.mission.items) > 3, "a mixture"
    assert of_pilot.run(30.0, lambda: of_pilot.autopilot.mission.items == [])
    of_pilot.run(5.0)
    texts = "".join(one.text for one in of_pilot.received("STATUSTEXT"))
    assert "Lookback: upload cut off, do not start the mission" in texts
    text = of_pilot.journalled(HomeAnswered)[-1].text
    assert text.startswith("mission checked: a mission that was cut off is cleared; the mission before it: ")
    assert [round(float(row[8]) * 1e7) for row in written(of_pilot)[1:]] == [item.x for item in OLD[1:]]
    of_pilot.crash()
    of_pilot.connect()
    of_pilot.run(5.0)
    assert "cut off" not in "".join(one.text for one in of_pilot.received("STATUSTEXT")[-2:]), "it is settled"


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_the_pilot_s_mission_is_kept_through_two_uploads(open_home: OpenRig, firmware: str) -> None:
    rig = open_home(firmware=firmware)
    land = mavlink.MAVLink_mission_item_int_message(1, 1, 30, 3, 21, 0, 1, 0, 0, 0, math.nan, 0, 0, math.nan)
    before = [*OLD, land]
    rig.autopilot.mission.items = list(before)
    for times in (1, 2):
        rig.autopilot.send(command())
        assert rig.run(20.0, accepted(rig, times))
    rows = written(rig)
    shown = before[1:] if firmware == "ardupilot" else before  # item 0 of the file is the home position
    assert [round(float(row[8]) * 1e7) for row in rows[1:]] == [item.x for item in shown]
    assert [int(row[3]) for row in rows[-2:]] == [16, 21]
    assert [int(row[0]) for row in rows] == list(range(len(rows)))


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


def test_no_file_is_named_where_nothing_was_replaced(home: Rig) -> None:
    home.autopilot.send(command())
    assert home.run(20.0, accepted(home, 1))
    assert "the mission before it" not in home.journalled(HomeAnswered)[-1].text
