"""A vehicle that steers itself by a GPS that is wrong, where no place says where it is."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import VehicleMisled
from tests.plugins.home.home_requests import DRIVING_ITSELF
from tests.telemetry.positions import WRONG, spoofed
from tests.telemetry.rig import OpenRig, Rig

ASKS, STOPS = "Lookback: GPS faulty, no place: stop now", "Lookback: GPS faulty, no place: stopping"


def misled(open_rig: OpenRig, seconds: float, *, kind: int | None = None, base_mode: int = 0, **options: Any) -> Rig:
    """GPS is faulty by the places for so long; options: of the autopilot and of [gates], see `spoofed`."""
    rig = spoofed(open_rig, options.pop("doubted_gps", "report"), **options)
    rig.autopilot.base_mode = base_mode or DRIVING_ITSELF
    if kind is not None:
        rig.connection.vehicle.session.kind = kind
    rig.run(2.0)
    rig.judge_gps(WRONG)
    rig.run(seconds)
    return rig


def texts(rig: Rig) -> list[str]:
    return [one.text for one in rig.received("STATUSTEXT") if "no place" in one.text]


def modes(rig: Rig) -> list[tuple[float, ...]]:
    """The parameters of each DO_SET_MODE."""
    commands = [one for one in rig.received("COMMAND_LONG") if one.command == mavlink.MAV_CMD_DO_SET_MODE]
    return [(one.param1, one.param2, one.param3) for one in commands]


@pytest.mark.parametrize("emit", ["external_position", "report"])
def test_by_default_its_pilot_is_asked_to_stop_it_every_three_seconds(open_rig: OpenRig, emit: str) -> None:
    rig = misled(open_rig, 10.0, emit=emit)
    assert texts(rig) == [ASKS] * 3
    assert rig.journalled(VehicleMisled) == [VehicleMisled("faulty", stopped=False)] * 3
    assert not modes(rig)


@pytest.mark.parametrize(
    ("firmware", "emit", "hold"),
    [("ardupilot", "external_position", (1, 4, 0)), ("px4", "global_position_sensor", (1, 4, 3))],
)
def test_one_on_the_ground_is_stopped_where_that_is_asked_for(
    open_rig: OpenRig, firmware: str, emit: str, hold: tuple[int, ...]
) -> None:
    rig = misled(open_rig, 10.0, firmware=firmware, emit=emit, gates={"misled": "hold"})
    assert modes(rig) == [hold] * 3
    assert texts(rig) == [STOPS] * 3
    assert rig.journalled(VehicleMisled) == [VehicleMisled("faulty", stopped=True)] * 3


@pytest.mark.parametrize("options", [{"kind": mavlink.MAV_TYPE_QUADROTOR}, {"emit": "report"}])
def test_none_is_stopped_that_flies_or_whose_autopilot_gets_no_positions(
    open_rig: OpenRig, options: dict[str, Any]
) -> None:
    rig = misled(open_rig, 10.0, gates={"misled": "hold"}, **options)
    assert not modes(rig)
    assert texts(rig) == [ASKS] * 3


def test_none_is_stopped_that_a_pilot_steers(open_rig: OpenRig) -> None:
    by_hand = misled(open_rig, 10.0, gates={"misled": "hold"}, base_mode=mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    assert not modes(by_hand) and not by_hand.journalled(VehicleMisled)


def test_a_position_keeps_it_going_for_ten_seconds(open_rig: OpenRig) -> None:
    rig = misled(open_rig, 2.0, doubted_gps="switch", gates={"misled": "hold", "risk": 1.0})
    assert rig.send_position(rig.fix())
    rig.run(9.5)
    assert not modes(rig)
    rig.run(4.0)
    assert modes(rig) == [(1, 4, 0)]
