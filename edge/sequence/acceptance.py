"""Whether the best line is believed: trajectory uniqueness (section IV-B) with its window in metres, and hold-off.

The lowest cost alone is a poor confidence, since a vehicle off the map has a lowest cost as well. What tells is how
much worse the best line elsewhere is. Elsewhere is in metres: neighbours of a place are as good as the place itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig
from edge.sequence import SequenceMatch
from edge.sequence.interpolation import end_between_places, places_nearly_as_good
from edge.sequence.search import NO_LINE, Lines, SequenceSearch


class Neighbourhood:
    """Which places count as the same place as another, for uniqueness."""

    def __init__(
        self,
        east_north_m: NDArray[np.float64],
        route_m: NDArray[np.float64],
        segment_of: NDArray[np.int32],
        config: AcceptanceConfig,
    ) -> None:
        """east_north_m (N, 2), route_m (N,) (NaN where unknown), segment_of (N,)."""
        self._east_m, self._north_m = np.ascontiguousarray(east_north_m.T)
        self._route_m = route_m
        self._segment_of = segment_of
        self._config = config

    def around(self, place: int) -> NDArray[np.bool_]:
        """Places (N,) within `window_m` of `place`, along its drive or as the crow flies.

        Where the map knows no metres, those within `window_places` of it in its segment.
        """
        window_m = self._config.window_m
        segment = self.segment(place)
        # Comparisons with NaN are False: what is not known is not near.
        east_m, north_m = self._east_m - self._east_m[place], self._north_m - self._north_m[place]
        around: NDArray[np.bool_] = np.square(east_m, out=east_m) + np.square(north_m, out=north_m) <= window_m**2
        if np.isnan(self._route_m[place]):
            near = self._config.window_places
            around[max(segment.start, place - near) : min(segment.stop, place + near + 1)] = True
        else:
            around[segment] |= np.abs(self._route_m[segment] - self._route_m[place]) <= window_m
        return around

    def segment(self, place: int) -> slice:
        """The places of the same drive."""
        first, end = np.searchsorted(self._segment_of, [self._segment_of[place], self._segment_of[place] + 1])
        return slice(int(first), int(end))


def best_match(
    search: SequenceSearch, lines: Lines, neighbourhood: Neighbourhood, config: AcceptanceConfig
) -> SequenceMatch | None:
    """Equation 3 and the uniqueness test; None where no whole line ends anywhere (a map shorter than a sequence)."""
    place = int(lines.costs.argmin())
    best = int(lines.costs[place])
    if best == NO_LINE:
        return None
    second = int(np.where(neighbourhood.around(place), NO_LINE, lines.costs).min())
    # With nothing whole outside the window there is nothing to be told apart from, so nothing is claimed.
    uniqueness = second / max(best, 1) if second != NO_LINE else 1.0
    plane = lines.plane(place)
    direction, order = search.planes[plane]
    segment = neighbourhood.segment(place)
    along, at = lines.costs[segment], place - segment.start
    return SequenceMatch(
        place=place,
        direction=direction,
        order=order,
        slope=search.slope(plane, place),
        cost=best / lines.length,
        uniqueness=uniqueness,
        accepted=uniqueness >= config.uniqueness_min,
        beyond=end_between_places(along, at),
        width=places_nearly_as_good(along, at, min(second, 2 * best)),
    )


class HoldOff:
    """Lets one event through, and the next after `hold_off_s`."""

    def __init__(self, hold_off_s: float) -> None:
        self._hold_off_ns = round(hold_off_s * 1e9)
        self._last_ns: int | None = None

    def passes(self, stamp_ns: int) -> bool:
        """True if an event at this time is due; it then counts as sent."""
        if self._last_ns is not None and 0 <= stamp_ns - self._last_ns < self._hold_off_ns:
            return False
        self._last_ns = stamp_ns
        return True
