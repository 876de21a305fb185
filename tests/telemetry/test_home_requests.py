"""Requests for the way home against an autopilot that answers by the mission protocol, on a link that may lose some."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from edge.config import HomeConfig
from edge.journal.records import HomeAnswered
from edge.mission import MissionItem, Start, WayHome, plan_way_home
from edge.reference_map import open_map_set
from edge.telemetry.home_requests import Answer
from edge.telemetry.mission_transfer import MissionTransfer
from tests.telemetry.conftest import START_NS, Rig

OpenRig = Callable[..., Rig]
ENABLED = HomeConfig(enabled=True, speed_mps=2.5)
ACCEPTED, FAILED, IN_PROGRESS = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_FAILED,
    mavlink.MAV_RESULT_IN_PROGRESS,
)
REJECTED, DENIED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED, mavlink.MAV_RESULT_DENIED
OLD = [
    mavlink.MAVLink_mission_item_int_message(1, 1, number, 3, 16, 0, 1, 0, 0, 0, 0, -274000000 + number, 1530000000, 0)
    for number in range(30)
]
DRIVING_ITSELF = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED


def command(
    component_id: int = 191,
    params: tuple[float, float] = (1.0, 5665.0),
    confirmation: int = 0,
    number: int = mavlink.MAV_CMD_USER_5,
) -> Any:
    return mavlink.MAVLink_command_long_message(1, component_id, number, confirmation, *params, 0, 0, 0, 0, 0)


def acknowledgements(rig: Rig) -> list[Any]:
    return [ack for ack in rig.received("COMMAND_ACK") if ack.command == mavlink.MAV_CMD_USER_5]


def results(rig: Rig) -> list[int]:
    return [ack.result for ack in acknowledgements(rig)]


def finished(rig: Rig) -> Callable[[], bool]:
    return lambda: any(result != IN_PROGRESS for result in results(rig))


def stop_at_item(rig: Rig, item: int) -> None:
    """Request the way home on a link that loses one item of the upload, until those before it have arrived."""

    def loses(message: Any) -> bool:
        return message.get_type() == "MISSION_ITEM_INT" and (message.seq, message.get_srcComponent()) == (item, 191)

    rig.wire.loses = loses
    rig.autopilot.send(command())
    rig.run(3.0, lambda: len(rig.received("MISSION_ITEM_INT")) == item)


def kill_in_mid_upload(rig: Rig) -> None:
    """End our side without a word, after some of the items were replaced; then start it again."""
    stop_at_item(rig, 3)
    rig.crash()
    rig.wire.loses = lambda message: False
    rig.connect()


@pytest.fixture
def open_home(open_rig: OpenRig, map_along: Callable[..., Path]) -> OpenRig:
    """A connection whose vehicle drives along the map, with some way behind it and its position known."""
    along_m = np.arange(-40.0, 400.0, 2.0)[:, None]
    bend_m = 10 * np.sin(along_m / 60)
    course = np.array([np.sin(np.radians(60)), np.cos(np.radians(60))])
    maps = open_map_set(map_along(along_m * course + bend_m * [-course[1], course[0]]))

    def open_one(**options: Any) -> Rig:
        config = options.setdefault("home", ENABLED)
        rig = open_rig(**options)

        def plan(start: Start) -> WayHome:
            # The simulated vehicle drives away from home, which is only a warning.
            return plan_way_home(maps, start, config)

        rig.connection.plan_home_by(plan)
        assert rig.run(12.0, lambda: rig.connection.is_ready_for_home and rig.now_ns > START_NS + 9e9)
        return rig

    return open_one


@pytest.fixture(params=["ardupilot", "px4"])
def home(open_home: OpenRig, request: pytest.FixtureRequest) -> Rig:
    return open_home(firmware=request.param)


def test_the_mission_is_uploaded_verified_and_acknowledged(home: Rig) -> None:
    home.autopilot.send(command())
    assert home.run(10.0, finished(home))
    assert results(home)[0] == IN_PROGRESS
    *_, ack = acknowledgements(home)
    assert (ack.result, ack.result_param2) == (ACCEPTED, len(home.autopilot.mission.items))
    assert (ack.target_system, ack.target_component) == (1, 1)
    waypoints = home.autopilot.mission.waypoints_deg
    vehicle = home.connection.position()
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
    home.autopilot.send(command())
    assert home.run(10.0, finished(home))
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
    home.autopilot.send(command())
    assert home.run(10.0, finished(home))
    assert results(home)[-1] == ACCEPTED
    assert len(mission.waypoints_deg) > 2
    assert mission.ahead_deg == mission.waypoints_deg


def test_the_same_way_home_begins_at_its_first_item_again(home: Rig) -> None:
    """PX4 does not look at which item is marked in a mission that it has already."""
    way = WayHome("drive 1", ((-27.4772, 153.0283), (-27.4762, 153.0283)), (0.0, 110.0), 50, ())
    home.connection.plan_home_by(lambda start: way)
    for number in (1, 2):
        home.autopilot.send(command())
        assert home.run(10.0, lambda wanted=number: results(home).count(ACCEPTED) == wanted)
        mission = home.autopilot.mission
        assert mission.ahead_deg == mission.waypoints_deg
        mission.current = len(mission.items) - 1  # it has been driven


def test_a_mission_whose_first_item_is_not_known_to_be_next_is_cleared(home: Rig) -> None:
    home.wire.loses = lambda message: message.get_type() == "MISSION_CURRENT"
    home.autopilot.send(command())
    assert home.run(40.0, finished(home))
    assert results(home)[-1] == FAILED
    assert home.journalled(HomeAnswered)[-1].text == "no way home: the autopilot does not go back to the first item"
    assert home.autopilot.mission.items == []


@pytest.mark.parametrize("lost", [0.05, 0.1, 0.2])
def test_a_link_that_loses_messages_only_delays_it(home: Rig, lost: float) -> None:
    """A share of the messages of the protocol is lost, in both directions."""
    rng = np.random.default_rng(3)
    home.wire.loses = lambda message: message.get_type().startswith("MISSION") and bool(rng.random() < lost)
    home.autopilot.send(command())
    assert home.run(120.0, finished(home))
    assert results(home)[-1] == ACCEPTED
    assert len(home.autopilot.mission.items) == acknowledgements(home)[-1].result_param2


def test_a_lost_last_acknowledgement_is_no_failure(home: Rig) -> None:
    """ArduPilot answers a repeated last item with an error, so the download shows that the mission is there."""
    lost: list[Any] = []

    def loses(message: Any) -> bool:
        is_lost = not lost and message.get_type() == "MISSION_ACK" and message.get_srcComponent() == 1
        lost.extend([message] * is_lost)
        return bool(is_lost)

    home.wire.loses = loses
    home.autopilot.send(command())
    assert home.run(10.0, finished(home))
    assert lost
    assert results(home)[-1] == ACCEPTED


def test_a_lost_last_item_is_sent_again(home: Rig) -> None:
    """Also where its requests are lost, and the autopilot still waits for it when its items are requested."""
    last, lost = -1, 0

    def loses(message: Any) -> bool:
        nonlocal last, lost
        kind = message.get_type()
        if kind == "MISSION_COUNT" and message.get_srcComponent() == 191:
            last = message.count - 1
        if kind == "MISSION_ITEM_INT" and message.seq == last and lost < 2:
            lost += 1
            return True
        return lost == 1 and kind.startswith("MISSION_REQUEST") and kind != "MISSION_REQUEST_LIST"

    home.wire.loses = loses
    home.autopilot.send(command())
    assert home.run(20.0, finished(home))
    assert lost == 2
    assert len(home.received("MISSION_REQUEST_LIST")) == 3, "that of the mission before, and one that was denied"
    assert results(home)[-1] == ACCEPTED


@pytest.mark.parametrize(
    ("sender", "doubt"), [(1, ""), (191, "; look at the autopilot's mission before you start it")], ids=["its", "ours"]
)
def test_a_silent_autopilot_is_given_up(home: Rig, sender: int, doubt: str) -> None:
    """Of no doubt is what it has while we have not begun to change it."""
    home.wire.loses = lambda message: message.get_type() == "MISSION_COUNT" and message.get_srcComponent() == sender
    home.autopilot.send(command())
    assert not home.run(8.0, finished(home)), "1.5 s and five repetitions"
    assert home.run(3.0, finished(home))
    assert results(home)[-1] == FAILED
    assert len(home.received("MISSION_COUNT")) == 0
    assert home.journalled(HomeAnswered)[-1].text == f"no way home: the autopilot does not answer{doubt}"


def test_a_mission_that_stops_halfway_is_cleared(home: Rig) -> None:
    home.wire.loses = lambda message: message.get_type() == "MISSION_ITEM_INT" and message.seq == 3
    home.autopilot.send(command())
    assert home.run(30.0, finished(home))
    assert results(home)[-1] == FAILED
    assert home.autopilot.mission.items == []


def test_a_mission_that_cannot_be_cleared_either_is_reported(home: Rig) -> None:
    home.wire.loses = lambda message: (
        message.get_type() == "MISSION_CLEAR_ALL" or (message.get_type() == "MISSION_ITEM_INT" and message.seq == 3)
    )
    home.autopilot.send(command())
    assert home.run(60.0, finished(home))
    assert results(home)[-1] == FAILED
    assert "do not start the autopilot's mission" in home.journalled(HomeAnswered)[-1].text


def test_an_autopilot_that_requests_for_ever_is_given_up() -> None:
    """It requests the first item again and again, although it gets it."""
    transfer = MissionTransfer([MissionItem(16, 3, (0.0, 0.0, 0.0, 0.0))] * 3, 1, first_is_home=False)
    request, now_s = mavlink.MAVLink_mission_request_int_message(1, 191, 0, 0), 0
    sent = transfer.start(0) + transfer.read(mavlink.MAVLink_mission_count_message(1, 191, 0, 0), 0)
    while transfer.outcome is None and now_s < 300:
        now_s += 1
        sent += transfer.read(request, now_s * 10**9) + transfer.due(now_s * 10**9)
    assert transfer.outcome is not None
    assert transfer.outcome.why.startswith("the upload takes too long; do not start the autopilot's mission")
    assert sent[-1].get_type() == "MISSION_CLEAR_ALL"
    assert 150 < now_s < 180


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


@pytest.fixture
def of_pilot(open_home: OpenRig) -> Rig:
    """An ArduPilot with a mission of the pilot's."""
    rig = open_home()
    rig.autopilot.mission.items = list(OLD)
    return rig


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
    of_pilot.connection.request_home(answers.append, restore=True)
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
        rig.connection.request_home(answers.append, restore=restore)
        assert rig.run(20.0, lambda: answers[-1].is_final)
        assert answers[-1].is_accepted, answers[-1].text
    assert [item.x for item in rig.autopilot.mission.items[1:]] == [item.x for item in OLD[1:]]


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
    home.connection.request_home(answers.append, restore=True)
    assert answers[-1].text == "not restored: no mission is known that was replaced"


