"""What autopilot firmware does with a position, as a table: tried on the firmware itself (see the columns' notes)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import common as mavlink

TakesFix: TypeAlias = Literal["aiding", "dead reckoning", "always"]


@dataclass(frozen=True)
class Firmware:
    """One firmware on one kind of vehicle.

    takes_fix: when MAV_CMD_EXTERNAL_POSITION_ESTIMATE is taken: "aiding" is ArduPilot (an origin, and no GPS or vision
    position for a second), "dead reckoning" not while GPS is used. acknowledges: PX4 1.15 does not. fix_refused: the
    answer when it is not taken. oldest_fix_s: an age beyond it is cut. aids_for_s: how long after the loss of GPS the
    filter goes on; a vehicle with neither wheel encoders, flow nor airspeed stops then, and answers FAILED for ever.
    uses_filter_for_s: after which it flies on something else, and ACCEPTED moves nothing. corrects_lag: fixes are
    stamped by their send time on the boot clock, and half a second late if that is off. takes_fix_as_long: as
    COMMAND_LONG too, in float32 degrees. takes_sensor: GLOBAL_POSITION_SENSOR is fused. takes_vision:
    VISION_POSITION_ESTIMATE is, on the second set of sources. needs_origin: nothing is known of the earth until an
    origin is set or GPS is there. timesync_s: between its own requests.
    """

    name: str
    autopilot: int
    version: tuple[int, int, int]
    takes_fix: TakesFix
    oldest_fix_s: float
    timesync_s: float
    acknowledges: bool = True
    fix_refused: int = mavlink.MAV_RESULT_FAILED
    aids_for_s: float = math.inf
    uses_filter_for_s: float = math.inf
    corrects_lag: bool = False
    takes_fix_as_long: bool = False
    denies_height: bool = False
    takes_sensor: bool = False
    takes_vision: bool = False
    needs_origin: bool = False
    reports_accuracy: bool = False


def _ardupilot(name: str, version: tuple[int, int, int], *, aids_for_s: float, uses_filter_for_s: float) -> Firmware:
    return Firmware(
        name,
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        version,
        "aiding",
        5.0,
        10.0,
        aids_for_s=aids_for_s,
        uses_filter_for_s=uses_filter_for_s,
        corrects_lag=True,
        denies_height=True,
        takes_vision=True,
        needs_origin=True,
    )


def _px4(name: str, version: tuple[int, int, int], takes_fix: TakesFix, **differences: bool) -> Firmware:
    return Firmware(
        name,
        mavlink.MAV_AUTOPILOT_PX4,
        version,
        takes_fix,
        15.0,
        0.1,
        fix_refused=mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
        takes_fix_as_long=True,
        reports_accuracy=True,
        **differences,
    )


FIRMWARES: dict[str, Firmware] = {
    firmware.name: firmware
    for firmware in (
        # With wheel encoders, flow or airspeed the filter goes on as long as anybody tried.
        _ardupilot("ardupilot", (4, 6, 3), aids_for_s=math.inf, uses_filter_for_s=math.inf),
        # A plain rover: stops aiding after 15 s, and falls back to DCM after 7.
        _ardupilot("ardupilot-plain", (4, 6, 3), aids_for_s=15.0, uses_filter_for_s=7.0),
        _px4("px4", (1, 18, 0), "always", takes_sensor=True),
        _px4("px4-1.17", (1, 17, 0), "always"),
        _px4("px4-1.16", (1, 16, 0), "dead reckoning"),
        _px4("px4-1.15", (1, 15, 4), "dead reckoning", acknowledges=False),
    )
}
