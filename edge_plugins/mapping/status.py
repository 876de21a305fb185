"""What live mapping does, for people, and what to expect of the way home if GPS were lost now.

The latter by comparing the map of this drive with itself: a stretch can be recognized if it is mapped and is not
mistaken for another one. So of every few places, one is compared with all others: it is unique if nothing elsewhere
looks more like it than its own neighbors do. What that cannot say is how much the light will have changed by then: the
share is an upper bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from edge.journal.records import Record, unit
from edge.reference_map import NEIGHBOR_PLACES, MapSoFar, rival


@dataclass(frozen=True)
class WayHome:
    """share: of the way home that can be recognized, 0 to 1. first_m: until the first fix after turning round.

    longest_m: longest stretch of it without a fix. drift_m: by how much the autopilot's position is then wrong.
    """

    share: float
    first_m: float
    longest_m: float
    drift_m: float


class MappingChanged(Record, frozen=True, tag="mapping"):
    """Live mapping began, pauses or stopped."""

    state: Annotated[str, unit("", "mapping, waiting (until the reason is gone) or stopped")]
    why: Annotated[str, unit("", 'why nothing is mapped, "" while it is')]
    map: Annotated[str, unit("", "name of the map of this drive")]
    places: Annotated[int, unit("places", "places of that map")]


class SelfComparison:
    """Which stretches of the map of this drive are unique in it, a few places at a time."""

    def __init__(self) -> None:
        self._sampled: list[tuple[float, bool]] = []  # meters along the drives, and whether the place is unique
        self._next = NEIGHBOR_PLACES

    def add(self, so_far: MapSoFar) -> None:
        """Compare one of the places that were not compared yet; costs as much as matching one frame."""
        row = max(self._next, so_far.header.places - NEIGHBOR_PLACES - 1)
        if row + NEIGHBOR_PLACES >= so_far.header.places:
            return
        found = rival(so_far.matcher, so_far.descriptors, so_far.places, row)
        is_unique = found is None or not found.is_mistaken
        self._sampled.append((float(so_far.places["route_m"][row]), is_unique))
        self._next = row + 1

    def way_home(self, driven_m: float, behind_m: float, line_m: float, drift: float) -> WayHome | None:
        """The way back over all that was driven since the first place; None before there is anything to say.

        behind_m: as configured. line_m: length of a sequence. drift: error of the autopilot, as a share of the way.
        """
        if len(self._sampled) < 2:
            return None
        first_m = behind_m / 2 + line_m
        along_m = np.array([at_m for at_m, _ in self._sampled])
        fixed_m = along_m[[is_unique for _, is_unique in self._sampled]]
        step_m = float(np.median(np.diff(along_m)))
        way_m = max(driven_m - float(along_m[0]), step_m)
        share = min(1.0, len(fixed_m) * step_m / way_m)
        # From the turn to the first place that is recognized, between two of them, and from the last one to the start.
        turned = fixed_m[fixed_m <= driven_m - first_m]
        gaps_m = np.diff(np.concatenate([[along_m[0]], turned, [driven_m]]))
        longest_m = float(gaps_m.max(initial=first_m))
        return WayHome(share, first_m, longest_m, drift * longest_m)


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