@pytest.mark.parametrize("result", [mavlink.MAV_MISSION_INVALID_PARAM5_X, mavlink.MAV_MISSION_NO_SPACE, 99])
def test_a_refused_item_ends_it(home: Rig, result: int) -> None:
    home.autopilot.mission.rejects = {2: result}
    home.autopilot.send(command())
    assert home.run(10.0, finished(home))
    assert results(home)[-1] == FAILED
    assert home.autopilot.mission.items == []
    text = home.journalled(HomeAnswered)[-1].text
    assert text in {
        f"no way home: the autopilot refuses the mission: {name}" for name in ("INVALID_PARAM5_X", "NO_SPACE", "99")
    }


def test_an_item_that_is_stored_otherwise_is_found(home: Rig) -> None:
    def alters(item: Any) -> Any:
        item.x += 5 if item.seq == 3 else 0
        return item

    home.autopilot.mission.alters = alters
    home.autopilot.send(command())
    assert home.run(10.0, finished(home))
    assert results(home)[-1] == FAILED
    assert home.journalled(HomeAnswered)[-1].text == "no way home: item 3 is not the one that was uploaded"
    assert home.autopilot.mission.items == []


def test_what_others_acknowledge_is_not_ours(home: Rig) -> None:
    """An acknowledgement for another component, or of another type of mission."""
    home.autopilot.send(command())
    home.run(0.03)
    for target, kind in ((190, 0), (191, mavlink.MAV_MISSION_TYPE_FENCE)):
        home.autopilot.send(mavlink.MAVLink_mission_ack_message(1, target, mavlink.MAV_MISSION_ERROR, kind))
    assert home.run(10.0, finished(home))
    assert results(home)[-1] == ACCEPTED


