"""From matches and the odometer to a position of the vehicle, and whether it may be sent.

`route_tracker` follows the vehicle along the map's drive, with `line_refinement` for where a line really ends;
`dead_reckoning` integrates what the autopilot reports of its motion; `integrity` and `fix_consistency`
are the rules that a position must pass.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from edge.localization.dead_reckoning import DeadReckoning, Displacement

__all__ = ["DeadReckoning", "Displacement", "PlaceFix"]


class PlaceFix(msgspec.Struct, frozen=True, tag_field="event", tag="place"):
    """A recognised place, as the robot is told of it and as the journal keeps it.

    stamp_ns: the moment that the position is of, on CLOCK_MONOTONIC: an exposure, or one that the position was moved
    on to. place: row of the reference map. Latitude and longitude in degrees (WGS 84) and heading of travel in degrees
    clockwise from north, each None where the map does not know it. sigma_along_m, sigma_across_m: one standard
    deviation along and across the route. direction: of travel against the map's. order: whether left and right
    regions matched their own side or the other. uniqueness: second-best cost over the best, outside a window.
    category: what kind of place, "" where nobody asked. matches: how many in a row agree with the distance driven.
    map: name of the place's map, where there is a folder of them.
    """

    stamp_ns: int
    place: int
    lat_deg: float | None
    lon_deg: float | None
    heading_deg: float | None
    sigma_along_m: float
    sigma_across_m: float
    direction: Literal["forward", "reverse"]
    order: Literal["same", "swapped"]
    uniqueness: float
    category: str = ""
    matches: int = 1
    map: str | msgspec.UnsetType = msgspec.UNSET

    @property
    def sigma_m(self) -> float:
        """The larger of both: autopilots take one number for every direction."""
        return max(self.sigma_along_m, self.sigma_across_m)
