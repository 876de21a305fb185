"""How far places lie along the drives of some maps: what the place belief counts in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north, first_known
from edge.localization.consensus import PlaceBelief, PlaceVote
from edge.reference_map import MapSet
from edge.sequence import PlaceMatch


class Drives:
    """Places of a set of maps along their drives.

    is_metric: whether along is in meters, as every place's route_m; else each place counts as `spacing_m`.
    spacing_m: mean distance between places that follow each other.
    """

    def __init__(self, map_set: MapSet, spacing_m: float) -> None:
        """spacing_m: what a place counts as where the maps know no meters."""
        self._index, self._places = map_set.index, map_set.places
        self._route_m = map_set.places["route_m"]
        self._origin: tuple[float, float] | None = None
        self._grounds: dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
        steps_m = [abs(self._route_m[end - 1] - self._route_m[start]) for start, end in self._index.segments]
        gaps = self._index.places - len(steps_m)
        mean_m = float(np.sum(steps_m)) / gaps if gaps else np.nan
        self.is_metric = bool(mean_m > 0 and not np.isnan(self._route_m).any())
        self.spacing_m = mean_m if self.is_metric else spacing_m

    def along_m(self, place_index: int) -> float:
        """How far along its drive a place lies."""
        if self.is_metric:
            return float(self._route_m[place_index])
        return (place_index - self._index.segment(self._index.segment_of(place_index))[0]) * self.spacing_m

    def positions_m(self, drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters east and north (n, 2) of points along some drives; NaN where the map knows no positions."""
        found = np.full((len(drives), 2), np.nan)
        if self.is_metric:
            for drive in np.unique(drives):
                here = drives == drive
                route_m, east_north_m = self._ground(int(drive))
                found[here] = np.column_stack([np.interp(along_m[here], route_m, line) for line in east_north_m])
        return found

    def _ground(self, drive: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A drive's route_m (n,), and its meters east and north (2, n)."""
        if drive not in self._grounds:
            places = self._places[slice(*self._index.segment(drive))]
            self._origin = self._origin or first_known(places["lat_deg"], places["lon_deg"])
            east_north_m = east_north(places["lat_deg"], places["lon_deg"], self._origin)
            self._grounds[drive] = np.ascontiguousarray(places["route_m"]), np.ascontiguousarray(east_north_m.T)
        return self._grounds[drive]

    def vote(self, match: PlaceMatch) -> PlaceVote:
        """What a match says of the place."""
        drive = self._index.segment_of(match.place_index)
        start, end = self._index.segment(drive)
        return PlaceVote(
            drive=drive,
            along_m=self.along_m(match.place_index),
            start_m=self.along_m(start),
            end_m=self.along_m(end - 1),
            direction=match.direction,
            uniqueness=match.uniqueness,
            sharpness=match.sharpness,
            row_share=match.row_share,
        )

    def places_within(self, belief: PlaceBelief, reach_m: float) -> tuple[int, int]:
        """Places [first, end) of the believed drive that lie within `reach_m` of the belief."""
        start, end = self._index.segment(belief.drive)
        low_m, high_m = belief.along_m - reach_m, belief.along_m + reach_m
        if not self.is_metric:
            rows = np.ceil(low_m / self.spacing_m), np.floor(high_m / self.spacing_m) + 1
            return start + int(np.clip(rows[0], 0, end - start)), start + int(np.clip(rows[1], 0, end - start))
        first, last = np.searchsorted(self._route_m[start:end], [low_m, np.nextafter(high_m, np.inf)])
        return start + int(first), start + int(last)