def test_a_vehicle_that_drives_itself_keeps_its_mission(home: Rig) -> None:
    home.autopilot.base_mode = DRIVING_ITSELF
    home.run(1.5)
    home.autopilot.send(command())
    assert home.run(2.0, finished(home))
    assert results(home) == [REJECTED]
    assert not home.received("MISSION_COUNT")
    home.autopilot.base_mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    home.run(4.0)  # no heartbeat may contradict it
    home.autopilot.send(command())
    assert home.run(10.0, lambda: results(home)[-1] == ACCEPTED)


def test_a_vehicle_that_begins_to_drive_itself_ends_the_upload(home: Rig) -> None:
    home.wire.loses = lambda message: message.get_type() == "MISSION_ITEM_INT" and message.seq == 2
    home.autopilot.send(command())
    home.run(0.5)
    home.autopilot.base_mode = DRIVING_ITSELF
    assert home.run(20.0, finished(home))
    assert results(home)[-1] == FAILED
    assert "drives by itself" in home.journalled(HomeAnswered)[-1].text
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
    home.autopilot.send(command())
    assert home.run(2.0, finished(home))
    assert results(home) == [REJECTED]
    assert home.journalled(HomeAnswered)[-1].text == "no way home: the vehicle's position is not known"


@pytest.mark.parametrize("component_id", [0, 190, 1])
def test_a_broadcast_and_commands_for_others_are_ignored(home: Rig, component_id: int) -> None:
    home.autopilot.send(command(component_id))
    home.run(3.0)
    assert not acknowledgements(home)
    assert not home.received("MISSION_COUNT")


