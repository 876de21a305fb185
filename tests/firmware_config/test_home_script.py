"""The Lua script that asks for the way home on a switch of the transmitter."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("lupa")

from edge.reference_map import open_map_set
from edge_plugins.home import HomeConfig
from edge_plugins.home.route import plan_route
from tests.firmware_config.scripting import HIGH, LOW, MIDDLE, Scripting
from tests.plugins.home.home_requests import DRIVING_ITSELF
from tests.plugins.home.test_way_home import straight
from tests.telemetry.rig import Rig

HOLD, AUTO = 4, 10
SETTLED = 12
"""Steps after which the position of the switch counts."""


def opened(switch: int | None = LOW, **parameters: float) -> Scripting:
    return Scripting("lookback_home.lua", 100, switch, **parameters)


def start(*, has_long_ids: bool = False, **parameters: Any) -> Scripting:
    """The script, enabled, with Lookback connected and the switch low."""
    scripting = opened(LKH_ENABLE=1, **parameters)
    scripting.has_long_ids = has_long_ids
    scripting.heartbeat()
    scripting.step(SETTLED)
    return scripting


def requested(**parameters: Any) -> Scripting:
    scripting = start(**parameters)
    scripting.switch = HIGH
    scripting.step()
    assert len(scripting.sent) == 1
    return scripting


@pytest.mark.parametrize("has_long_ids", [False, True])
def test_the_switch_requests_the_mission_and_changes_no_mode(has_long_ids: bool) -> None:
    scripting = requested(has_long_ids=has_long_ids)
    command = scripting.sent[0]
    assert (command.command, command.target_system, command.target_component) == (31014, 1, 191)
    assert (command.param1, command.param2, command.param3, command.confirmation) == (1.0, 5665.0, 0.0, 0)
    assert requested(LKH_ROUTE=2).sent[0].param3 == 2.0
    scripting.answer(5)
    scripting.step(20)
    scripting.items = 17
    scripting.answer(0, 17)
    scripting.step(20)
    assert scripting.texts == ["Home: mission requested", "Home: the mission is ready"]
    assert scripting.modes == []


def test_the_mode_is_changed_where_the_parameter_asks_for_it() -> None:
    scripting = requested(LKH_MODE=AUTO)
    scripting.items = 17
    scripting.answer(0, 17)
    scripting.step(49)
    assert scripting.modes == [], "the pilot has the time that was stated"
    assert scripting.texts[-1] == "Home: mode 10 in 5 s, switch low cancels"
    scripting.step(5)
    assert scripting.modes == [AUTO]
    assert scripting.texts[-1] == "Home: on the way"


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("switch", LOW, "Home: the mission is ready, switch is not high"),
        ("armed", False, "Home: the mission is ready, not armed"),
        ("items", 18, "Home: the mission has changed"),
        ("refuses_mode", True, "Home: the mode was refused"),
        ("is_received", False, "Home: the mission is ready, switch is not high"),
        ("mode", HOLD, "Home: the mission is ready, mode has changed"),
        ("failsafe", "battery", "Home: the mission is ready, failsafe"),
        ("failsafe", "ekf", "Home: the mission is ready, failsafe"),
    ],
)
@pytest.mark.parametrize("is_announced", [False, True])
def test_the_mode_stays_where_anything_speaks_against_it(
    name: str, value: object, text: str, is_announced: bool
) -> None:
    """Before the mission is there, and after the change of mode was announced."""
    scripting = requested(LKH_MODE=AUTO)
    scripting.items = 17
    if is_announced:
        scripting.answer(0, 17)
        scripting.step(20)
        setattr(scripting, name, value)
    else:
        setattr(scripting, name, value)
        scripting.step(3)
        scripting.answer(0, 17)
    scripting.step(70)
    assert scripting.modes == []
    assert scripting.texts[-1] == text


@pytest.mark.parametrize(("result", "text"), [(2, "denied"), (3, "unsupported"), (4, "failed"), (9, "result 9")])
def test_a_refusal_ends_it(result: int, text: str) -> None:
    scripting = requested(LKH_MODE=AUTO)
    scripting.answer(result)
    scripting.step(200)
    assert scripting.texts[-1] == f"Home: no mission, {text}"
    assert scripting.modes == []
    assert len(scripting.sent) == 1


@pytest.mark.parametrize("is_cancelled", [False, True])
def test_what_cannot_be_done_now_is_asked_again_until_the_switch_is_low(is_cancelled: bool) -> None:
    """As new commands: a repetition would get the same answer again."""
    scripting = requested()
    for asked in range(1, 6):
        scripting.answer(1)
        scripting.step(31)
        assert [command.confirmation for command in scripting.sent] == [0] * (1 + asked)
        if is_cancelled and asked == 2:
            scripting.switch = LOW
            scripting.step(10)
            break
    scripting.answer(1)
    scripting.step(200)
    assert scripting.texts == ["Home: mission requested", "Home: no mission, not now"]
    assert len(scripting.sent) == (3 if is_cancelled else 6)


def test_a_command_without_an_answer_is_repeated_and_given_up() -> None:
    scripting = requested()
    scripting.step(600)
    assert [command.confirmation for command in scripting.sent] == [0, 1, 2, 3, 4, 5]
    assert scripting.texts[-1] == "Home: no answer from Lookback"


def test_an_upload_that_never_ends_is_given_up() -> None:
    scripting = requested(LKH_MODE=AUTO)
    for _ in range(200):
        scripting.answer(5)
        scripting.step(10)
    assert scripting.texts[-1] == "Home: no answer from Lookback"
    scripting.items = 17
    scripting.answer(0, 17)
    scripting.step(5)
    assert scripting.modes == []


@pytest.mark.parametrize(
    "sender", [{"component_id": 190}, {"system_id": 2}, {"command": 31010}, {"to": 190}, None], ids=str
)
def test_answers_of_others_or_without_a_request_are_ignored(sender: dict[str, int] | None) -> None:
    scripting = start(LKH_MODE=AUTO) if sender is None else requested(LKH_MODE=AUTO)
    scripting.items = 17
    if sender is None:
        scripting.switch = MIDDLE
    scripting.answer(0, 17, **(sender or {}))
    scripting.step(20)
    assert scripting.modes == []
    assert scripting.texts == ["Home: mission requested"] * (sender is not None)


@pytest.mark.parametrize(("at_boot", "is_enabled"), [(LOW, 0), (HIGH, 1)], ids=["not enabled", "high at boot"])
def test_a_switch_that_counts_for_nothing_requests_nothing(at_boot: int, is_enabled: int) -> None:
    scripting = opened(at_boot, LKH_ENABLE=is_enabled)
    scripting.heartbeat()
    scripting.step(SETTLED)
    scripting.switch = HIGH
    scripting.step(50)
    assert scripting.sent == []


def test_a_switch_that_is_high_when_the_receiver_is_back_requests_nothing() -> None:
    """Low, lost, high when it is back: ArduPilot says low for a while longer, then high."""
    scripting = start(LKH_MODE=AUTO)
    scripting.is_received, scripting.switch = False, HIGH
    scripting.step(30)
    scripting.is_received = True
    scripting.heartbeat()
    scripting.step(30)
    assert scripting.sent == []
    scripting.switch = LOW
    scripting.step(5)
    scripting.switch = HIGH
    scripting.step(5)
    assert len(scripting.sent) == 1, "the pilot has moved it"


def test_a_lookback_that_is_not_heard_is_not_asked() -> None:
    scripting = start()
    scripting.step(100)
    scripting.switch = HIGH
    scripting.step(5)
    assert scripting.sent == []
    assert scripting.texts == ["Home: Lookback is not connected"]


def test_the_script_and_lookback_understand_each_other(tmp_path: Path, map_along: Callable[..., Path]) -> None:
    """The real script, the real connection and the simulated autopilot: from the switch to the mode.

    A mode must hold for 2.5 s: a request right after one in which the vehicle drove itself is refused, and repeated.
    """
    rig = Rig(tmp_path, home=HomeConfig(enabled=True))
    maps = open_map_set(map_along(straight(400.0, 60.0)))
    rig.home.plan = lambda start, places: plan_route(maps, start, HomeConfig())
    scripting = opened(LKH_ENABLE=1, LKH_MODE=AUTO)
    read = 0

    def pump(seconds: float) -> None:
        nonlocal read
        for _ in range(round(seconds * 10)):
            rig.run(0.1)
            scripting.items = len(rig.autopilot.mission.items)
            for entry in rig.autopilot.received[read:]:
                scripting.receive(entry.message)
            read = len(rig.autopilot.received)
            scripting.step()
            while scripting.sent:
                rig.autopilot.send(scripting.sent.pop())

    manual, rig.autopilot.base_mode = rig.autopilot.base_mode, DRIVING_ITSELF
    pump(12.0)
    rig.autopilot.base_mode = manual
    pump(1.5)
    scripting.switch = HIGH
    pump(0.5)
    pump(15.0)
    rig.close()
    announced = "Home: mode 10 in 5 s, switch low cancels"
    assert scripting.texts == ["Home: mission requested", announced, "Home: on the way"]
    assert scripting.modes == [AUTO]
    assert len(rig.autopilot.mission.waypoints_deg) == 2
