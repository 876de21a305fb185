"""One used frame and what was recognised in it, as `replay --all` writes it and as the journal can keep it."""

from __future__ import annotations

import msgspec
from msgspec import UNSET, UnsetType

from edge.reference_map import Position
from edge.sequence import Direction, Order, PlaceMatch


class Observation(msgspec.Struct, frozen=True):
    """The fields from `place` on are null while there is no match (warming up, standing).

    frame: the camera's index, or the row of the query's feed. missed: places passed unseen before it, if any. map: name
    of the place's map, where there is a folder of them. place: row of the map. map_row: that place's row in the feed it
    came from. accepted: the place is believed. emitted: it went out as an event. category: of events.
    """

    frame: int
    stamp_ns: int
    accepted: bool = False
    emitted: bool = False
    missed: int | UnsetType = UNSET
    map: str | UnsetType = UNSET
    place: int | None = None
    map_row: int | None = None
    uniqueness: float | None = None
    distance: float | None = None
    direction: Direction | None = None
    order: Order | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    heading_deg: float | None = None
    category: str | None = None


def observation(
    frame: int,
    stamp_ns: int,
    match: PlaceMatch | None,
    position: Position | None,
    map_row: int | None,
    missed: int = 0,
) -> Observation:
    """The record of one frame and of its match. position: where that puts the vehicle. map_row: see `Observation`."""
    if match is None:
        return Observation(frame, stamp_ns, missed=missed or UNSET)
    return Observation(
        frame=frame,
        stamp_ns=stamp_ns,
        accepted=match.accepted,
        emitted=match.event,
        missed=missed or UNSET,
        map=match.map if match.map is not None else UNSET,
        place=match.place,
        map_row=map_row,
        uniqueness=round(match.uniqueness, 6),
        distance=round(match.distance, 6),
        direction=match.direction,
        order=match.order,
        lat_deg=position.lat_deg if position else None,
        lon_deg=position.lon_deg if position else None,
        heading_deg=position.heading_deg if position else None,
        category=match.category,
    )
