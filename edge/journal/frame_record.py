"""One used frame and what was recognised in it, as `replay --all` writes it and as the journal can keep it."""

from __future__ import annotations

import msgspec
from msgspec import UNSET, UnsetType

from edge.recognizer import PlaceMatch
from edge.reference_map.map_set import MapSet
from edge.sequence import Direction, Order


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


def observation(frame: int, stamp_ns: int, match: PlaceMatch | None, atlas: MapSet, missed: int = 0) -> Observation:
    """The record of one frame, and of its match on the maps of an atlas."""
    if match is None:
        return Observation(frame, stamp_ns, missed=missed or UNSET)
    name, row = atlas.locate(match.place)
    return Observation(
        frame=frame,
        stamp_ns=stamp_ns,
        accepted=match.accepted,
        emitted=match.event,
        missed=missed or UNSET,
        map=name if name is not None else UNSET,
        place=row,
        map_row=atlas.feed_row(match.place),
        uniqueness=round(match.uniqueness, 6),
        distance=round(match.distance, 6),
        direction=match.direction,
        order=match.order,
        lat_deg=match.lat_deg,
        lon_deg=match.lon_deg,
        heading_deg=match.heading_deg,
        category=match.category,
    )
