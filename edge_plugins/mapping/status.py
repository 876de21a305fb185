"""What live mapping does, for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from edge.journal.records import Record, unit


class MappingChanged(Record, frozen=True, tag="mapping"):
    """Live mapping began, pauses or stopped."""

    state: Annotated[str, unit("", "mapping, waiting (until the reason is gone) or stopped")]
    why: Annotated[str, unit("", 'why nothing is mapped, "" while it is')]
    map: Annotated[str, unit("", "name of the map of this drive")]
    places: Annotated[int, unit("places", "places of that map")]


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
    """

    status: MappingStatus
    line: tuple[tuple[float, float], ...]
    line_searchable: int
