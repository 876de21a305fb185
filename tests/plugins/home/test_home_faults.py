"""Uploads of the way home on a link that loses messages, and to autopilots that refuse or change items."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge_plugins.home.home_requests import HomeAnswered
from edge_plugins.home.mission_transfer import MissionTransfer
from edge_plugins.home.route import MissionItem
from tests.plugins.home.home_requests import (
    ACCEPTED,
    FAILED,
    acknowledgements,
    asked,
    command,
    finished,
    results,
)
from tests.telemetry.rig import Rig


@pytest.mark.parametrize(
    ("lost", "why", "is_cleared"),
    [
        (("MISSION_CURRENT",), "no way home: the autopilot does not go back to the first item", True),
        (("third item",), "no way home: the autopilot refuses the mission: OPERATION_CANCELLED", True),
        (("third item", "MISSION_CLEAR_ALL"), "do not start the autopilot's mission", False),
    ],
)
def test_a_mission_that_stops_halfway_is_cleared_or_said_to_be_there(
    home: Rig, lost: tuple[str, ...], why: str, is_cleared: bool
) -> None:
    def loses(message: Any) -> bool:
        kind = message.get_type()
        return ("third item" if kind == "MISSION_ITEM_INT" and message.seq == 3 else kind) in lost

    home.wire.loses = loses
    assert asked(home, 60.0)[-1] == FAILED
    assert why in home.journalled(HomeAnswered)[-1].text
    assert not (is_cleared and home.autopilot.mission.items)


@pytest.mark.parametrize("lost", [0.05, 0.1, 0.2])
def test_a_link_that_loses_messages_only_delays_it(home: Rig, lost: float) -> None:
    """A share of the messages of the protocol is lost, in both directions."""
    rng = np.random.default_rng(3)
    home.wire.loses = lambda message: message.get_type().startswith("MISSION") and bool(rng.random() < lost)
    assert asked(home, 120.0)[-1] == ACCEPTED
    assert len(home.autopilot.mission.items) == acknowledgements(home)[-1].result_param2


def test_a_lost_last_acknowledgement_is_no_failure(home: Rig) -> None:
    """ArduPilot answers a repeated last item with an error, so the download shows that the mission is there."""
    lost: list[Any] = []

    def loses(message: Any) -> bool:
        is_lost = not lost and message.get_type() == "MISSION_ACK" and message.get_srcComponent() == 1
        lost.extend([message] * is_lost)
        return bool(is_lost)

    home.wire.loses = loses
    assert asked(home)[-1] == ACCEPTED
    assert lost


def test_items_that_come_twice_are_no_failure(home: Rig) -> None:
    """As where their requests were repeated before a slow answer came."""
    twice: list[int] = []

    def loses(message: Any) -> bool:
        if message.get_type() == "MISSION_ITEM_INT" and message.get_srcComponent() == 1 and message.seq not in twice:
            twice.append(message.seq)
            home.autopilot.send(message)
        return False

    home.wire.loses = loses
    asked(home)
    assert len(twice) == len(home.autopilot.mission.items)
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
    asked(home, 20.0)
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


@pytest.mark.parametrize("result", [mavlink.MAV_MISSION_INVALID_PARAM5_X, mavlink.MAV_MISSION_NO_SPACE, 99])
def test_a_refused_item_ends_it(home: Rig, result: int) -> None:
    home.autopilot.mission.rejects = {2: result}
    assert asked(home)[-1] == FAILED
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
    assert asked(home)[-1] == FAILED
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