@pytest.mark.parametrize("params", [(0.0, 5665.0), (1.0, 0.0), (1.0, 1.0)])
def test_other_parameters_are_denied(home: Rig, params: tuple[float, float]) -> None:
    """Others use the command as well, with 1 for a spoofed GPS."""
    home.autopilot.send(command(params=params))
    assert home.run(2.0, finished(home))
    assert results(home) == [DENIED]
    assert not home.received("MISSION_COUNT")


def test_a_script_of_before_is_answered(home: Rig) -> None:
    home.autopilot.send(command(params=(1.0, 0.0), number=mavlink.MAV_CMD_USER_1))
    home.run(2.0)
    (ack,) = [one for one in home.received("COMMAND_ACK") if one.command == mavlink.MAV_CMD_USER_1]
    assert ack.result == mavlink.MAV_RESULT_UNSUPPORTED
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


def test_the_mission_can_be_requested_from_this_computer(home: Rig) -> None:
    answers: list[Answer] = []
    home.connection.request_home(answers.append)
    assert home.run(10.0, lambda: answers[-1].is_final)
    assert [answer.result for answer in answers] == [IN_PROGRESS, ACCEPTED]
    assert answers[-1].items == len(home.autopilot.mission.items)
    home.connection.request_home(answers.append)
    home.connection.request_home(answers.append)
    assert answers[-1].text == "no way home: a mission is being uploaded"
    assert home.run(10.0, lambda: answers[-1].is_accepted)


def test_the_pilot_reads_it(home: Rig) -> None:
    home.autopilot.send(command())
    assert home.run(10.0, finished(home))
    home.run(5.0)
    texts = home.received("STATUSTEXT")
    (warning,) = [one for one in texts if one.severity == mavlink.MAV_SEVERITY_WARNING and "degrees" in one.text]
    assert re.fullmatch(r"Lookback: home is \d{2,3} degrees off, turn first", warning.text)
    assert "Lookback: uploaded and verified: " in "".join(message.text for message in texts)
