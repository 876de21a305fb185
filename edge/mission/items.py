"""A way home as the items of a MAVLink mission, numbered as each firmware does."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edge.mission.way_home import WayHome

NAV_WAYPOINT, DO_CHANGE_SPEED = 16, 178  # MAV_CMD
FRAME_GLOBAL, FRAME_MISSION, FRAME_RELATIVE_ALT = 0, 2, 3  # MAV_FRAME
GROUND_SPEED, THROTTLE_UNCHANGED = 1.0, -1.0


@dataclass(frozen=True)
class MissionItem:
    """One item: MAV_CMD, MAV_FRAME, the first four parameters, and a position in degrees and meters.

    goes_on: MAVLink's autocontinue, 0 or 1.
    """

    command: int
    frame: int
    params: tuple[float, float, float, float]
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    altitude_m: float = 0.0
    goes_on: int = 1


def mission_items(
    way: WayHome, *, speed_mps: float = 0.0, altitude_m: float = 0.0, home_first: bool = True
) -> list[MissionItem]:
    """The items of a way home.

    speed_mps: 0 leaves the autopilot's own. altitude_m: above the autopilot's home. home_first: ArduPilot (and QGC WPL)
    number the home position as item 0, and ignore what is uploaded for it; PX4 begins with the first item.
    """
    items = []
    if home_first:
        items.append(_waypoint(way.positions_deg[-1], 0.0, FRAME_GLOBAL))
    if speed_mps:
        items.append(MissionItem(DO_CHANGE_SPEED, FRAME_MISSION, (GROUND_SPEED, speed_mps, THROTTLE_UNCHANGED, 0.0)))
    return [*items, *(_waypoint(position, altitude_m) for position in way.positions_deg)]


def _waypoint(position_deg: tuple[float, float], altitude_m: float, frame: int = FRAME_RELATIVE_ALT) -> MissionItem:
    """Pass it without a stop; the heading is the autopilot's choice (NaN)."""
    return MissionItem(NAV_WAYPOINT, frame, (0.0, 0.0, 0.0, math.nan), *position_deg, altitude_m)
