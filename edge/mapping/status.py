"""What live mapping does, for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from edge.mapping.way_home import WayHome


@dataclass(frozen=True)
class MappingStatus:
    """What live mapping does, for people.

    why: it does not map, "" while it does. name: of the map. places: it has. searchable: of these, are searched.
    mapped_m: length of its drives.
    """

    state: Literal["mapping", "waiting", "stopped"]
    why: str
    name: str
    places: int
    searchable: int
    mapped_m: float


@dataclass(frozen=True)
class MappingView:
    """The map of this drive for people.

    line: latitude and longitude of some of its places, in order, of which the first `line_searchable` are searched.
    way_home: None before there is anything to say.
    """

    status: MappingStatus
    line: tuple[tuple[float, float], ...]
    line_searchable: int
    way_home: WayHome | None
