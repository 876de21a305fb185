"""What the robot is told of a match: with the place's own position, or with the tracked one."""

from __future__ import annotations

from msgspec import UNSET

from edge.config import RigConfig
from edge.localization import PlaceFix
from edge.localization.route_tracker import TrackedPosition
from edge.recognizer import PlaceMatch
from edge.reference_map.map_set import MapSet

UNTRACKED_SIGMA_M = 10.0
"""Of a match that the tracker does not follow: the first lines on a stretch were up to 20 m off."""


def place_fix(match: PlaceMatch, stamp_ns: int, rig: RigConfig, atlas: MapSet) -> PlaceFix:
    """A match as it is, where nothing has been tracked."""
    name, row = atlas.locate(match.place)
    return PlaceFix(
        stamp_ns=stamp_ns,
        place=row,
        lat_deg=match.lat_deg,
        lon_deg=match.lon_deg,
        heading_deg=match.heading_deg,
        sigma_along_m=max(rig.sigma_m(match.direction, match.order), UNTRACKED_SIGMA_M),
        sigma_across_m=rig.sigma_across_m,
        direction=match.direction,
        order=match.order,
        uniqueness=round(match.uniqueness, 4),
        category=match.category or "",
        map=name if name is not None else UNSET,
    )


def tracked_fix(match: PlaceMatch, tracked: TrackedPosition, atlas: MapSet) -> PlaceFix:
    """What is told of a tracked position; `match` is the newest that was accepted."""
    name, row = atlas.locate(tracked.place)
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
