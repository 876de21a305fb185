"""A match on the ground: where the vehicle was when its line passed a place, and how it has moved since.

The middle of a line is best known. Where the two regions of a line say where they are by themselves (`Parallax`), the
middle between both is known better still, and how far the vehicle is beside the map's drive.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge.config import Config
from edge.geodesy import Origin, VehiclePosition, east_north_of
from edge.localization.place_fix import LineMiddle, LineReadings, line_middle, map_error_m, position_on_route
from edge.localization.route_estimate import MatchErrors, Vector, left_of
from edge.reference_map import Position, Route
from edge.sequence import PARALLAX_ROWS, PlaceMatch

SEES_M = 16.0
"""How far in front of a camera the vehicle is as far beside the map's drive as its parallax says: a vehicle that turns
by a degree sees what one would that is 0.28 m further to that side (in the simulator; without it, 0.3 m more error)."""
CONFIRMS_M = 20.0, 80.0
"""How far the vehicle moves between two parallaxes of which one confirms the other: wrong ones rarely stay."""
CONFIRMED_M, CONFIRMED = 1.5, 0.05
"""By how many meters across, and by which share of the distance between them, they may differ."""


class OnDrive(NamedTuple):
    """A point of a drive of the map, meters (2,), the direction of travel there, and one sigma of the map's error."""

    place_m: Vector
    along: Vector
    map_sigma_m: float


class Passed(NamedTuple):
    """Where the vehicle was, meters (2,), the direction of travel there, and how it has moved since."""

    place_m: Vector
    along: Vector
    since_m: Vector


@dataclass(frozen=True)
class Sighting:
    """A match in local meters: where the vehicle was at the middle of its line, and its displacement since then.

    along: unit vector (2,) of travel there. along_m: of the vehicle now, along the drive. shows_parallax: whether lines
    of this kind have one that was calibrated: where they say nothing, the vehicle may be off its lane. middle, beside:
    where its parallax says that the vehicle was along the drive, and across it; None where it says nothing.
    """

    match: PlaceMatch
    segment: int
    place_m: Vector
    along: Vector
    since_m: Vector
    along_m: float
    sigma_m: float
    errors: MatchErrors
    map_sigma_m: float
    shows_parallax: bool
    middle: Passed | None
    beside: Passed | None


