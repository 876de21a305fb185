"""From a match to a position of the vehicle on the ground; nowhere else are positions of matches made. Pure."""

from __future__ import annotations

from dataclasses import replace

from msgspec import UNSET

from edge.config import RigConfig
from edge.journal.records import FrameUsed, PlaceFix
from edge.reference_map import Position, Route
from edge.sequence import Direction, PlaceMatch

UNTRACKED_SIGMA_M = 10.0
"""Of a match that the tracker does not follow: the first lines on a stretch were up to 20 m off."""


def position_on_route(route: Route, place_index: int, offset_m: float, direction: Direction) -> Position | None:
    """The position `offset_m` further along the map's drive than a place, with the heading of travel; None: unknown."""
    position = route.position(place_index, offset_m)
    if position is None or position.heading_deg is None:
        return position
    return replace(position, heading_deg=(position.heading_deg + (0 if direction == "forward" else 180)) % 360)


def match_position(match: PlaceMatch, route: Route, rig: RigConfig) -> Position | None:
    """Where the vehicle was at the match's newest frame: the place moved by the rig's offset."""
    ahead_m = rig.ahead_m(match.direction, match.order)
    # The place lies ahead of the vehicle; on the way back "ahead" is towards the start of the map's drive.
    offset_m = -ahead_m if match.direction == "forward" else ahead_m
    return position_on_route(route, match.place_index, offset_m, match.direction)


def frame_used(
    frame: int, stamp_ns: int, match: PlaceMatch | None, route: Route, rig: RigConfig, missed: int = 0
) -> FrameUsed:
    """The record of a frame and of its match. missed: places passed without a frame before it."""
    if match is None:
        return FrameUsed(frame, stamp_ns, missed=missed or UNSET)
    position = match_position(match, route, rig)
    return FrameUsed(
        frame=frame,
        stamp_ns=stamp_ns,
        accepted=match.accepted,
        confidence=round(match.confidence, 4),
        emitted=match.event,
        missed=missed or UNSET,
        map=UNSET if match.map is None else match.map,
        place=match.place,
        map_row=route.map_row(match.place_index),
        uniqueness=round(match.uniqueness, 6),
        distance=round(match.distance, 6),
        direction=match.direction,
        order=match.order,
        lat_deg=position.lat_deg if position else None,
        lon_deg=position.lon_deg if position else None,
        heading_deg=position.heading_deg if position else None,
        category=match.category,
    )


def untracked_fix(match: PlaceMatch, stamp_ns: int, route: Route, rig: RigConfig) -> PlaceFix:
    """A match as it is, where nothing has been tracked."""
    position = match_position(match, route, rig)
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
        map=UNSET if match.map is None else match.map,
    )
