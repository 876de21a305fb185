"""The Lua script that acts where Lookback declares GPS faulty."""

from __future__ import annotations

import pytest

from edge.telemetry import encoders
from tests.firmware_config.scripting import Scripting

RTL_OF_COPTER = 6


def opened(action: int, wide: bool = False) -> Scripting:
    """action: LKG_ACTION, which the pilot has set."""
    autopilot = Scripting("lookback_gps.lua", 200, LKG_ACTION=action)
    autopilot.has_long_ids = wide
    return autopilot


def silence(autopilot: Scripting, seconds: int) -> None:
    autopilot.step(5 * seconds)


def hear(
    autopilot: Scripting, doubt: float | None, seconds: int = 1, component_id: int = 191, system_id: int = 1
) -> None:
    """Lookback's values, one a second."""
    for _ in range(seconds):
        for message in encoders.gps_values(doubt, 40.0, 1000):
            autopilot.receive(message, system_id, component_id)
        autopilot.step()


@pytest.mark.parametrize("wide", [False, True])
def test_it_selects_the_second_set_and_the_first_again(wide: bool) -> None:
    autopilot = opened(action=1, wide=wide)
    hear(autopilot, 0.0, 5)
    hear(autopilot, 1.0, 2)
    assert autopilot.sets == []
    hear(autopilot, 1.0, 5)
    assert autopilot.sets == [1]
    hear(autopilot, None, 10)
    hear(autopilot, 0.5, 10)
    assert autopilot.sets == [1], "not known is not agreed"
    hear(autopilot, 0.0, 3)
    assert autopilot.sets == [1, 0]
    assert autopilot.modes == []


@pytest.mark.parametrize(
    ("action", "sets", "modes"), [(0, [], []), (2, [], [RTL_OF_COPTER]), (3, [1], [RTL_OF_COPTER])]
)
def test_the_pilot_chooses_what_it_does(action: int, sets: list[int], modes: list[int]) -> None:
    autopilot = opened(action)
    hear(autopilot, 1.0, 10)
    assert (autopilot.sets, autopilot.modes) == (sets, modes)
    assert any(text.startswith("GPS faulty") for text in autopilot.texts)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize(("system", "component"), [(1, 1), (2, 191), (191, 1)])
def test_values_of_others_are_ignored(wide: bool, system: int, component: int) -> None:
    """Also of the Lookback of another vehicle on the same radio."""
    autopilot = opened(action=3, wide=wide)
    hear(autopilot, 1.0, 10, component, system)
    assert (autopilot.sets, autopilot.modes) == ([], [])


def test_a_lookback_that_falls_silent_is_named_and_changes_nothing() -> None:
    autopilot = opened(action=1)
    silence(autopilot, 60)
    assert autopilot.texts == [], "there is nothing to say without an action"
    hear(autopilot, 1.0, 5)
    silence(autopilot, 50)
    assert autopilot.sets == [1], "GPS was wrong"
    assert autopilot.texts[1:] == ["Lookback is silent, GPS was doubted"] * 2
    hear(autopilot, 0.0, 5)
    assert autopilot.sets == [1, 0], "it is back, and GPS is consistent"


@pytest.mark.parametrize(
    ("by_lookback", "doubt", "accuracy_m", "pilots_set", "sets"),
    [
        (True, None, 0.7, 1, [0]),
        (True, None, 25.0, 1, []),
        (True, 0.6, 0.7, 1, []),
        (True, None, 0.7, 2, []),
        (False, None, 0.7, 1, []),
    ],
    ids=["ended", "a bad GPS", "a doubted GPS", "the pilot's third set", "the pilot's second set"],
)
def test_a_lookback_that_has_ended_leaves_nothing_in_its_set(
    by_lookback: bool, doubt: float | None, accuracy_m: float, pilots_set: int, sets: list[int]
) -> None:
    """Which it selected while GPS was lost: 10 s after its last heartbeat and 10 s after GPS is back."""
    autopilot = opened(action=0)
    autopilot.source_set, autopilot.gps_fix_type = 1, 3
    autopilot.receive(encoders.source_set(1, 2), component_id=191 if by_lookback else 190)
    hear(autopilot, doubt, 5)
    for _ in range(30):
        autopilot.heartbeat()
        autopilot.step(5)
    autopilot.source_set, autopilot.gps_fix_type = pilots_set, 0
    silence(autopilot, 15)
    autopilot.gps_fix_type, autopilot.gps_accuracy_m = 3, accuracy_m
    silence(autopilot, 9)
    assert autopilot.sets == [], "GPS is not back for long"
    silence(autopilot, 2)
    assert autopilot.sets == sets
    assert ("Lookback ended: GPS, source set 1" in autopilot.texts) == bool(sets)
    silence(autopilot, 60)
    assert autopilot.sets == sets, "the pilot may select the second set again"
