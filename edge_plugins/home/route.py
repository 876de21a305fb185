"""From where the vehicle is along drives of a map, home by default; and that as items of a MAVLink mission."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import RigConfig
from edge.geodesy import Origin, east_north, moved
from edge.reference_map import MapSet
from edge_plugins.home import HomeConfig, checks
from edge_plugins.home.checks import RouteFinding
from edge_plugins.home.drive_line import along, drive_line, nearest_on, simplified
from edge_plugins.home.passes import ROAD_M, TURN_M, are_level, first_row
from edge_plugins.home.route_search import Stretch, find_stretches

MIN_LEG_M = 0.5
"""A leg to the first place that is shorter has no direction."""
NAV_WAYPOINT, DO_CHANGE_SPEED = 16, 178  # MAV_CMD
FRAME_GLOBAL, FRAME_MISSION, FRAME_RELATIVE_ALT = 0, 2, 3  # MAV_FRAME
GROUND_SPEED, THROTTLE_UNCHANGED = 1.0, -1.0


@dataclass(frozen=True)
class RouteStart:
    """Where the vehicle is, in degrees. sigma_m: one standard deviation of that; None for a position of the user's.

    route_m: how far it has driven by the odometer of the newest drive; None where that is not known.
    """

    lat_deg: float
    lon_deg: float
    heading_deg: float | None = None
    sigma_m: float | None = None
    route_m: float | None = None


@dataclass(frozen=True)
class RoutePlan:
    """A way along drives. positions_deg: of the waypoints, latitude and longitude. words: along which drives.

    along_m: of each waypoint, meters along the way; distances in findings are counted alike. places: positions of the
    drives that the waypoints stand for.
    """

    words: str
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

    def briefs(self, *, refuses: bool) -> list[str]:
        """The same, or the warnings, in words that a pilot can read while driving."""
        return [finding.brief for finding in self.findings if finding.refuses == refuses]

    def __str__(self) -> str:
        return f"{self.length_m:.0f} m {self.words}, {len(self.along_m)} waypoints for {self.places} places"


@dataclass(frozen=True)
class _Rows:
    """Positions of a way, each as a row: points_m (N, 2) east and north, all others (N,). left_m: of its lane.

    alt_m, sigma_m: as those of a drive. stretch, row: which row of which stretch it is.
    """

    points_m: NDArray[np.float64]
    alt_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    left_m: NDArray[np.float64]
    stretch: NDArray[np.int64]
    row: NDArray[np.int64]

    def __getitem__(self, rows: slice | NDArray[np.int64]) -> _Rows:
        return _Rows(*(column[rows] for column in vars(self).values()))


def plan_route(
    maps: MapSet,
    start: RouteStart | None,
    config: HomeConfig,
    rig: RigConfig = RigConfig(),  # noqa: B008  # frozen
    *,
    places: Sequence[str] = (),
    drive: int | None = None,
) -> RoutePlan:
    """A way along drives of the maps, through `places` (see `route_search`); without any, home.

    Home is back along one drive, the newest by default, to its start, from where the vehicle is; else the vehicle is at
    the first place. start: None is the end of the drive, or that place. rig: where the vehicle's lane is.
    MapError where no drive has positions, or none lead on; ConfigError for a place that is none.
    """
    stretches, short_m, begin, unsure_m = find_stretches(maps, places, config.max_start_m), 0.0, 0, list[float]()
    if not places:
        line = drive_line(maps, drive)
        stretches, short_m = [Stretch(line, np.arange(len(line.along_m))[::-1])], line.short_m
        start = start or RouteStart(*_degrees(line.origin, line.points_m[-1]), route_m=float(line.driven_m[-1]))
    origin, way = stretches[0].line.origin, _joined(stretches, rig)
    start = start or RouteStart(*_degrees(origin, way.points_m[0]))
    here_m = east_north(np.array([start.lat_deg]), np.array([start.lon_deg]), origin)[0]  # as the points
    if not places:
        row, unsure = first_row(line, here_m, start.sigma_m or 0.0, start.route_m)
        begin, unsure_m = len(line.along_m) - 2 - row, line.along_m[unsure].tolist()
    way = _begun(way, begin, here_m, start.heading_deg, config)
    way_m = along(way.points_m)
    kept = simplified(way.points_m, config.tolerance_m)
    waypoints_m = shifted_left(way.points_m[kept], way.left_m[kept])
    turn_rad = _turn_rad(start.heading_deg, waypoints_m)
    findings = (
        *checks.pass_check(unsure_m),
        *checks.start_check(float(np.hypot(*(way.points_m[0] - here_m))), start.sigma_m, turn_rad, config),
        *checks.length_check(way_m, len(kept), config),
        *checks.short_check(short_m, float(way_m[-1]), config, is_named=drive is not None),
        *checks.gap_check(way_m, config),
        *checks.motion_check([one.line for one in stretches], way.stretch, way.row, way_m),
        *checks.accuracy_check(way_m, way.sigma_m, config),
        *checks.turn_check(waypoints_m, way_m[kept], config),
        *checks.change_check(way.stretch, way_m, [one.line.name for one in stretches]),
    )
    positions_deg = tuple(_degrees(origin, point) for point in waypoints_m)
    words = [f"{'back ' * one.is_back}along {one.line.name}" for one in stretches]
    along_words = " and ".join(word for word, _ in groupby(words))
    return RoutePlan(along_words, positions_deg, tuple(way_m[kept].tolist()), len(way_m), findings)


def _joined(stretches: Sequence[Stretch], rig: RigConfig) -> _Rows:
    """All stretches as one line. Where two meet, each ends as far before, or begins behind, as they are apart."""
    columns = []
    for number, one in enumerate(stretches):
        line, rows = one.line, one.rows
        left_m = rig.left_m("reverse" if one.is_back else "forward")
        same = np.full(len(rows), left_m), np.full(len(rows), number), rows
        columns.append(_Rows(line.points_m[rows], line.alt_m[rows], line.sigma_m[rows], *same))
    for number, (before, after) in enumerate(pairwise(columns)):
        apart_m = np.hypot(*(after.points_m[0] - before.points_m[-1]))
        left_m = along(before.points_m)[-1] - along(before.points_m)
        columns[number] = before[np.flatnonzero((left_m >= apart_m) | (left_m == left_m[0]))]
        done_m = along(after.points_m)
        columns[number + 1] = after[np.flatnonzero((done_m >= apart_m) | (done_m == done_m[-1]))]
    return _Rows(*(np.concatenate(parts) for parts in zip(*(vars(one).values() for one in columns), strict=True)))


def _begun(way: _Rows, begin: int, here_m: NDArray[np.float64], heading_deg: float | None, config: HomeConfig) -> _Rows:
    """A way from beside the vehicle on: not from the turn that it has just made, but from behind it.

    That is the nearest row from which the way can be driven as the vehicle points now, if there is one.
    """
    nearest_m = nearest_on(here_m, *way.points_m[begin : begin + 2])
    is_near = np.hypot(*(way.points_m[begin + 1] - nearest_m)) < MIN_LEG_M and begin + 2 < len(way.points_m)
    way = way[np.r_[begin + 1, begin + 1 + is_near : len(way.points_m)]]
    way.points_m[0] = nearest_m
    way_m, away_m = along(way.points_m), np.hypot(*(shifted_left(way.points_m, way.left_m) - here_m).T)
    reach_m = min(max(ROAD_M, 2 * config.turning_radius_m), config.max_start_m)
    is_level = are_level(way.alt_m - way.alt_m[0], way_m)
    found = []
    for row in np.flatnonzero((is_level & (way_m <= TURN_M) & (away_m <= reach_m))[:-1]).tolist():
        ahead = way[row:][way_m[row:] <= way_m[row] + TURN_M]
        ahead = ahead[simplified(ahead.points_m, config.tolerance_m)]
        corners_m = shifted_left(ahead.points_m, ahead.left_m)
        is_behind = (_turn_rad(heading_deg, corners_m) or 0.0) >= math.pi / 2
        if not is_behind and not any(checks.turn_check(corners_m, along(corners_m), config)):
            found.append(row)
    return way[min(found, key=lambda row: float(away_m[row]), default=0) :]


def shifted_left(points_m: NDArray[np.float64], left_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """A line of waypoints (N, 2) whose legs are so many meters (N,) to the left of another's, as seen along it."""
    ahead = np.diff(points_m, axis=0)
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    before, after = np.vstack([ahead[:1], ahead]), np.vstack([ahead, ahead[-1:]])
    # The corner of the shifted legs lies on the bisector, further out than the legs are apart.
    cosine = np.maximum((1 + (before * after).sum(axis=1)) / 2, 0.25)
    bisector = (before + after) / 2 / cosine[:, None]
    shifted: NDArray[np.float64] = points_m + left_m[:, None] * np.column_stack([-bisector[:, 1], bisector[:, 0]])
    return shifted


def _turn_rad(heading_deg: float | None, waypoints_m: NDArray[np.float64]) -> float | None:
    """By how much the vehicle points away from the first leg; None where its heading is not known."""
    if heading_deg is None:
        return None
    east_m, north_m = waypoints_m[1] - waypoints_m[0]
    return abs(math.remainder(math.atan2(east_m, north_m) - math.radians(heading_deg), math.tau))


def _degrees(origin: Origin, point_m: NDArray[np.float64]) -> tuple[float, float]:
    return moved(*origin, float(point_m[0]), float(point_m[1]))


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
    way: RoutePlan, *, speed_mps: float = 0.0, altitude_m: float = 0.0, home_first: bool = True
) -> list[MissionItem]:
    """The items of a route.

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
