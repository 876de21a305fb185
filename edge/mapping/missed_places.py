"""Places that were passed without a frame, since the camera or the computer was late: each gets the nearest frame.

Lines are searched by places, one every so many meters. Without places for a gap in the frames, a line would be bent
there, and could not be found.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.reference_map import Place


@dataclass(frozen=True)
class MappedPlace:
    """A place and its raw descriptor (R, D)."""

    raw: NDArray[np.float32]
    place: Place


def missed_places(before: MappedPlace, after: MappedPlace, missed: int) -> Iterator[MappedPlace]:
    """The `missed` places between two that have a frame, evenly apart, with the less accurate position of both."""
    first, last = before.place, after.place
    east_deg = (last.lon_deg - first.lon_deg + 180.0) % 360.0 - 180.0
    for number in range(1, missed + 1):
        share = number / (missed + 1)
        nearest = before if share <= 0.5 else after
        place = replace(
            nearest.place,
            lat_deg=first.lat_deg + share * (last.lat_deg - first.lat_deg),
            lon_deg=(first.lon_deg + share * east_deg + 180.0) % 360.0 - 180.0,
            alt_m=first.alt_m + share * (last.alt_m - first.alt_m),
            route_m=first.route_m + share * (last.route_m - first.route_m),
            position_sigma_m=float(np.maximum(first.position_sigma_m, last.position_sigma_m)),
        )
        yield replace(nearest, place=place)