class Sightings:
    """Matches in local meters, with the readings of the vehicle's displacement that their lines need."""

    def __init__(self, route: Route, config: Config) -> None:
        self._route, self._rig = route, config.rig
        self._length = config.sequence.length
        self._readings = LineReadings(self._length)
        self._parallaxes: deque[tuple[Vector, float]] = deque(maxlen=32)
        self._sees_m = SEES_M if config.camera.view == "front" else -SEES_M
        self.origin: Origin | None = None
        """Of local meters."""

    def clear(self) -> None:
        """The next frame begins a new line."""
        self._readings.clear()
        self._parallaxes.clear()

    def add(self, displacement_m: Vector, missed: int) -> None:
        """A frame was used there (2,); see `LineReadings`."""
        self._readings.add(displacement_m, missed)

    def local(self, position: Position | VehiclePosition) -> Vector:
        """Meters east and north (2,)."""
        if self.origin is None:
            self.origin = position.lat_deg, position.lon_deg
        return np.array(east_north_of(position.lat_deg, position.lon_deg, self.origin))

    def position(self, match: PlaceMatch, along_m: float) -> Position | None:
        """Where a match's drive of the map is after so many meters of its route_m, with the heading of travel."""
        offset_m = along_m - self._route.route_m(match.place_index)
        return position_on_route(self._route, match.place_index, offset_m, match.direction)

    def of(self, match: PlaceMatch, moved_alike: Callable[[Vector, Vector], bool]) -> Sighting | None:
        """The match in local meters; None where the map has no positions, or if the line did not move as we did.

        moved_alike: whether a line that passed over the ground by one vector (2,) may be of a vehicle that moved by
        another.
        """
        line = line_middle(match, self._route, self._length)
        if line is None or len(self._readings) < self._length:
            return None
        begin, middle, end = (self._on_drive(match, along_m) for along_m in (line.begins_m, line.along_m, line.ends_m))
        if begin is None or middle is None or end is None:
            return None
        moved_m = self._since(2 * line.back)
        if not moved_alike(end.place_m - begin.place_m, moved_m):
            return None
        since_m = self._since(line.back)
        sign = -1 if match.direction == "reverse" else 1
        return Sighting(
            match=match,
            segment=line.segment,
            place_m=middle.place_m + self._left_m(match) * left_of(middle.along),
            along=middle.along,
            since_m=since_m,
            along_m=line.along_m + sign * (float(np.hypot(*since_m)) - self._ahead_m(match)),
            sigma_m=line.sigma_m,
            errors=self._errors(match),
            map_sigma_m=middle.map_sigma_m,
            shows_parallax=match.order == "same" and self._rig.parallax > 0,
            **self._by_parallax(match, line),
        )

    def _by_parallax(self, match: PlaceMatch, line: LineMiddle) -> dict[str, Passed | None]:
        """Where parallax says that the vehicle was, if an earlier one of other rows has said the same."""
        beside, here_m = self._beside(match, line), self._readings.back(0)
        if beside is None:
            return {"middle": self._middle(match, line), "beside": None}
        off_m = float(left_of(beside.along) @ (beside.place_m + beside.since_m - here_m))
        is_confirmed = any(_confirms(here_m, off_m, *earlier) for earlier in self._parallaxes)
        self._parallaxes.append((here_m, off_m))
        if not is_confirmed:
            return {"middle": None, "beside": None}
        return {"middle": self._middle(match, line), "beside": beside}

    def _errors(self, match: PlaceMatch) -> MatchErrors:
        apart_m = abs(self._rig.parallax * self._left_m(match)) if match.order == "same" else 0.0
        return MatchErrors(self._rig.sigma_m(match.direction, match.order), apart_m / 2)

    def _left_m(self, match: PlaceMatch) -> float:
        return self._rig.left_reverse_m if match.direction == "reverse" else self._rig.left_forward_m

    def _on_drive(self, match: PlaceMatch, along_m: float) -> OnDrive | None:
        """Where the vehicle is on the map's drive when a line is `along_m` along it."""
        sign = 1 if match.direction == "forward" else -1
        found = self.position(match, along_m - sign * self._ahead_m(match))
        if found is None or found.heading_deg is None:
            return None
        heading_rad = math.radians(found.heading_deg)
        along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
        return OnDrive(self.local(found), along, map_error_m(found))

    def _middle(self, match: PlaceMatch, line: LineMiddle) -> Passed | None:
        """Where the vehicle was along the drive, in the middle of the newest rows of a line."""
        if match.parallax is None:
            return None
        return self._passed_back(match, line, (PARALLAX_ROWS - 1) / 2, match.parallax.middle_places)

    def _beside(self, match: PlaceMatch, line: LineMiddle) -> Passed | None:
        """Where the vehicle was beside the map's drive, `SEES_M` further."""
        if match.parallax is None or not self._rig.parallax:
            return None
        spacing_m = self._route.drive(match.place_index).spacing_m
        back = (PARALLAX_ROWS - 1) / 2 - self._sees_m / spacing_m
        passed = self._passed_back(match, line, back, match.parallax.middle_places)
        if passed is None:
            return None
        left_m = match.parallax.lag_places * spacing_m / self._rig.parallax
        return passed._replace(place_m=passed.place_m + left_m * left_of(passed.along))

    def _passed_back(self, match: PlaceMatch, line: LineMiddle, back: float, beyond_places: float) -> Passed | None:
        """What a line passed so many frames before the newest, moved by some places in the map's order."""
        back = min(max(back, 0.0), 2 * line.back)
        along_m = line.ends_m + (line.along_m - line.ends_m) * back / line.back
        on_drive = self._on_drive(match, along_m + beyond_places * self._route.drive(match.place_index).spacing_m)
        return None if on_drive is None else Passed(on_drive.place_m, on_drive.along, self._since(back))

    def _since(self, frames: float) -> Vector:
        """How far the vehicle has moved since so many frames ago, meters (2,) by the autopilot's velocity."""
        return self._readings.back(0) - self._readings.back(frames)

    def _ahead_m(self, match: PlaceMatch) -> float:
        return self._rig.ahead_m(match.direction, match.order)


def _confirms(here_m: Vector, off_m: float, then_m: Vector, then_off_m: float) -> bool:
    """Whether of two parallaxes the earlier one confirms the later; off_m: of the places from where reckoning is."""
    apart_m = float(np.hypot(*(here_m - then_m)))
    is_another = CONFIRMS_M[0] <= apart_m <= CONFIRMS_M[1]
    return is_another and abs(off_m - then_off_m) <= CONFIRMED_M + CONFIRMED * apart_m
