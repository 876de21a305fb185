"""From where the vehicle is, back along a drive to its start; and as the items of a MAVLink mission."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north, moved
from edge.reference_map import MapSet
from edge_plugins.home import HomeConfig, checks
from edge_plugins.home.checks import RouteFinding
from edge_plugins.home.drive_line import DriveLine, along, drive_line, nearest_on, simplified
from edge_plugins.home.passes import ROAD_M, TURN_M, are_level, first_row

MIN_LEG_M = 0.5
"""A leg to the first place that is shorter has no direction."""
NAV_WAYPOINT, DO_CHANGE_SPEED = 16, 178  # MAV_CMD
FRAME_GLOBAL, FRAME_MISSION, FRAME_RELATIVE_ALT = 0, 2, 3  # MAV_FRAME
GROUND_SPEED, THROTTLE_UNCHANGED = 1.0, -1.0


@dataclass(frozen=True)
class HomeStart:
    """Where the vehicle is, in degrees. sigma_m: one standard deviation of that; None for a position of the user's.

    route_m: how far it has driven by the odometer of the newest drive; None where that is not known.
    """

    lat_deg: float
    lon_deg: float
    heading_deg: float | None = None
    sigma_m: float | None = None
    route_m: float | None = None


@dataclass(frozen=True)
class WayHome:
    """A way along a drive to its start. positions_deg: of the waypoints, latitude and longitude.

    along_m: of each waypoint, meters along the way; distances in findings are counted alike. places: positions of the
    drive that the waypoints stand for.
    """

    drive: str
    positions_deg: tuple[tuple[float, float], ...]
    along_m: tuple[float, ...]
    places: int
    findings: tuple[RouteFinding, ...]

    @property
    def length_m(self) -> float:
        """Meters from the first waypoint to the last."""
        return self.along_m[-1]

    @property
    def refusals(self) -> list[str]:
        """Why it must not be driven; empty if it may."""
        return [finding.text for finding in self.findings if finding.refuses]

    @property
    def briefs(self) -> list[str]:
        """The warnings in lines that a pilot can read while driving."""
        return [finding.brief for finding in self.findings if not finding.refuses]

    def __str__(self) -> str:
        return f"{self.length_m:.0f} m back along {self.drive}, {len(self.along_m)} waypoints for {self.places} places"


def plan_way_home(
    maps: MapSet, start: HomeStart | None, config: HomeConfig, left_m: float = 0.0, drive: int | None = None
) -> WayHome:
    """The way from `start` along a drive of the maps, the newest by default, to the drive's own start.

    start: None is the end of the drive. left_m: meters to the left of the drive, as seen on the way home, at which the
    vehicle shall drive: another lane.
    MapError where no drive has positions.
    """
    line = drive_line(maps, drive)
    start = start or HomeStart(*_degrees(line, line.points_m[-1]), route_m=float(line.driven_m[-1]))
    here_m = east_north(np.array([start.lat_deg]), np.array([start.lon_deg]), line.origin)[0]  # as the line's points
    row, unsure = first_row(line, here_m, start.sigma_m or 0.0, start.route_m)
    nearest_m = nearest_on(here_m, *line.points_m[[row, row + 1]])
    points_m = np.vstack([nearest_m, line.points_m[row::-1]])
    sigma_m = np.r_[line.sigma_m[row], line.sigma_m[row::-1]]
    if np.hypot(*(points_m[1] - points_m[0])) < MIN_LEG_M and len(points_m) > 2:
        points_m, sigma_m = np.delete(points_m, 1, axis=0), np.delete(sigma_m, 1)
    levels = are_level(line, np.arange(row + 1, row + 1 - len(points_m), -1).clip(0, row), row)
    begin = _joining_row(points_m, levels, left_m, here_m, start.heading_deg, config)
    points_m, sigma_m = points_m[begin:], sigma_m[begin:]
    way_m = along(points_m)
    kept = simplified(points_m, config.tolerance_m)
    waypoints_m = shifted_left(points_m[kept], left_m)
    turn_rad = _turn_rad(start.heading_deg, waypoints_m)
    findings = (
        *checks.pass_check([float(line.along_m[one]) for one in unsure]),
        *checks.start_check(float(np.hypot(*(points_m[0] - here_m))), start.sigma_m, turn_rad, config),
        *checks.length_check(way_m, len(kept), config),
        *checks.short_check(line.short_m, float(way_m[-1]), config, is_named=drive is not None),
        *checks.gap_check(way_m, config),
        *checks.motion_check(line, row + 1, float(way_m[-1])),
        *checks.accuracy_check(way_m, sigma_m, config),
        *checks.turn_check(waypoints_m, way_m[kept], config),
    )
    positions_deg = tuple(_degrees(line, point) for point in waypoints_m)
    return WayHome(line.name, positions_deg, tuple(way_m[kept].tolist()), len(points_m), findings)


def _joining_row(
    points_m: NDArray[np.float64],
    is_level: NDArray[np.bool_],
    left_m: float,
    here_m: NDArray[np.float64],
    heading_deg: float | None,
    config: HomeConfig,
) -> int:
    """The row of a way (N, 2) with which it begins: not in the turn that the vehicle has just made, but behind it.

    The nearest from which the way can be driven as the vehicle points now; 0, the nearest of all, where there is none.
    """
    way_m, away_m = along(points_m), np.hypot(*(shifted_left(points_m, left_m) - here_m).T)
    reach_m = min(max(ROAD_M, 2 * config.turning_radius_m), config.max_start_m)
    found = []
    for row in np.flatnonzero(is_level[:-1] & (way_m[:-1] <= TURN_M) & (away_m[:-1] <= reach_m)):
        ahead_m = points_m[row:][way_m[row:] <= way_m[row] + TURN_M]
        corners_m = shifted_left(ahead_m[simplified(ahead_m, config.tolerance_m)], left_m)
        is_behind = (_turn_rad(heading_deg, corners_m) or 0.0) >= math.pi / 2
        if not is_behind and not any(checks.turn_check(corners_m, along(corners_m), config)):
            found.append(int(row))
    return min(found, key=lambda row: float(away_m[row]), default=0)


def shifted_left(points_m: NDArray[np.float64], left_m: float) -> NDArray[np.float64]:
    """A line of waypoints (N, 2) whose legs are so many meters to the left of another's, as seen along it."""
    ahead = np.diff(points_m, axis=0)
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    before, after = np.vstack([ahead[:1], ahead]), np.vstack([ahead, ahead[-1:]])
    # The corner of the shifted legs lies on the bisector, further out than the legs are apart.
    cosine = np.maximum((1 + (before * after).sum(axis=1)) / 2, 0.25)
    bisector = (before + after) / 2 / cosine[:, None]
    return points_m + left_m * np.column_stack([-bisector[:, 1], bisector[:, 0]])


def _turn_rad(heading_deg: float | None, waypoints_m: NDArray[np.float64]) -> float | None:
    """By how much the vehicle points away from the first leg; None where its heading is not known."""
    if heading_deg is None:
        return None
    east_m, north_m = waypoints_m[1] - waypoints_m[0]
    return abs(math.remainder(math.atan2(east_m, north_m) - math.radians(heading_deg), math.tau))


def _degrees(line: DriveLine, point_m: NDArray[np.float64]) -> tuple[float, float]:
    return moved(*line.origin, float(point_m[0]), float(point_m[1]))


class MissionItem(msgspec.Struct, frozen=True, array_like=True):
    """One item: MAV_CMD, MAV_FRAME, the first four parameters, and a position in degrees and meters.

    None is the autopilot's choice: NaN in MAVLink, null in a file. goes_on: MAVLink's autocontinue, 0 or 1.
    """

    command: int
    frame: int
    params: tuple[float | None, float | None, float | None, float | None]
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    altitude_m: float | None = 0.0
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
    """Pass it without a stop; the heading is the autopilot's choice."""
    return MissionItem(NAV_WAYPOINT, frame, (0.0, 0.0, 0.0, None), *position_deg, altitude_m)
