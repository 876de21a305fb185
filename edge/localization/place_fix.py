"""The place where a match puts the vehicle, and what the robot is told of it: the match's own position, or the tracked.

Every position of a match is computed here.
"""

from __future__ import annotations

from msgspec import UNSET

from edge.config import RigConfig
from edge.localization import PlaceFix
from edge.localization.route_tracker import TrackedPosition
from edge.reference_map import MapSet, Position, Route
from edge.sequence import PlaceMatch

UNTRACKED_SIGMA_M = 10.0
"""Of a match that the tracker does not follow: the first lines on a stretch were up to 20 m off."""


def position_of(match: PlaceMatch, route: Route, rig: RigConfig) -> Position | None:
    """Where a match puts the vehicle, with its heading of travel; None where the map has no positions.

    The matched place lies ahead of the vehicle by the rig's offset; on the way back that is towards the drive's start.
    """
    forward = match.direction == "forward"
    ahead_m = rig.ahead_m(match.direction, match.order)
    position = route.position(match.place_index, -ahead_m if forward else ahead_m)
    if position is None or position.heading_deg is None:
        return position
    return Position(position.lat_deg, position.lon_deg, (position.heading_deg + (0 if forward else 180)) % 360)


def place_fix(match: PlaceMatch, stamp_ns: int, position: Position | None, rig: RigConfig) -> PlaceFix:
    """A match at its own position (`position_of`), where nothing has been tracked."""
    return PlaceFix(
        stamp_ns=stamp_ns,
        place=match.place,
        lat_deg=position.lat_deg if position else None,
        lon_deg=position.lon_deg if position else None,
        heading_deg=position.heading_deg if position else None,
        sigma_along_m=max(rig.sigma_m(match.direction, match.order), UNTRACKED_SIGMA_M),
        sigma_across_m=rig.sigma_across_m,
        direction=match.direction,
        order=match.order,
        uniqueness=round(match.uniqueness, 4),
        category=match.category or "",
        map=match.map if match.map is not None else UNSET,
    )


def tracked_fix(match: PlaceMatch, tracked: TrackedPosition, map_set: MapSet) -> PlaceFix:
    """What is told of a tracked position; `match` is the newest that was accepted."""
    name, row = map_set.locate(tracked.place_index)
    return PlaceFix(
        stamp_ns=tracked.stamp_ns,
        place=row,
        lat_deg=tracked.lat_deg,
        lon_deg=tracked.lon_deg,
        heading_deg=tracked.heading_deg,
        sigma_along_m=round(tracked.sigma_along_m, 2),
        sigma_across_m=tracked.sigma_across_m,
        direction=tracked.direction,
        order=match.order,
        uniqueness=round(match.uniqueness, 4),
        category=match.category or "",
        matches=tracked.matches,
        map=name if name is not None else UNSET,
    )
